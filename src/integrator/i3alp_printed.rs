//! i3-ALP as printed in the paper, with misprints corrected (`docs/method.md`, "Errata of the paper"), for comparison.
//!
//! It uses a fixed penalty α, the tangent without the derivative of Φ_qᵀλ, absolute unknowns, one projection and no sub-steps. Every linear
//! system (A₀ + αβ Φ_qᵀΦ_q) x = r + αβ Φ_qᵀ c is solved as [A₀ Φ_qᵀ; Φ_q −e] [x; y] = [r; c] with e = 1/(αβ), which has the same x.

use borsh::{BorshDeserialize, BorshSerialize};

use super::convergence::{Convergence, LastCorrection};
use super::i3alp::local_error;
use super::{Implicit, State, StepEnd, StepError, TangentPoint};
use crate::vector::Vector;

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Settings {
    /// Penalty factor α, N/m, constant at every h.
    pub penalty: f64,
    /// Largest number of Newton iterations per step.
    pub max_iterations: u32,
}

/// Bound on |Δq| and |Φ| at which Newton's method stops, relative to the size of the system. With a fixed α, |Δq| and |Φ| fall linearly,
/// and more slowly near singularities: ten iterations do not meet a tighter bound in the paper's own free fall.
const STOP: f64 = 1e-8;

/// Makes one step of `h` seconds. Fails if Newton's method does not converge, the tangent is not positive definite or a value is not
/// finite; `state` is then undefined, so the caller keeps a copy. `weigh` multiplies by the weight of the projections, M + h/2 C + h²/4 K with
/// K = −∂Q/∂q and C = −∂Q/∂q̇.
pub fn advance<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    weigh: impl Fn(&TangentPoint<'_, S::Pose, N, M>, &Vector<N>) -> Vector<N>,
    settings: &Settings,
    state: &mut State<N, M>,
    h: f64,
) -> Result<(), StepError> {
    let alpha = settings.penalty;
    let beta = h * h / 4.0;
    let regularization = 1.0 / (alpha * beta);
    let tolerance = STOP * system.length_scale();

    // Predictor; trapezoidal rule (1).
    let State { q: q0, v: v0, a: a0, .. } = *state;
    let mut q = q0 + h * v0 + h * h / 2.0 * a0;
    let velocity = |q: Vector<N>| 2.0 / h * q - (2.0 / h * q0 + v0);
    let acceleration = |q: Vector<N>| 4.0 / (h * h) * q - (4.0 / (h * h) * q0 + 4.0 / h * v0 + a0);

    // Newton (2), (3): A Δq = −f with f = β [M q̈ + Φ_qᵀ(αΦ + λ*) − Q]; λ* ← λ* + αΦ after every iteration.
    let mut pose = system.pose(&q);
    let mut phi = system.phi(&q, &pose);
    let mut convergence = Convergence::new(tolerance, 0.0, LastCorrection::below(tolerance));
    loop {
        state.counters.iterations += 1;
        let v = velocity(q);
        let inertia = system.mass_times(&pose, &acceleration(q));
        let constraint = system.phi_q_transposed_times(&pose, &state.lambda);
        let residual = -beta * (inertia + constraint - system.forces(&q, &pose, &v).0);
        // The approximate tangent omits ∂(Φ_qᵀλ)/∂q, as if λ were 0.
        let at = TangentPoint { q: &q, pose: &pose, v: &v, lambda: &Vector::ZERO, h };
        let (correction, _) = system.solve_tangent(&at, regularization, &residual, &-phi)?;
        q += correction;
        pose = system.pose(&q);
        phi = system.phi(&q, &pose);
        state.lambda += alpha * phi;

        convergence.corrected(correction.max_norm());
        if convergence.is_met(phi.max_norm()) {
            break;
        }
        if convergence.iterations == settings.max_iterations {
            return Err(convergence.failure());
        }
    }

    // Projection (4): A q̇ = W q̇*, then A q̈ = W q̈* − βα Φ_qᵀ Φ̇_q q̇, with W = M + h/2 C + h²/4 K.
    let v = velocity(q);
    let at = TangentPoint { q: &q, pose: &pose, v: &v, lambda: &Vector::ZERO, h };
    let (projected, _) = system.solve_tangent(&at, regularization, &weigh(&at, &v), &Vector::ZERO)?;
    let centripetal = -system.phi_q_dot_times(&pose, &projected);
    let (a, _) = system.solve_tangent(&at, regularization, &weigh(&at, &acceleration(q)), &centripetal)?;

    let end = StepEnd::new(system, [q, projected, a], &pose, state.lambda).finite()?;
    state.error_estimate = local_error(system, h, &(a - a0), &(projected - v));
    state.work = state.work.plus(h / 2.0, state.power).plus(h / 2.0, end.power);
    state.take_over(&end);
    Ok(())
}
