//! q̈ and λ that belong to q, q̇ and the forces.

use super::{Held, Kkt, System};
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
    let pose = system.pose(q);
    equilibrium_at(system, q, &pose, v, &system.factor_mass(&pose, regularization))
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
    let free = mass.solve(&system.forces(q, pose, v), &-system.phi_q_dot_times(pose, v));
    if system.holds() { with_what_is_held(system, [q, v], pose, mass, free) } else { free }
}

/// The same with the force by which friction holds.
#[cold]
fn with_what_is_held<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    [q, v]: [&Vector<N>; 2],
    pose: &S::Pose,
    mass: &S::Mass,
    (a, lambda): (Vector<N>, Vector<M>),
) -> (Vector<N>, Vector<M>) {
    match system.held(q, pose, v) {
        Held::Nothing => (a, lambda),
        Held::Direction { row, drift, force } => {
            let (by_force, by_force_lambda) = mass.solve(&force, &Vector::ZERO);
            let mobility = row.dot(&by_force);
            let part = if mobility > 0.0 { -(row.dot(&a) + drift) / mobility } else { 0.0 };
            (a + part * by_force, lambda + part * by_force_lambda)
        }
        Held::All { force } => {
            let (_, lambda) = mass.solve(&(system.forces(q, pose, v) + force), &Vector::ZERO);
            (Vector::ZERO, lambda)
        }
    }
}

/// q̇ without what friction holds.
#[inline]
pub fn let_hold<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &Vector<N>,
    pose: &S::Pose,
    mass: &S::Mass,
    v: Vector<N>,
) -> Vector<N> {
    if system.holds() { held_back(system, q, pose, mass, v) } else { v }
}

#[cold]
fn held_back<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &Vector<N>,
    pose: &S::Pose,
    mass: &S::Mass,
    v: Vector<N>,
) -> Vector<N> {
    match system.held(q, pose, &v) {
        Held::Nothing => v,
        Held::Direction { row, force, .. } => {
            let (by_force, _) = mass.solve(&force, &Vector::ZERO);
            let mobility = row.dot(&by_force);
            if mobility > 0.0 { v - row.dot(&v) / mobility * by_force } else { v }
        }
        Held::All { .. } => Vector::ZERO,
    }
}
