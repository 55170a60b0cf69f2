//! q̈ and λ that belong to q, q̇ and the forces.

use super::{Kkt, System, Work};
use crate::vector::Vector;

/// Solves M q̈ + Φ_qᵀ λ = Q, Φ_q q̈ = −Φ̇_q q̇.
///
/// With e = 1/(κ m̄) in the place of 0 the solution is unique also where Φ_q loses rank: the multipliers are then those of minimum norm.
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

/// The same, with the power of the forces, from the pose.
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

/// q̈ and the power at rates v, `by` away from a q where turns begin.
#[inline(always)]
pub(super) fn acceleration_near<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    from: (&Vector<N>, &S::TrigBase),
    by: &Vector<N>,
    v: &Vector<N>,
    regularization: f64,
) -> (Vector<N>, Work) {
    let pose = system.pose_near(from, by);
    let q = *from.0 + *by;
    let (forces, power) = system.forces_and_power(&q, &pose, v);
    let (a, _) = equilibrium_under(system, &forces, (&q, &pose, v), &system.factor_mass(&pose, regularization));
    (a, power)
}

/// The same with pose and factor at hand.
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

/// The same with the forces at hand.
#[inline(always)]
pub(super) fn equilibrium_under<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    forces: &Vector<N>,
    (q, pose, v): (&Vector<N>, &S::Pose, &Vector<N>),
    mass: &S::Mass,
) -> (Vector<N>, Vector<M>) {
    let (a, lambda) = mass.solve_in_place(forces, &-system.phi_q_dot_times(pose, v));
    // Copies, which are made only where something is held: what is pointed to has to be in memory, and so has what a call returns, for
    // all who share its place. A sum with 0 has a place of its own.
    if system.holds() {
        let (held, by) = system.with_friction_reaction(*q, *v, (a, lambda));
        return (Vector::ZERO + held, Vector::ZERO + by);
    }
    (a, lambda)
}
