//! q̈ and λ that belong to q, q̇ and the forces.

use super::vectors::minus;
use super::{Kkt, System};

/// Solves M q̈ + Φ_qᵀ λ = Q, Φ_q q̈ = −Φ̇_q q̇.
///
/// With the softness e = 1/(κ m̄) in the place of 0 the solution is unique also where Φ_q loses rank: the multipliers are then those
/// of minimum norm.
pub fn equilibrium<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    q: &[f64; N],
    v: &[f64; N],
    softness: f64,
) -> ([f64; N], [f64; M]) {
    let pose = system.pose(q);
    equilibrium_at(system, q, &pose, v, &system.factor_mass(&pose, softness))
}

/// The same with pose and factor at hand.
#[inline(always)]
pub fn equilibrium_at<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &[f64; N],
    pose: &S::Pose,
    v: &[f64; N],
    mass: &S::Mass,
) -> ([f64; N], [f64; M]) {
    let centripetal = minus(&system.phi_q_dot_times(pose, v));
    mass.solve(&system.forces(q, pose, v), &centripetal)
}
