//! The second try of a Newton loop that failed: the step as a minimisation, with a line search.
//!
//! For given multipliers λ and a finite penalty α the step is a stationary point of the incremental potential
//!
//! ```text
//! P(δ) = (β q̈ₙ + δ)ᵀ M (β q̈ₙ + δ) / 2β + V(q) + λᵀΦ + α/2 ΦᵀΦ
//! ```
//!
//! A tangent made positive definite gives a direction of descent; the step along it is halved until P falls enough. λ takes the
//! penalty's share after every full step, as in the paper. Where plain Newton converges too, both find the same root.

use super::{Found, LAST_CORRECTION, Settings, Step};
use crate::integrator::vectors::{add, max_norm};
use crate::integrator::{Implicit, Kkt};

/// αβ in multiples of the largest inertia: enough for the multipliers to converge, little enough for P to be well conditioned.
const PENALTY: f64 = 1e4;
/// Most iterations; prototypes needed 3 on average and at most 30 at h = 1 ms.
const MOST_ITERATIONS: u32 = 60;
/// Most halvings along one direction.
const MOST_HALVINGS: u32 = 30;
/// Part of the decrease promised by the slope that must come (Armijo).
const ENOUGH: f64 = 1e-4;

/// Where the step leads, if δ and λ can be found. Only for systems whose forces have a potential.
#[cold]
pub(super) fn descend<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    mut step: Step<N, M>,
    spent: &mut u64,
) -> Option<Found<N, S::Pose>> {
    if !system.conservative() {
        return None;
    }
    let mut q = step.q();
    let mut pose = system.pose(&q);
    let heaviest = max_norm(&system.mass_times(&pose, &[1.0; N]));
    let softness = settings.softness.max(1.0 / (PENALTY * heaviest));
    let (beta, alpha) = (step.beta, 1.0 / (softness * step.beta));
    let merit = |step: &Step<N, M>, delta: &[f64; N]| {
        let q = add(&step.predicted, delta);
        let pose = system.pose(&q);
        let phi = system.phi(&q, &pose);
        let x = add(&step.inertia, delta);
        let inertia: f64 = system.mass_times(&pose, &x).iter().zip(&x).map(|(p, x)| p * x).sum::<f64>() / (2.0 * beta);
        let constraint: f64 = phi.iter().zip(&step.lambda).map(|(phi, lambda)| phi * (lambda + alpha / 2.0 * phi)).sum();
        system.potential(&q, &pose).map(|potential| inertia + potential + constraint)
    };

    for _ in 0..MOST_ITERATIONS {
        *spent += 1;
        let phi = system.phi(&q, &pose);
        let v = step.velocity();
        let force = system.forces(&q, &pose, &v);
        let inertia = system.mass_times(&pose, &step.acceleration());
        let b: [f64; N] = std::array::from_fn(|i| beta * force[i] - inertia[i]);
        let c = std::array::from_fn(|i| -phi[i] - softness * beta * step.lambda[i]);
        let total: [f64; M] = std::array::from_fn(|i| step.lambda[i] + alpha * phi[i]);
        let tangent = system.factor_descent(&q, &pose, &v, &total, step.h, softness)?;
        let (direction, y) = tangent.solve(&b, &c);
        let pull = system.phi_q_transposed_times(&pose, &total);
        let slope: f64 = (0..N).map(|i| (pull[i] - b[i] / beta) * direction[i]).sum();
        let start = merit(&step, &step.delta)?;

        // Near the minimum the decrease is lost in the round-off of P: the full step is taken.
        let blind = slope.abs() < 1e-12 * start.abs().max(f64::MIN_POSITIVE);
        let mut part = 1.0;
        let found = (0..MOST_HALVINGS).any(|_| {
            let delta = std::array::from_fn(|i| step.delta[i] + part * direction[i]);
            let enough = blind || merit(&step, &delta).is_some_and(|merit| merit <= start + ENOUGH * part * slope);
            if !enough {
                part /= 2.0;
            }
            enough
        });
        if !found {
            return None;
        }
        step.delta = std::array::from_fn(|i| step.delta[i] + part * direction[i]);
        if part == 1.0 {
            step.lambda = y.map(|y| y / beta);
        }
        q = step.q();
        pose = system.pose(&q);
        if max_norm(&system.phi(&q, &pose)) < step.tolerance && part == 1.0 && max_norm(&direction) < LAST_CORRECTION {
            return Some(Found { q, pose, v: step.velocity() });
        }
    }
    None
}
