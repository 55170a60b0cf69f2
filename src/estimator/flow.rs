//! Flow of the motion and of its errors: Runge–Kutta method of order 4 on the equations of motion in the link angles and on their
//! variational equations. A scene provides the coefficients.
//!
//! The six variations start as N in the angles, N in the rates, and the unknown force on N. The variations of the learned parameters come
//! after them.

use nalgebra::{Matrix4, Matrix4x2, Matrix4x6, SMatrix};

use super::error_state::{LENGTHS, LOADS, OFFSETS};
use super::tangent::{Frame, LinkState, Linkage, Links, Pair};
use super::tuning::{
    EFFECT_REGULARIZATION, LEAST_STEP_RATES, MOST_STEPS, STEPS_PER_DAMPER_TIME, STEPS_PER_RADIAN, VERTEX_STEP_FLOOR,
};

/// Equations of motion linearised at a state.
#[derive(Clone, Copy, Debug)]
pub struct Linearised {
    /// Accelerations α of the links, rad/s².
    pub alpha: Links,
    /// ∂α/∂θ, 1/s².
    pub by_angle: Matrix4<f64>,
    /// ∂α/∂ω, 1/s.
    pub by_rate: Matrix4<f64>,
    /// Accelerations by each of two sets of torques on the links, rad/s².
    pub by_torque: Matrix4x2<f64>,
}

/// Equations of motion of a scene with constant inputs. The unknown force adds to the inputs (τ₁, τ₂, N·m, F_x, F_y, N).
pub trait Scene {
    /// Accelerations of the links, rad/s².
    fn acceleration(&self, at: &LinkState, force: &Links) -> Links;

    /// Accelerations of the links with their derivatives, and the accelerations by each column of `torques`, two sets of torques on the
    /// links, N·m.
    fn linearised(&self, at: &LinkState, force: &Links, torques: &Matrix4x2<f64>) -> Linearised;

    /// ∂α/∂load at acceleration `alpha`, one column per load that may be learned.
    fn by_loads(&self, at: &LinkState, force: &Links, alpha: &Links) -> SMatrix<f64, 4, LOADS>;

    /// ∂α/∂(delay of the inputs), rad/s³, by a difference from the inputs h seconds before.
    fn by_delay(&self, at: &LinkState, force: &Links, h: f64) -> Links;

    /// ∂α/∂(lengths of links 1 to 4) at acceleration `alpha` and constant angles and rates; `None` if lengths are not learned.
    fn by_lengths(&self, at: &LinkState, force: &Links, alpha: &Links) -> Option<Matrix4<f64>>;

    /// ∂α/∂(mounting angles of the encoders), because servos close their loops on the encoders; `None` without servos.
    fn by_offsets(&self, at: &LinkState, force: &Links) -> Option<Matrix4x2<f64>>;

    /// Time by which servo references act late, s.
    fn command_delay(&self) -> f64;

    /// Mass matrix M in the link angles, kg·m².
    fn mass(&self, theta: &Links) -> Matrix4<f64>;

    /// Whether a load changes steeply with the state.
    fn has_stiff_forces(&self) -> bool;

    /// Whether dry friction, end stops, contacts or saturating servos may change forces abruptly within a step.
    fn has_abrupt_forces(&self) -> bool;
}

/// End of a propagated motion, with its derivatives; P is the number of learned parameters, all or none.
#[derive(Clone, Copy, Debug)]
pub struct Flow<const P: usize = 0> {
    /// State at the end.
    pub end: LinkState,
    /// Number of Runge–Kutta steps.
    pub steps: u32,
    /// Derivatives of the angles with respect to the initial errors.
    pub d_theta: Matrix4x6<f64>,
    /// Derivatives of the rates with respect to the initial errors.
    pub d_omega: Matrix4x6<f64>,
    /// Derivatives of angles and rates with respect to the learned parameters.
    pub by_learned: [SMatrix<f64, 4, P>; 2],
    /// Inputs that exert a unit of each initial force on the tangent basis.
    pub units: Matrix4x2<f64>,
}

/// Smallest inputs that exert a unit of each force on the tangent basis; the mean length weights tip forces against torques.
pub fn unit_forces(linkage: &Linkage, at: &Frame) -> Matrix4x2<f64> {
    let per_length = 1.0 / (linkage.length * linkage.length);
    let weights = Matrix4::from_diagonal(&Links::new(1.0, 1.0, per_length, per_length));
    let weighed = weights * at.by_inputs().tr_mul(&at.basis);
    let mut squared = at.basis.tr_mul(&(at.by_inputs() * weighed));
    (squared[(0, 0)], squared[(1, 1)]) = (squared[(0, 0)] + EFFECT_REGULARIZATION, squared[(1, 1)] + EFFECT_REGULARIZATION);
    // Regularised, the matrix is positive definite.
    weighed * squared.try_inverse().unwrap_or_default()
}

/// Number of Runge–Kutta steps that h seconds at rest need.
pub(super) fn steps_at_rest(scene: &impl Scene, h: f64) -> f64 {
    (h * LEAST_STEP_RATES[usize::from(scene.has_stiff_forces())]).ceil()
}

/// Number of Runge–Kutta steps that h seconds from a state need.
pub(super) fn steps(at: &Frame, near: &Linearised, scene: &impl Scene, (from, h): (&LinkState, f64)) -> u32 {
    let mut rate = LEAST_STEP_RATES[usize::from(scene.has_stiff_forces())];
    for i in 0..4 {
        rate = rate.max(STEPS_PER_DAMPER_TIME * near.by_rate[(i, i)].abs()).max(near.by_angle[(i, i)].abs().sqrt());
    }
    rate = rate.max(STEPS_PER_RADIAN * from.fastest() / at.smallest.clamp(VERTEX_STEP_FLOOR, 1.0).sqrt());
    (h * rate).ceil().clamp(1.0, MOST_STEPS).max(1.0) as u32
}

/// Motion without variations: h seconds in equal steps.
pub fn motion(scene: &impl Scene, from: &LinkState, force: &Links, h: f64, steps: u32) -> LinkState {
    let h = h / f64::from(steps);
    let mut at = *from;
    for _ in 0..steps {
        let rate = |at: LinkState| LinkState { theta: at.omega, omega: scene.acceleration(&at, force) };
        let plus = |h: f64, by: &LinkState| LinkState { theta: at.theta + by.theta * h, omega: at.omega + by.omega * h };
        let k1 = rate(at);
        let k2 = rate(plus(h / 2.0, &k1));
        let k3 = rate(plus(h / 2.0, &k2));
        let k4 = rate(plus(h, &k3));
        let mean = |of: fn(&LinkState) -> Links| of(&k1) + (of(&k2) + of(&k3)) * 2.0 + of(&k4);
        at = plus(h / 6.0, &LinkState { theta: mean(|k| k.theta), omega: mean(|k| k.omega) });
    }
    at
}

/// Integrated state, or its time derivative.
#[derive(Clone, Copy)]
struct Point<const P: usize> {
    state: LinkState,
    d_theta: Matrix4x6<f64>,
    d_omega: Matrix4x6<f64>,
    by_learned: [SMatrix<f64, 4, P>; 2],
}

impl<const P: usize> Point<P> {
    fn plus(&self, h: f64, rate: &Self) -> Self {
        Self {
            state: LinkState { theta: self.state.theta + rate.state.theta * h, omega: self.state.omega + rate.state.omega * h },
            d_theta: self.d_theta + rate.d_theta * h,
            d_omega: self.d_omega + rate.d_omega * h,
            by_learned: [0, 1].map(|i| self.by_learned[i] + rate.by_learned[i] * h),
        }
    }

    /// Time derivative; `learned` is ∂α/∂(learned parameters) at this state.
    fn rate(&self, near: &Linearised, learned: &SMatrix<f64, 4, P>) -> Self {
        let Self { state, d_theta, d_omega, by_learned: [theta, omega] } = self;
        let mut d_alpha = near.by_angle * d_theta + near.by_rate * d_omega;
        let mut pushed = d_alpha.fixed_columns_mut::<2>(4);
        pushed += near.by_torque;
        Self {
            state: LinkState { theta: state.omega, omega: near.alpha },
            d_theta: *d_omega,
            d_omega: d_alpha,
            by_learned: [*omega, near.by_angle * theta + near.by_rate * omega + learned],
        }
    }
}

/// Motion with variations over h seconds from a state with its frame, under an unknown force. It takes as many steps as it needs, but at
/// least `least`.
pub fn flow<const P: usize>(
    linkage: &Linkage,
    scene: &impl Scene,
    from: &LinkState,
    frame: &Frame,
    force: &Links,
    h: f64,
    least: u32,
) -> Flow<P> {
    let units = unit_forces(linkage, frame);
    let near = scene.linearised(from, force, &(frame.by_inputs() * units));
    let steps = steps(frame, &near, scene, (from, h)).max(least);
    let (by_learned, by_lengths) = lengths_at_begin(scene, (from, frame), force, &near.alpha);
    let mut point = Point { state: *from, d_theta: Matrix4x6::zeros(), d_omega: Matrix4x6::zeros(), by_learned };
    point.d_theta.fixed_columns_mut::<2>(0).copy_from(&frame.basis);
    point.d_omega.fixed_columns_mut::<2>(2).copy_from(&frame.basis);
    for k in 0..2 {
        // J δω = −δJ ω: rates that keep the turned links closed.
        let turned = frame.least_squares(frame.inward(&from.omega, &frame.basis.column(k).into()));
        point.d_omega.set_column(k, &turned);
    }
    let h = h / f64::from(steps);
    // ∂α/∂mass uses only the accelerations due to known forces. With the unknown force, which drifts, a free fall would seem to determine a
    // common factor of all masses.
    let unknown = if P > 0 { frame.basis.tr_mul(&(frame.by_inputs() * force)) } else { Pair::zeros() };
    let learned = |at: &LinkState, near: &Linearised| {
        let mut learned: SMatrix<f64, 4, P> = by_lengths;
        if P > 0 {
            let alpha = near.alpha - near.by_torque * unknown;
            learned.fixed_columns_mut::<LOADS>(0).copy_from(&scene.by_loads(at, force, &alpha));
            if let Some(by_offsets) = scene.by_offsets(at, force) {
                learned.fixed_columns_mut::<2>(OFFSETS.start).copy_from(&by_offsets);
            }
        }
        learned
    };
    let near_at = |state: &LinkState| scene.linearised(state, force, &(linkage.posture(&state.theta).by_inputs() * units));
    for step in 0..steps {
        let near = if step == 0 { near } else { near_at(&point.state) };
        let LinkState { theta, omega } = point.state;
        let middle = LinkState { theta: theta + omega * (h / 2.0), omega: omega + near.alpha * (h / 2.0) };
        let near_middle = near_at(&middle);
        // ∂α/∂parameter at the middle holds for the whole step.
        let held = learned(&middle, &near_middle);
        let rate_at = |point: &Point<P>| point.rate(&near_at(&point.state), &held);
        let k1 = point.rate(&near, &held);
        let k2 = point.plus(h / 2.0, &k1).rate(&near_middle, &held);
        let k3 = rate_at(&point.plus(h / 2.0, &k2));
        let k4 = rate_at(&point.plus(h, &k3));
        point = point.plus(h / 6.0, &k1.plus(2.0, &k2).plus(2.0, &k3).plus(1.0, &k4));
    }
    let Point { state: end, d_theta, d_omega, by_learned } = point;
    Flow { end, steps, d_theta, d_omega, by_learned, units }
}

/// Derivatives of angles and rates with respect to the learned parameters at the beginning, because other lengths close the loop at other
/// angles and rates; and ∂α/∂length, which is constant over all steps.
fn lengths_at_begin<const P: usize>(
    scene: &impl Scene,
    (from, frame): (&LinkState, &Frame),
    force: &Links,
    alpha: &Links,
) -> ([SMatrix<f64, 4, P>; 2], SMatrix<f64, 4, P>) {
    let (mut begin, mut accelerations) = ([SMatrix::<f64, 4, P>::zeros(); 2], SMatrix::<f64, 4, P>::zeros());
    if P > 0
        && let Some(by_lengths) = scene.by_lengths(from, force, alpha)
    {
        let turned = frame.turned_by_lengths();
        for (i, turned) in turned.column_iter().enumerate() {
            let turned: Links = turned.into();
            begin[0].set_column(LENGTHS.start + i, &turned);
            begin[1].set_column(
                LENGTHS.start + i,
                &frame.least_squares(frame.inward(&from.omega, &turned) - frame.opened(&from.omega, i)),
            );
        }
        accelerations.fixed_columns_mut::<4>(LENGTHS.start).copy_from(&by_lengths);
    }
    (begin, accelerations)
}
