//! Dynamic equilibrium: accelerations q̈ and multipliers λ at given q, q̇ and forces (`docs/method.md`, (16)).

use super::{Kkt, Posed, StickingConstraint, Stuck, System, Work};
use crate::vector::Vector;

/// Solves M q̈ + Φ_qᵀ λ = Q, Φ_q q̈ = −Φ̇_q q̇ at q, its pose and q̇, and evaluates the power of the forces, W.
///
/// With e = 1/(κ m̄) instead of 0 the solution is unique even if Φ_q loses rank: λ then has minimum norm.
pub fn equilibrium<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    Posed { q, pose, v }: Posed<'_, S::Pose, N>,
    regularization: f64,
) -> (Vector<N>, Vector<M>, Work) {
    let (forces, power) = system.forces(q, pose, v);
    let (a, lambda) = equilibrium_under(system, &forces, Posed { q, pose, v }, &system.factor_mass(pose, regularization));
    (a, lambda, power)
}

/// Acceleration q̈ and power at q + `by` and rates `v`. `pose` is the pose at q; the pose at q + `by` is derived from it if possible.
#[inline(always)]
pub(super) fn acceleration_near<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &Vector<N>,
    pose: &S::Pose,
    by: &Vector<N>,
    v: &Vector<N>,
    regularization: f64,
) -> (Vector<N>, Work) {
    if system.stuck() != Stuck::Nothing || system.features().special_constraints {
        let (q, v) = (*q + *by, Vector::ZERO + *v);
        let (a, _, power) = equilibrium(system, Posed { q: &q, pose: &system.pose(&q), v: &v }, regularization);
        return (a, power);
    }
    let pose = system.pose_near(q, pose, by);
    let (forces, power) = system.forces(&(*q + *by), &pose, v);
    let mass = system.factor_mass(&pose, regularization);
    (mass.solve(&forces, &-system.phi_q_dot_times(&pose, v)).0, power)
}

/// Solves for q̈ and λ with given forces, pose and factorised mass matrix.
#[inline(always)]
pub(super) fn equilibrium_under<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    forces: &Vector<N>,
    Posed { q, pose, v }: Posed<'_, S::Pose, N>,
    mass: &S::Mass,
) -> (Vector<N>, Vector<M>) {
    let (a, lambda) = mass.solve(forces, &-system.phi_q_dot_times(pose, v));
    if system.stuck() != Stuck::Nothing {
        with_reaction(system, forces, Posed { q, pose, v }, (mass, a, lambda))
    } else {
        (a, lambda)
    }
}

/// Adds the reaction of sticking friction to q̈ and λ.
fn with_reaction<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    forces: &Vector<N>,
    Posed { q, pose, v }: Posed<'_, S::Pose, N>,
    (mass, a, lambda): (&S::Mass, Vector<N>, Vector<M>),
) -> (Vector<N>, Vector<M>) {
    match system.sticking_constraint(q, pose, v) {
        StickingConstraint::Nothing => (a, lambda),
        StickingConstraint::Direction { row, drift, force } => {
            let (_, da, dlambda) = reaction(mass, [&row, &force], row.dot(&a) + drift);
            (a + da, lambda + dlambda)
        }
        StickingConstraint::All { force } => (Vector::ZERO, mass.solve(&(*forces + force), &Vector::ZERO).1),
    }
}

/// Velocity q̇ without its component along the sticking direction: the smallest change in the mass metric.
pub(super) fn project_sticking<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    Posed { q, pose, v }: Posed<'_, S::Pose, N>,
    mass: &S::Mass,
) -> Vector<N> {
    if system.stuck() == Stuck::Wholly {
        return Vector::ZERO;
    }
    match system.sticking_constraint(q, pose, v) {
        StickingConstraint::Direction { row, force, .. } => *v + reaction(mass, [&row, &force], row.dot(v)).1,
        StickingConstraint::Nothing | StickingConstraint::All { .. } => *v,
    }
}

/// Reaction along one sticking direction, as a multiple of its force, that brings the change along its row to 0, and the changes of q̈ (or
/// q̇) and λ due to this reaction. All are 0 if nothing can move the row.
pub fn reaction<const N: usize, const M: usize>(
    mass: &impl Kkt<N, M>,
    [row, force]: [&Vector<N>; 2],
    change: f64,
) -> (f64, Vector<N>, Vector<M>) {
    let (by_force, by_force_lambda) = mass.solve(force, &Vector::ZERO);
    let mobility = row.dot(&by_force);
    let part = if mobility > 0.0 { -change / mobility } else { 0.0 };
    (part, part * by_force, part * by_force_lambda)
}
