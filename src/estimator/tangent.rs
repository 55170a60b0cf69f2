//! The closed loop in its four link angles: closure Φ, Jacobian J, its pseudo-inverse, and an orthonormal basis N of its null space.
//!
//! ```text
//! Φ = Σ sᵢ lᵢ ûᵢ − (d, 0)        J = [ sᵢ lᵢ n̂ᵢ ]        s = (+, +, −, −)
//! J⁺ = Jᵀ(JJᵀ)⁻¹                 I − J⁺J = N Nᵀ
//! ```
//!
//! J has rank 2 in direct and inverse singularities. It loses rank only in vertices, with all links in line. So N exists wherever the
//! encoders determine the motion.

use std::f64::consts::TAU;
use std::ops::Deref;

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Matrix4x2, Vector2, Vector4};

use super::error_state::{ERRORS, Error};
use super::stored;
use super::tuning::{
    CLOSURE_TOLERANCES, LARGEST_CHARTED_ERROR, LEAST_MISS, NEAR_SINGULARITY, NEAR_VERTEX, NEWTON_STEPS, NEWTON_TOLERANCE, RANK_LOSS,
};
use crate::mechanism::Geometry;
use crate::mechanism::legs::{Legs, sin_cos};

/// Angles, rates or torques of links 1 to 4.
pub type Links = Vector4<f64>;
/// Two components on the tangent basis or in the plane.
pub type Pair = Vector2<f64>;

/// Signs of the links in the closure.
pub(super) const CLOSURE_SIGNS: [f64; 4] = [1.0, 1.0, -1.0, -1.0];
/// Links with encoders.
pub const MEASURED: [usize; 2] = [0, 3];

/// Angles and rates of all links.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct LinkState {
    /// Link angles, rad, without whole turns.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    pub theta: Links,
    /// Rates, rad/s.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    pub omega: Links,
}

impl LinkState {
    /// State at these angles, rad, and rates, rad/s, of links 1 to 4.
    pub fn new(theta: [f64; 4], omega: [f64; 4]) -> Self {
        Self { theta: theta.into(), omega: omega.into() }
    }

    /// Fastest rate, rad/s.
    pub(super) fn fastest(&self) -> f64 {
        self.omega.iter().fold(0.0_f64, |most, rate| most.max(rate.abs()))
    }

    /// Signed distance from a direct singularity, s = sin(θ₃ − θ₂), and its rate, 1/s. The sign is the assembly.
    pub(super) fn side(&self) -> Pair {
        let (sine, cosine) = libm::sincos(self.theta[2] - self.theta[1]);
        Pair::new(sine, cosine * (self.omega[2] - self.omega[1]))
    }
}

/// An angle without whole turns, within [−π, π].
pub fn wrapped(angle: f64) -> f64 {
    angle - (angle / TAU).round() * TAU
}

/// Lengths of the closed loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Linkage {
    /// Signed lengths sᵢ lᵢ, m.
    arm: [f64; 4],
    base: f64,
    /// Mean length of the links, m.
    pub(super) length: f64,
}

impl Linkage {
    /// Lengths of a geometry.
    pub fn new(geometry: &Geometry) -> Self {
        let arm = std::array::from_fn(|i| CLOSURE_SIGNS[i] * geometry.links[i].length);
        Self { arm, base: geometry.base_distance, length: geometry.links.iter().map(|link| link.length).sum::<f64>() / 4.0 }
    }

    /// Largest distance between two positions of the tip, m: twice the reach of the shorter leg.
    pub(super) fn widest_reach(&self) -> f64 {
        let [left, inner, outer, right] = self.arm.map(f64::abs);
        2.0 * (left + inner).min(outer + right)
    }

    /// Posture at link angles, rad.
    pub fn posture(&self, theta: &Links) -> Posture {
        let (sin_p, cos_p) = sin_cos(Legs::new([theta[0], theta[3]]));
        let (sin_d, cos_d) = sin_cos(Legs::new([theta[1], theta[2]]));
        let ([x0, x3], [y0, y3]) = (cos_p.to_array(), sin_p.to_array());
        let ([x1, x2], [y1, y2]) = (cos_d.to_array(), sin_d.to_array());
        let directions = Matrix2x4::new(x0, x1, x2, x3, y0, y1, y2, y3);
        let [a, b, c, d] = self.arm;
        let arms = Matrix2x4::new(a * x0, b * x1, c * x2, d * x3, a * y0, b * y1, c * y2, d * y3);
        Posture { directions, arms }
    }

    /// Tangent space at link angles, rad.
    pub fn frame(&self, theta: &Links) -> Frame {
        Frame::new(self, self.posture(theta))
    }

    /// Newton iteration to the nearest closed state; `None` if it fails.
    pub fn closed(&self, state: LinkState) -> Option<(LinkState, Frame)> {
        let LinkState { mut theta, omega } = state;
        for _ in 0..NEWTON_STEPS {
            let posture = self.posture(&theta);
            let gap = self.gap(&posture);
            let size = gap[0].abs().max(gap[1].abs());
            if size <= NEWTON_TOLERANCE * self.length {
                let frame = Frame::new(self, posture);
                let omega = omega - frame.least_squares(frame.jacobian() * omega);
                return theta.iter().chain(&omega).all(|x| x.is_finite()).then_some((LinkState { theta, omega }, frame));
            }
            if !size.is_finite() || size > self.length {
                return None;
            }
            theta -= posture.jacobian().tr_mul(&(posture.gram(self.length).0 * gap));
        }
        None
    }

    /// Closes the loop of a state if it is open. Returns whether it is closed then.
    pub(super) fn close(&self, state: &mut LinkState) -> bool {
        self.is_closed(state) || self.closed(*state).map(|(closed, _)| *state = closed).is_some()
    }

    /// Displaces a state by an error ([`Frame::displaced`]) and closes the loop. Closing adds a quadratic term to the motor angles, which
    /// samples contradict. If the motors determine the posture, this term is removed.
    pub(super) fn displaced(&self, at: &Frame, from: &LinkState, error: [f64; 4]) -> Option<(LinkState, Frame)> {
        let (mut state, mut frame) = self.closed(at.displaced(from, error))?;
        let turned = libm::hypot(error[0], error[1]);
        if turned * turned < LEAST_MISS || turned > LARGEST_CHARTED_ERROR {
            return Some((state, frame));
        }
        // Changed lengths move the motors as well, along J⁺.
        let Some((from, _)) = self.closed(*from) else { return Some((state, frame)) };
        let aim = at.displaced(&from, error);
        for _ in 0..NEWTON_STEPS {
            let miss = Pair::from(MEASURED.map(|link| aim.theta[link] - state.theta[link]));
            if miss.amax() < LEAST_MISS || state.side()[0].abs() < NEAR_SINGULARITY {
                break;
            }
            let [a, b] = (frame.holding() * miss).into();
            let Some(closer) = self.closed(frame.displaced(&state, [a, b, 0.0, 0.0])) else { break };
            // A correction does not change the assembly.
            if closer.0.side()[0] * state.side()[0] <= 0.0 {
                break;
            }
            (state, frame) = closer;
        }
        Some((state, frame))
    }

    /// Position of the tip, m.
    pub fn tip(&self, theta: &Links) -> Pair {
        let arms = self.posture(theta).arms;
        arms.column(0) + arms.column(1)
    }

    /// Whether a state closes the loop, within the errors of low-accuracy settings and of straight motions through a vertex.
    pub fn is_closed(&self, state: &LinkState) -> bool {
        let (at, fastest) = (self.frame(&state.theta), state.fastest());
        let near = at.smallest < NEAR_VERTEX;
        let open = CLOSURE_TOLERANCES[usize::from(near)] * self.length;
        // Next to a vertex, constant rates open the loop by at most the smallest singular value of J times |ω| ≤ 2 max |ωᵢ|.
        let by_rates = open * (1.0 + fastest) + if near { 2.0 * NEAR_VERTEX * self.length * fastest } else { 0.0 };
        self.gap(&at).iter().all(|x| x.abs() < open) && (at.jacobian() * state.omega).iter().all(|x| x.abs() <= by_rates)
    }

    /// Closure gap Φ, m.
    fn gap(&self, at: &Posture) -> Pair {
        at.arms.column_sum() - Pair::new(self.base, 0.0)
    }
}

/// Directions of the links.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// Unit vectors ûᵢ, by columns.
    pub(super) directions: Matrix2x4<f64>,
    /// Arms in the closure sᵢ lᵢ ûᵢ, m, by columns.
    arms: Matrix2x4<f64>,
}

impl Posture {
    /// Jacobian J of the closure, m.
    pub(super) fn jacobian(&self) -> Matrix2x4<f64> {
        Matrix2x4::from_rows(&[-self.arms.row(1), self.arms.row(0).into_owned()])
    }

    /// −J̇ x for link rates ω: Σ sᵢ lᵢ ûᵢ ωᵢ xᵢ.
    pub(super) fn inward(&self, omega: &Links, x: &Links) -> Pair {
        self.arms * omega.component_mul(x)
    }

    /// Rate at which the closure opens per meter of length i, 1/s, for link rates ω: ∂J/∂lᵢ ω. The base does not turn.
    pub(super) fn opened(&self, omega: &Links, i: usize) -> Pair {
        if i == 4 {
            return Pair::zeros();
        }
        let direction = self.directions.column(i);
        Pair::new(-direction[1], direction[0]) * (CLOSURE_SIGNS[i] * omega[i])
    }

    /// (JJᵀ)⁻¹, 1/m², and the smallest singular value of J divided by the mean length `length`, m.
    pub(super) fn gram(&self, length: f64) -> (Matrix2<f64>, f64) {
        let (scale, gram) = (length * length, self.jacobian() * self.jacobian().transpose());
        let (xx, xy, yy) = (gram[(0, 0)], gram[(0, 1)], gram[(1, 1)]);
        let (mean, half) = ((xx + yy) / 2.0, (xx - yy) / 2.0);
        let spread = (half * half + xy * xy).sqrt();
        let (a, c) = (xx + RANK_LOSS * scale, yy + RANK_LOSS * scale);
        let determinant = (a * c - xy * xy).max(RANK_LOSS * scale * scale);
        // σ_min² = det/σ_max², without the cancellation of mean − spread.
        let smallest = ((xx * yy - xy * xy).max(0.0) / (mean + spread)).sqrt() / length;
        (Matrix2::new(c, -xy, -xy, a) / determinant, smallest)
    }

    /// Displacement of the tip per turn of the links, m.
    pub(super) fn tip_by_links(&self) -> Matrix2x4<f64> {
        let mut tip = self.jacobian();
        tip.fixed_columns_mut::<2>(2).fill(0.0);
        tip
    }

    /// Torques on the links (rows) per unit of each input (columns): τ₁, τ₂ in N·m, F_x, F_y in N.
    pub fn by_inputs(&self) -> Matrix4<f64> {
        let tip = self.tip_by_links();
        Matrix4::from_columns(&[Links::x(), Links::w(), tip.row(0).transpose(), tip.row(1).transpose()])
    }
}

/// A posture with its tangent space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    posture: Posture,
    /// (JJᵀ)⁻¹, 1/m².
    pub(super) inverse_gram: Matrix2<f64>,
    /// Smallest singular value of J divided by the mean length: 0 in a vertex.
    pub smallest: f64,
    /// Tangent basis N: two orthonormal directions of motion of the closed loop.
    pub basis: Matrix4x2<f64>,
}

impl Deref for Frame {
    type Target = Posture;

    fn deref(&self) -> &Posture {
        &self.posture
    }
}

impl Frame {
    fn new(linkage: &Linkage, posture: Posture) -> Self {
        let (inverse_gram, smallest) = posture.gram(linkage.length);
        let j = posture.jacobian();
        let basis = null_space(&(Matrix4::identity() - j.tr_mul(&(inverse_gram * j))));
        Self { posture, inverse_gram, smallest, basis }
    }

    /// Least-squares solution J⁺ r.
    pub(super) fn least_squares(&self, gap: Pair) -> Links {
        self.jacobian().tr_mul(&(self.inverse_gram * gap))
    }

    /// Turns of the measured links per tangent coordinate.
    pub(super) fn motors(&self) -> Matrix2<f64> {
        Matrix2::from_rows(&MEASURED.map(|link| self.basis.fixed_rows::<1>(link).into_owned()))
    }

    /// Derivative of the angle of an encoder's axis with respect to the errors of the motion.
    pub(super) fn row(&self, encoder: usize) -> Error {
        let mut row = [0.0; ERRORS];
        (row[0], row[1]) = (self.basis[(MEASURED[encoder], 0)], self.basis[(MEASURED[encoder], 1)]);
        row.into()
    }

    /// Map N'ᵀ N from this tangent basis to another.
    pub(super) fn basis_map_to(&self, other: &Self) -> Matrix2<f64> {
        other.basis.tr_mul(&self.basis)
    }

    /// State displaced by an error on the tangent basis: two angles, rad, and two rates, rad/s. The result is not closed.
    pub fn displaced(&self, from: &LinkState, error: [f64; 4]) -> LinkState {
        let [a, b, c, d] = error;
        LinkState { theta: from.theta + self.basis * Pair::new(a, b), omega: from.omega + self.basis * Pair::new(c, d) }
    }

    /// Derivatives of the tip position with respect to the tangent coordinates, m.
    pub fn tip(&self) -> Matrix2<f64> {
        self.tip_by_links() * self.basis
    }
}

/// Orthonormal basis of the range of a projector of rank 2, by Gram–Schmidt on its columns, longest first.
fn null_space(projector: &Matrix4<f64>) -> Matrix4x2<f64> {
    // In a projector, the squared length of a column equals its diagonal element.
    let longest = |of: &dyn Fn(usize) -> f64| (1..4).fold(0, |best, k| if of(k) > of(best) { k } else { best });
    let first: Links = projector.column(longest(&|k| projector[(k, k)])).normalize();
    let second: Links = projector.column(longest(&|k| projector[(k, k)] - first[k] * first[k])).into();
    // Orthogonalised twice: once leaves the round-off of nearly parallel columns.
    let across = |x: Links| x - first * first.dot(&x);
    Matrix4x2::from_columns(&[first, across(across(second)).normalize()])
}
