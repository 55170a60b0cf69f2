//! Fallback after a failed Newton iteration: the step as a minimisation with line search (`docs/vertices.md`).
//!
//! For given multipliers λ and a finite penalty α the step is a stationary point of the incremental potential
//!
//! ```text
//! P(δ) = (β q̈ₙ + δ)ᵀ M (β q̈ₙ + δ) / 2β + V(q) + λᵀΦ + α/2 ΦᵀΦ
//! ```
//!
//! A tangent made positive definite gives a descent direction. The step along it is halved until P decreases enough (Armijo). After every
//! full step λ is updated by the penalty term, as in the paper. If plain Newton iteration converges too, both find the same root.

use super::Settings;
use super::newton::{LAST_CORRECTION, Step};
use crate::integrator::convergence::Convergence;
use crate::integrator::{Counters, Implicit, TangentPoint};
use crate::vector::Vector;

/// Penalty αβ in multiples of the largest inertia: large enough for the multipliers to converge, small enough for P to be well conditioned.
const PENALTY: f64 = 1e4;
/// Largest number of iterations. Prototypes needed 3 on average and at most 30 at h = 1 ms.
const MOST_ITERATIONS: u32 = 60;
/// Largest number of halvings along one direction.
const MOST_HALVINGS: u32 = 30;
/// Required decrease of P relative to the linear prediction (Armijo).
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// Slope, relative to P, below which the decrease is lost in the round-off of P.
const FLAT: f64 = 1e-12;

/// Finds δ and λ, and the pose at the end of the step, if there is one. Only for systems with forces that have a potential.
#[cold]
pub(super) fn solve<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: Settings,
    step: &mut Step<N, M>,
    pose: &mut S::Pose,
    counters: &mut Counters,
) -> Option<()> {
    let mut q = step.q();
    *pose = system.pose(&q);
    system.potential(&q, pose)?;
    let heaviest = system.mass_times(pose, &Vector::from([1.0; N])).max_norm();
    let regularization = settings.regularization.max(1.0 / (PENALTY * heaviest));
    let (beta, alpha) = (step.beta, 1.0 / (regularization * step.beta));
    let merit = |step: &Step<N, M>, delta: Vector<N>| {
        let q = step.predicted + delta;
        let pose = system.pose(&q);
        let phi = system.phi(&q, &pose);
        let x = step.inertia + delta;
        let inertia = system.mass_times(&pose, &x).dot(&x) / (2.0 * beta);
        let constraint: f64 = phi.iter().zip(step.lambda.iter()).map(|(phi, lambda)| phi * (lambda + alpha / 2.0 * phi)).sum();
        system.potential(&q, &pose).map(|potential| inertia + potential + constraint)
    };

    let mut convergence = Convergence::new(step.tolerance, 0.0, LAST_CORRECTION);
    for _ in 0..MOST_ITERATIONS {
        counters.iterations += 1;
        let phi = system.phi(&q, pose);
        let v = step.velocity();
        let b = beta * system.forces(&q, pose, &v).0 - system.mass_times(pose, &step.acceleration());
        let c = -phi - regularization * beta * step.lambda;
        let total = step.lambda + alpha * phi;
        let at = TangentPoint { q: &q, pose, v: &v, lambda: &total, h: step.h };
        let (direction, y) = system.solve_descent(&at, regularization, &b, &c)?;
        let joint_forces = system.phi_q_transposed_times(pose, &total);
        let slope = (joint_forces - b / beta).dot(&direction);
        let start = merit(step, step.delta)?;

        // Near the minimum P is flat within round-off; the full step is then taken.
        let is_flat = slope.abs() < FLAT * start.abs().max(f64::MIN_POSITIVE);
        let decreases = |part: f64| {
            let bound = start + SUFFICIENT_DECREASE * part * slope;
            is_flat || merit(step, step.delta + part * direction).is_some_and(|merit| merit <= bound)
        };
        // Each line-search trial counts as an iteration.
        let found = (0..MOST_HALVINGS).find(|halvings| decreases(0.5f64.powi(*halvings as i32)));
        counters.iterations += u64::from(found.unwrap_or(MOST_HALVINGS));
        let part = 0.5f64.powi(found? as i32);
        step.delta += part * direction;
        if part == 1.0 {
            step.lambda = y / beta;
        }
        q = step.q();
        *pose = system.pose(&q);
        // Only a full step reveals how near the root is.
        convergence.corrected(if part == 1.0 { direction.max_norm() } else { f64::INFINITY });
        if convergence.is_met(system.phi(&q, pose).max_norm()) {
            counters.rescued += 1;
            return Some(());
        }
    }
    None
}
