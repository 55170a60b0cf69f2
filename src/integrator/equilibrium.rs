//! Dynamic equilibrium: accelerations q̈ and multipliers λ at given q, q̇ and forces (`docs/method.md`, (16)).

use super::{Kkt, StickingConstraint, Stuck, System, Work};
use crate::vector::Vector;

/// Solves M q̈ + Φ_qᵀ λ = Q, Φ_q q̈ = −Φ̇_q q̇ at q with its pose and q̇, and evaluates the power of the forces, W.
///
/// With e = 1/(κ m̄) in the place of 0 the solution is unique also where Φ_q loses rank: λ has minimum norm there.
pub fn equilibrium<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    (q, pose, v): (&Vector<N>, &S::Pose, &Vector<N>),
    regularization: f64,
) -> (Vector<N>, Vector<M>, Work) {
    let (forces, power) = system.forces(q, pose, v);
    let (a, lambda) = equilibrium_under(system, &forces, (q, pose, v), &system.factor_mass(pose, regularization));
    (a, lambda, power)
}

/// Acceleration q̈ and power at rates `v`, `by` away from coordinates with their pose.
#[inline(always)]
pub(super) fn acceleration_near<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    from: (&Vector<N>, &S::Pose),
    by: &Vector<N>,
    v: &Vector<N>,
    regularization: f64,
) -> (Vector<N>, Work) {
    if system.stuck() != Stuck::Nothing || system.features().special_constraints {
        let (q, v) = (*from.0 + *by, Vector::ZERO + *v);
        let (a, _, power) = equilibrium(system, (&q, &system.pose(&q), &v), regularization);
        return (a, power);
    }
    let pose = system.pose_near(from, by);
    let (forces, power) = system.forces(&(*from.0 + *by), &pose, v);
    let mass = system.factor_mass(&pose, regularization);
    (mass.solve(&forces, &-system.phi_q_dot_times(&pose, v)).0, power)
}

/// Solves for q̈ and λ with given forces, pose and factorised mass matrix.
#[inline(always)]
pub(super) fn equilibrium_under<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    forces: &Vector<N>,
    (q, pose, v): (&Vector<N>, &S::Pose, &Vector<N>),
    mass: &S::Mass,
) -> (Vector<N>, Vector<M>) {
    let (a, lambda) = mass.solve(forces, &-system.phi_q_dot_times(pose, v));
    if system.stuck() != Stuck::Nothing { with_reaction(system, forces, (q, pose, v), (mass, a, lambda)) } else { (a, lambda) }
}

/// q̈ and λ with the reaction of sticking friction, from those without.
fn with_reaction<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    forces: &Vector<N>,
    (q, pose, v): (&Vector<N>, &S::Pose, &Vector<N>),
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

/// Velocity q̇ without its component along the sticking direction: the projection that is smallest in the mass metric.
pub(super) fn project_sticking<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    (q, pose, v): (&Vector<N>, &S::Pose, &Vector<N>),
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

/// Reaction of one sticking direction, a multiple of its force, that brings a change along its row to 0, with the changes of q̈ (or q̇)
/// and λ by that reaction; 0 where nothing moves the row.
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
