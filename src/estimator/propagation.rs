//! Time update of errors over a macro step: transition F by the variational equations between two tangent spaces, and process noise.

use nalgebra::{Matrix2, Matrix4};

use super::error_state::{FORCE, Matrix, Transition, turn_errors};
use super::flow::Flow;
use super::tangent::{Frame, LinkState, Links, wrapped};
use super::tuning::{AGREEMENT, COMPARED_BELOW, LARGEST_GROWTH, NEAR_VERTEX, PERSISTENT_TIME};
use crate::vector::Vector;

/// Transition of errors along a motion from one tangent space to another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Propagation {
    pub(super) from: Frame,
    pub(super) to: Frame,
    /// Transition matrix F of the errors on the tangent basis.
    pub(super) f: Transition,
    /// Mass matrix at the start, kg·m².
    pub(super) mass: Matrix4<f64>,
    /// Number of Runge–Kutta steps.
    pub(super) steps: u32,
    /// Whether the motion passed so close to a vertex that its branch is unknown.
    pub(super) held: bool,
}

impl Propagation {
    /// Transition along a propagated motion. Near a vertex, its end is compared with the simulated `end`.
    pub(super) fn along<const P: usize>(
        flow: &Flow<P>,
        mass: Matrix4<f64>,
        from: &Frame,
        (end, to): (&LinkState, &Frame),
        h: f64,
    ) -> Self {
        let smallest = from.smallest.min(to.smallest);
        let agrees = || {
            (0..4).all(|i| {
                let rate = end.omega[i];
                wrapped(flow.end.theta[i] - end.theta[i]).abs() < AGREEMENT[0]
                    && (flow.end.omega[i] - rate).abs() < AGREEMENT[1] + AGREEMENT[0] * rate.abs()
            })
        };
        // NaN counts as near a vertex.
        let held = !(smallest > NEAR_VERTEX && (smallest > COMPARED_BELOW || agrees()));
        let f = if held { straight(from, to, h) } else { transition(from, to, flow) };
        let (f, held) = if f.iter().all(|x| x.abs() < LARGEST_GROWTH) { (f, held) } else { (straight(from, to, h), true) };
        Self { from: *from, to: *to, f, mass, steps: flow.steps, held }
    }

    /// Transition of a nearby motion between its own tangent spaces.
    pub(super) fn transferred(&self, from: &Frame, to: &Frame) -> Self {
        let (onto, back) = (from.basis_map_to(&self.from), self.to.basis_map_to(to));
        let mut f = self.f.transpose();
        turn_errors(&onto.transpose(), &mut f);
        f.transpose_mut();
        turn_errors(&back, &mut f);
        Self { from: *from, to: *to, f, ..*self }
    }

    /// Inertia torque of links with accelerations `alpha`, rad/s²: root mean square over the tangent directions, N·m. Squares are summed link
    /// by link: in a fast passage next to a singularity the torques of two links nearly cancel on the basis, but their mass errors do not.
    pub(super) fn inertia_torque(&self, alpha: &Links) -> f64 {
        let torques = self.mass * alpha;
        (self.from.basis.component_mul(&self.from.basis).column_sum().dot(&torques.component_mul(&torques)) / 2.0).sqrt()
    }

    /// Process noise of h seconds.
    pub(super) fn noise(&self, h: f64) -> ProcessNoise {
        let turn = self.from.basis_map_to(&self.to);
        let mobility = (self.from.basis.tr_mul(&self.mass) * self.from.basis).try_inverse().unwrap_or_default();
        ProcessNoise::new(&(turn * mobility * turn.transpose()), h)
    }
}

/// Covariances of the errors on the tangent basis that h seconds add: `white` by a white torque of intensity 1 (N·m)²·s, `walk` by a
/// random walk of the unknown force of intensity 1 (N·m)²/s.
pub struct ProcessNoise {
    pub(super) white: Transition,
    pub(super) walk: Transition,
    /// Share of the persistent encoder errors that remains.
    pub(super) kept: f64,
}

impl ProcessNoise {
    /// Adds noise of these intensities, (N·m)²·s and (N·m)²/s, to a covariance.
    pub(super) fn add_to(&self, covariance: &mut Matrix, [white, walk]: [f64; 2]) {
        for ((column, by_torque), by_force) in covariance.data.0.iter_mut().zip(&self.white.data.0).zip(&self.walk.data.0) {
            let added = white * Vector::from(*by_torque) + walk * Vector::from(*by_force);
            column.iter_mut().zip(&*added).for_each(|(variance, by)| *variance += by);
        }
    }

    /// Process noise of h seconds for the mobility (NᵀMN)⁻¹, 1/(kg·m²): integrals of a white acceleration, and of a random walk of the
    /// acceleration.
    fn new(mobility: &Matrix2<f64>, h: f64) -> Self {
        let (squared, [h2, h3, h4, h5]) = (mobility * mobility, [h * h, h.powi(3), h.powi(4), h.powi(5)]);
        let (mut white, mut walk) = (Transition::zeros(), Transition::zeros());
        let set = |of: &mut Transition, (i, k): (usize, usize), block: Matrix2<f64>| {
            of.fixed_view_mut::<2, 2>(i, k).copy_from(&block);
            of.fixed_view_mut::<2, 2>(k, i).copy_from(&block);
        };
        set(&mut white, (0, 0), squared * (h3 / 3.0));
        set(&mut white, (0, 2), squared * (h2 / 2.0));
        set(&mut white, (2, 2), squared * h);
        set(&mut walk, (0, 0), squared * (h5 / 20.0));
        set(&mut walk, (0, 2), squared * (h4 / 8.0));
        set(&mut walk, (0, FORCE), mobility * (h3 / 6.0));
        set(&mut walk, (2, 2), squared * (h3 / 3.0));
        set(&mut walk, (2, FORCE), mobility * (h2 / 2.0));
        set(&mut walk, (FORCE, FORCE), Matrix2::identity() * h);
        for of in [&mut white, &mut walk] {
            of.fill_upper_triangle_with_lower_triangle();
        }
        Self { white, walk, kept: PERSISTENT_TIME / (PERSISTENT_TIME + h) }
    }
}

/// Transition matrix between two tangent spaces: derivatives of the flow for angles and rates, and the basis map for the force.
fn transition<const P: usize>(from: &Frame, to: &Frame, flow: &Flow<P>) -> Transition {
    let mut f = Transition::identity();
    turn_errors(&from.basis_map_to(to), &mut f);
    f.fixed_rows_mut::<2>(0).copy_from(&to.basis.tr_mul(&flow.d_theta));
    f.fixed_rows_mut::<2>(2).copy_from(&to.basis.tr_mul(&flow.d_omega));
    if P > 0 {
        f.fixed_view_mut::<2, 2>(FORCE, FORCE).copy_from(&to.basis.tr_mul(&(to.by_inputs() * flow.units)));
    }
    f
}

/// Transition matrix if the forces are unknown: rates are constant.
fn straight(from: &Frame, to: &Frame, h: f64) -> Transition {
    let turn = from.basis_map_to(to);
    let mut f = Transition::identity();
    turn_errors(&turn, &mut f);
    f.fixed_view_mut::<2, 2>(0, 2).copy_from(&(turn * h));
    f
}
