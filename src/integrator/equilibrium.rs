//! Dynamic equilibrium: accelerations q̈ and multipliers λ at given q, q̇ and forces (`docs/method.md`, (16)).

use super::{Kkt, System, Work};
use crate::vector::Vector;

/// Solves M q̈ + Φ_qᵀ λ = Q, Φ_q q̈ = −Φ̇_q q̇.
///
/// With e = 1/(κ m̄) in the place of 0 the solution is unique also where Φ_q loses rank: λ has minimum norm there.
#[inline(never)]
pub fn equilibrium<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    q: &Vector<N>,
    v: &Vector<N>,
    regularization: f64,
) -> (Vector<N>, Vector<M>) {
    let pose = system.pose_in_place(q);
    equilibrium_at(system, q, &pose, v, &system.factor_mass_in_place(&pose, regularization))
}

/// Solves for q̈ and λ at a given pose, and evaluates the power of the forces, W.
#[inline(never)]
pub(super) fn equilibrium_with_power<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    (q, pose, v): (&Vector<N>, &S::Pose, &Vector<N>),
    regularization: f64,
) -> (Vector<N>, Vector<M>, Work) {
    let (forces, power) = system.forces_and_power(q, pose, v);
    let (a, lambda) = equilibrium_under(system, &forces, (q, pose, v), &system.factor_mass(pose, regularization));
    (a, lambda, power)
}

/// Acceleration q̈ and power at rates `v`, `by` away from the base of small-angle updates.
#[inline(always)]
pub(super) fn acceleration_near<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    from: (&Vector<N>, &S::TrigBase),
    by: &Vector<N>,
    v: &Vector<N>,
    regularization: f64,
) -> (Vector<N>, Work) {
    if system.has_sticking() {
        let (q, v) = (*from.0 + *by, Vector::ZERO + *v);
        let (a, _, power) = equilibrium_with_power(system, (&q, &system.pose(&q), &v), regularization);
        return (a, power);
    }
    let pose = system.pose_from_base(from, by);
    let (forces, power) = system.forces_and_power(&(*from.0 + *by), &pose, v);
    let mass = system.factor_mass(&pose, regularization);
    (mass.solve_in_place(&forces, &-system.phi_q_dot_times(&pose, v)).0, power)
}

/// Solves for q̈ and λ with given pose and factorised mass matrix.
#[inline(always)]
pub fn equilibrium_at<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &Vector<N>,
    pose: &S::Pose,
    v: &Vector<N>,
    mass: &S::Mass,
) -> (Vector<N>, Vector<M>) {
    equilibrium_under(system, &system.forces(q, pose, v), (q, pose, v), mass)
}

/// Solves for q̈ and λ with given forces, pose and factorised mass matrix.
#[inline(always)]
pub(super) fn equilibrium_under<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    forces: &Vector<N>,
    (q, pose, v): (&Vector<N>, &S::Pose, &Vector<N>),
    mass: &S::Mass,
) -> (Vector<N>, Vector<M>) {
    let (a, lambda) = mass.solve_in_place(forces, &-system.phi_q_dot_times(pose, v));
    // Copies are made only where friction sticks: arguments by reference and returned values must be in memory, for all callers.
    // Adding 0 forces a copy, so the other case stays in registers.
    if system.has_sticking() {
        let (held, by) = system.with_friction_reaction(*q, *v, (a, lambda));
        return (Vector::ZERO + held, Vector::ZERO + by);
    }
    (a, lambda)
}
