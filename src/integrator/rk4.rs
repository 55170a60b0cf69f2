//! Classical Runge–Kutta of order 4 on the index-1 augmented form, the paper's Eq. (4), at fixed step.
//!
//! (M + Φ_qᵀαΦ_q) q̈ = Q − Φ_qᵀα Φ̇_q q̇, solved as a saddle-point system with e = 1/α. The stabilising terms 2μωΦ̇ + ω²Φ are left
//! out (μ = ω = 0): the projection after each step does their work, and exactly.

use super::equilibrium::{equilibrium, equilibrium_at};
use super::projection::{self, Projection};
use super::vectors::{add, finite};
use super::{Failure, Power, State, System};

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Whether positions and velocities are projected onto the constraints after each step.
    pub projection: bool,
    /// e = 1/α of the index-1 form, 1/kg.
    pub softness: f64,
    /// Projection: constraint violation relative to the system's size.
    pub tolerance: f64,
    /// Most iterations of the position projection.
    pub max_iterations: u32,
}

/// One step of h seconds. On failure the state is undefined: the caller keeps a copy.
#[inline(never)]
pub fn advance<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    settings: &Settings,
    state: &mut State<N, M>,
    h: f64,
    power: &mut Power,
) -> Result<(), Failure> {
    // The first stage is the state's own q̈. Work has the weights of the stages.
    let (q0, v0) = (state.q, state.v);
    let (mut q_sum, mut v_sum) = (v0, state.a);
    let (mut q_rate, mut v_rate) = (v0, state.a);
    state.work = state.work.plus(h / 6.0, *power);
    for (part, weight) in [(0.5, 2.0), (0.5, 2.0), (1.0, 1.0)] {
        let q = std::array::from_fn(|i| q0[i] + part * h * q_rate[i]);
        let v = std::array::from_fn(|i| v0[i] + part * h * v_rate[i]);
        (v_rate, _) = equilibrium(system, &q, &v, settings.softness);
        q_rate = v;
        for i in 0..N {
            q_sum[i] += weight * q_rate[i];
            v_sum[i] += weight * v_rate[i];
        }
        if system.follows_work() {
            state.work = state.work.plus(weight * h / 6.0, system.power(&q, &system.pose(&q), &v));
        }
    }
    state.q = std::array::from_fn(|i| q0[i] + h / 6.0 * q_sum[i]);
    state.v = std::array::from_fn(|i| v0[i] + h / 6.0 * v_sum[i]);
    if !(finite(&state.q) && finite(&state.v)) {
        return Err(Failure::NotFinite);
    }

    if settings.projection {
        let &Settings { softness, max_iterations, .. } = settings;
        let projection = Projection { softness, tolerance: settings.tolerance * system.size(), max_iterations };
        let (iterations, _) = projection.position(system, &mut state.q)?;
        state.counters.iterations += u64::from(iterations);
    }
    let pose = system.pose(&state.q);
    let mass = system.factor_mass(&pose, settings.softness);
    if settings.projection {
        let correction = projection::velocity(system, &pose, &mass, &state.v);
        state.v = add(&state.v, &correction);
    }
    (state.a, state.lambda) = equilibrium_at(system, &state.q, &pose, &state.v, &mass);
    if !finite(&state.a) {
        return Err(Failure::NotFinite);
    }
    if system.follows_work() {
        *power = system.power(&state.q, &pose, &state.v);
    }
    state.observe_modes(system.modes(&pose));
    state.counters.steps += 1;
    state.counters.substeps += 1;
    Ok(())
}
