//! Derivatives of the joint constraints over a finite step from q₀ to q₁ = q₀ + d.
//!
//! In a step a link turns by Δθ, from û₀ to û₁; û_m is its direction half-way. With s = sin(Δθ/2)/(Δθ/2) and c = cos(Δθ/2) these equations
//! are exact for a step of any length:
//!
//! ```text
//! û₁ − û₀ = s n̂_m Δθ          J_b, with normals s n̂_m:  J_b d = Φ(q₁) − Φ(q₀)
//! (n̂₀ + n̂₁)/2 = c n̂_m         J_c, with normals c n̂_m:  (Φ_q(q₀) + Φ_q(q₁))/2
//! n̂₁ − n̂₀ = −s û_m Δθ         (Φ_q(q₁) − Φ_q(q₀)) z = K_b(z) d
//! ```
//!
//! J_b and J_c are Φ_q half-way with the angle columns scaled by s or c; K_b(z) is the discrete derivative of Φ_q z with respect to q. A
//! step with J_b and J_c therefore conserves energy and the constraints of position and velocity (O. Gonzalez, *Time integration and
//! discrete Hamiltonian systems*, J. Nonlinear Sci. 6 (1996) 449; J. C. García Orden and R. Ortega, *A conservative augmented Lagrangian
//! algorithm for the dynamics of constrained mechanical systems*, 2006). `docs/conserving.md` derives the step.

use super::legs::{Legs, Legs2, both, sin_cos};
use super::{Mechanism, Pose};

/// Poses and factors of a finite step.
#[derive(Clone, Copy, Debug)]
pub struct Secant {
    /// Pose with each link half-way through its turn.
    pub(crate) middle: Pose,
    /// Pose at the step's end.
    pub(crate) end: Pose,
    /// Factors s of the proximal and the distal links.
    pub(crate) sinc: [Legs; 2],
    /// Factors c of the proximal and the distal links.
    pub(crate) cos: [Legs; 2],
}

/// Cosine, sine and sin x/x of an angle |x| < 1/4 rad, by series exact to round-off.
fn small(angle: Legs) -> [Legs; 3] {
    let z = angle * angle;
    let series = |divisors: [f64; 6]| divisors.into_iter().rev().fold(both(0.0), |sum, divisor| both(1.0 / divisor) + z * sum);
    let sinc = series([1.0, -6.0, 120.0, -5040.0, 362_880.0, -39_916_800.0]);
    let cos = both(1.0) + z * series([-2.0, 24.0, -720.0, 40_320.0, -3_628_800.0, 479_001_600.0]);
    [cos, angle * sinc, sinc]
}

/// Cosine, sine and sin x/x of any angle x, rad.
#[cold]
#[inline(never)]
fn large(angle: Legs) -> [Legs; 3] {
    let (sin, cos) = sin_cos(angle);
    let exact = Legs::new([0, 1].map(|leg| {
        let (sin, angle) = (sin.to_array()[leg], angle.to_array()[leg]);
        // If only one angle is small, it also uses the series, as in [`small`].
        if angle.abs() < 0.25 { small(both(angle))[2].to_array()[0] } else { sin / angle }
    }));
    [cos, sin, exact]
}

/// Cosine, sine and sin x/x of an angle x, rad.
fn turn(angle: Legs) -> [Legs; 3] {
    if angle.abs().simd_lt(both(0.25)).all() { small(angle) } else { large(angle) }
}

impl Legs2 {
    /// The vector rotated by an angle, given its cosine and sine.
    fn rotated_by(self, cos: Legs, sin: Legs) -> Self {
        Self { x: self.x * cos - self.y * sin, y: self.x * sin + self.y * cos }
    }
}

impl Mechanism {
    /// Finite step from a pose, by turns of the proximal and the distal links, rad.
    #[inline(always)]
    pub(crate) fn secant(&self, begin: &Pose, turns: [Legs; 2]) -> Secant {
        let [cos_p, sin_p, sinc_p] = turn(both(0.5) * turns[0]);
        let [cos_d, sin_d, sinc_d] = turn(both(0.5) * turns[1]);
        let half_way = |[p, d]: [Legs2; 2]| [p.rotated_by(cos_p, sin_p), d.rotated_by(cos_d, sin_d)];
        let middle = half_way(begin.along());
        Secant {
            middle: self.pose_along(middle),
            end: self.pose_along(half_way(middle)),
            sinc: [sinc_p, sinc_d],
            cos: [cos_p, cos_d],
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::mechanism::coordinates::{D_THETA, P_THETA, legs_of, set_legs};
    use crate::mechanism::{Coordinates, Multipliers};

    /// Multiplies the angle entries of coordinates by factors.
    fn with_scaled_angles(mut x: Coordinates, [proximal, distal]: [Legs; 2]) -> Coordinates {
        let (p, d) = (legs_of(&x, P_THETA), legs_of(&x, D_THETA));
        set_legs(&mut x, P_THETA, proximal * p);
        set_legs(&mut x, D_THETA, distal * d);
        x
    }

    /// Products with J_b, J_c and K_b in all twelve coordinates.
    impl Secant {
        /// The product J_bᵀ Λ.
        pub(crate) fn discrete_transposed_times(&self, multipliers: &Multipliers) -> Coordinates {
            with_scaled_angles(self.middle.phi_q_transposed_times(multipliers), self.sinc)
        }

        /// The product J_cᵀ ν.
        pub(crate) fn mean_transposed_times(&self, multipliers: &Multipliers) -> Coordinates {
            with_scaled_angles(self.middle.phi_q_transposed_times(multipliers), self.cos)
        }

        /// The product K_b(z)ᵀ ν, the discrete derivative of νᵀ Φ_q z with respect to q. It is nonzero only in the angles.
        pub(crate) fn discrete_hessian_times(&self, z: &Coordinates, multipliers: &Multipliers) -> Coordinates {
            let (stiffness_p, stiffness_d) = self.middle.geometric_stiffness(multipliers);
            let mut product = Coordinates::ZERO;
            set_legs(&mut product, P_THETA, self.sinc[0] * stiffness_p * legs_of(z, P_THETA));
            set_legs(&mut product, D_THETA, self.sinc[1] * stiffness_d * legs_of(z, D_THETA));
            product
        }
    }
}
