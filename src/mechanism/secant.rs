//! Derivatives of the joints' constraints over a finite step, from q₀ to q₁ = q₀ + d.
//!
//! Over a step of Δθ a link turns from û₀ to û₁ about its direction in the middle, û_m. With s = sin(Δθ/2)/(Δθ/2) and c = cos(Δθ/2)
//!
//! ```text
//! û₁ − û₀ = s n̂_m Δθ          J_b, with normals s n̂_m:  J_b d = Φ(q₁) − Φ(q₀)
//! (n̂₀ + n̂₁)/2 = c n̂_m         J_c, with normals c n̂_m:  (Φ_q(q₀) + Φ_q(q₁))/2
//! n̂₁ − n̂₀ = −s û_m Δθ         (Φ_q(q₁) − Φ_q(q₀)) z = K_b(z) d
//! ```
//!
//! without an error, however long the step: each is Φ_q in the middle with its angles' columns shortened. So a step with J_b and J_c
//! keeps energy and both levels of the constraints (O. Gonzalez, *Time integration and discrete Hamiltonian systems*, J. Nonlinear Sci. 6
//! (1996) 449; J. C. García Orden and R. Ortega, *A conservative augmented Lagrangian algorithm for the dynamics of constrained
//! mechanical systems*, 2006). `docs/conserving.md` derives the step.

use super::coordinates::{D_THETA, P_THETA, legs_of, set_legs};
use super::legs::{Legs, Legs2, both, sin_cos};
use super::{Coordinates, Mechanism, Multipliers, Pose};

/// A step between two poses.
#[derive(Clone, Copy, Debug)]
pub struct Secant {
    /// Half way of each angle.
    pub(crate) middle: Pose,
    /// At the end.
    pub(crate) end: Pose,
    /// s and c of the proximal and the distal links.
    pub(crate) sinc: [Legs; 2],
    pub(crate) cos: [Legs; 2],
}

/// Cosine, sine and sine over the angle of an angle below 1/4, by their series to round-off.
#[inline(always)]
fn small(angle: Legs) -> [Legs; 3] {
    let z = angle * angle;
    let series = |divisors: [f64; 6]| divisors.into_iter().rev().fold(both(0.0), |sum, divisor| both(1.0 / divisor) + z * sum);
    let sinc = series([1.0, -6.0, 120.0, -5040.0, 362_880.0, -39_916_800.0]);
    let cos = both(1.0) + z * series([-2.0, 24.0, -720.0, 40_320.0, -3_628_800.0, 479_001_600.0]);
    [cos, angle * sinc, sinc]
}

/// The same of any angle.
#[cold]
#[inline(never)]
fn large(angle: Legs) -> [Legs; 3] {
    let (sin, cos) = sin_cos(angle);
    let exact = Legs::new([0, 1].map(|leg| {
        let (sin, angle) = (sin.to_array()[leg], angle.to_array()[leg]);
        // Where the series is used for the other leg only, it holds here too.
        if angle.abs() < 0.25 { small(both(angle))[2].to_array()[0] } else { sin / angle }
    }));
    [cos, sin, exact]
}

/// Cosine, sine and sine over the angle.
#[inline(always)]
fn turn(angle: Legs) -> [Legs; 3] {
    if angle.abs().simd_lt(both(0.25)).all() { small(angle) } else { large(angle) }
}

impl Legs2 {
    /// Turned by an angle with this cosine and sine.
    #[inline(always)]
    fn rotated_by(self, cos: Legs, sin: Legs) -> Self {
        Self { x: self.x * cos - self.y * sin, y: self.x * sin + self.y * cos }
    }
}

impl Mechanism {
    /// From a pose along increments of the coordinates. One piece of code for all callers.
    #[inline(never)]
    pub(crate) fn secant(&self, begin: &Pose, d: &Coordinates) -> Secant {
        self.secant_in_place(begin, d)
    }

    /// The same compiled into its caller.
    #[inline(always)]
    pub(crate) fn secant_in_place(&self, begin: &Pose, d: &Coordinates) -> Secant {
        self.secant_along(&StepDirections::new(begin, [legs_of(d, P_THETA), legs_of(d, D_THETA)]))
    }

    /// The same from directions.
    #[inline(always)]
    pub(crate) fn secant_along(&self, &StepDirections { middle, end, sinc, cos }: &StepDirections) -> Secant {
        Secant { middle: self.pose_along(middle), end: self.pose_along(end), sinc, cos }
    }
}

/// The directions of a step: of the proximal and the distal links.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepDirections {
    /// û_m.
    pub(crate) middle: [Legs2; 2],
    /// û₁.
    pub(crate) end: [Legs2; 2],
    /// s and c.
    pub(crate) sinc: [Legs; 2],
    pub(crate) cos: [Legs; 2],
}

impl StepDirections {
    /// From a pose by the turns of the proximal and the distal links.
    #[inline(always)]
    pub(crate) fn new(begin: &Pose, turns: [Legs; 2]) -> Self {
        let [cos_p, sin_p, sinc_p] = turn(both(0.5) * turns[0]);
        let [cos_d, sin_d, sinc_d] = turn(both(0.5) * turns[1]);
        let (p, d) = (begin.u_p.rotated_by(cos_p, sin_p), begin.u_d.rotated_by(cos_d, sin_d));
        Self {
            middle: [p, d],
            end: [p.rotated_by(cos_p, sin_p), d.rotated_by(cos_d, sin_d)],
            sinc: [sinc_p, sinc_d],
            cos: [cos_p, cos_d],
        }
    }
}

/// The angles' rows of a vector times a factor.
#[inline(always)]
fn with_scaled_angles(mut x: Coordinates, [proximal, distal]: [Legs; 2]) -> Coordinates {
    let (p, d) = (legs_of(&x, P_THETA), legs_of(&x, D_THETA));
    set_legs(&mut x, P_THETA, proximal * p);
    set_legs(&mut x, D_THETA, distal * d);
    x
}

impl Secant {
    /// J_bᵀ Λ.
    #[inline(always)]
    pub(crate) fn discrete_transposed_times(&self, multipliers: &Multipliers) -> Coordinates {
        with_scaled_angles(self.middle.phi_q_transposed_times(multipliers), self.sinc)
    }

    /// J_cᵀ ν.
    #[inline(always)]
    pub(crate) fn mean_transposed_times(&self, multipliers: &Multipliers) -> Coordinates {
        with_scaled_angles(self.middle.phi_q_transposed_times(multipliers), self.cos)
    }

    /// K_b(z)ᵀ ν, the discrete derivative of νᵀ Φ_q z with respect to q: only in the angles.
    #[inline(always)]
    pub(crate) fn discrete_hessian_times(&self, z: &Coordinates, multipliers: &Multipliers) -> Coordinates {
        let (stiffness_p, stiffness_d) = self.middle.geometric_stiffness(multipliers);
        let mut product = Coordinates::ZERO;
        set_legs(&mut product, P_THETA, self.sinc[0] * stiffness_p * legs_of(z, P_THETA));
        set_legs(&mut product, D_THETA, self.sinc[1] * stiffness_d * legs_of(z, D_THETA));
        product
    }
}
