//! Classical Runge–Kutta method of order 4 with fixed steps, on the index-1 augmented form, the paper's Eq. (4).
//!
//! (M + Φ_qᵀαΦ_q) q̈ = Q − Φ_qᵀα Φ̇_q q̇ is solved as a saddle-point system with e = 1/α. The stabilising terms 2μωΦ̇ + ω²Φ are
//! omitted (μ = ω = 0): the projection after each step replaces them exactly.

use borsh::{BorshDeserialize, BorshSerialize};

use super::equilibrium::equilibrium;
use super::{Posed, Projection, State, StepEnd, StepError, System, velocity_correction};

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Settings {
    /// Regularisation e = 1/α of the index-1 form, 1/kg.
    pub regularization: f64,
    /// Admissible constraint violation of the projection, relative to the system's size.
    pub tolerance: f64,
    /// Largest number of iterations of the position projection.
    pub max_iterations: u32,
}

/// Makes one step of `h` seconds. Fails if the projection does not converge or a value is not finite; `state` is then undefined, so the
/// caller keeps a copy.
pub fn advance<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    settings: &Settings,
    state: &mut State<N, M>,
    h: f64,
) -> Result<(), StepError> {
    let &Settings { regularization, max_iterations, .. } = settings;
    // The first stage is the state's own q̈. Work is integrated with the weights of the stages.
    let State { q: q0, v: v0, .. } = *state;
    let (mut q_sum, mut v_sum) = (v0, state.a);
    let (mut q_rate, mut v_rate) = (v0, state.a);
    let mut work = state.work.plus(h / 6.0, state.power);
    for (part, weight) in [(0.5, 2.0), (0.5, 2.0), (1.0, 1.0)] {
        let q = q0 + part * h * q_rate;
        let v = v0 + part * h * v_rate;
        let power;
        (v_rate, _, power) = equilibrium(system, Posed { q: &q, pose: &system.pose(&q), v: &v }, regularization);
        q_rate = v;
        q_sum += weight * q_rate;
        v_sum += weight * v_rate;
        work = work.plus(weight * h / 6.0, power);
    }
    let (mut q, mut v) = (q0 + h / 6.0 * q_sum, v0 + h / 6.0 * v_sum);
    if !(q.is_finite() && v.is_finite()) {
        return Err(StepError::NotFinite);
    }

    let tolerance = settings.tolerance * system.length_scale();
    let (iterations, _) = Projection { regularization, tolerance, max_iterations }.position(system, &mut q)?;
    state.counters.iterations += u64::from(iterations);
    let pose = system.pose(&q);
    let mass = system.factor_mass(&pose, regularization);
    v += velocity_correction(system, &pose, &mass, &v);
    state.work = work;
    state.take_over(&StepEnd::in_balance(system, [q, v], &pose, &mass).finite()?);
    Ok(())
}
