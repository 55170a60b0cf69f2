//! i3-ALP as the paper prints it, its misprints corrected (`docs/method.md`, "Errata"): for comparison.
//!
//! A fixed penalty α, the tangent without the derivative of Φ_qᵀλ, absolute unknowns, one projection, no sub-steps. Every linear
//! system (A₀ + αβ Φ_qᵀΦ_q) x = r + αβ Φ_qᵀ c is solved as [A₀ Φ_qᵀ; Φ_q −e] [x; y] = [r; c] with e = 1/(αβ): the same x.

use super::system::local_error;
use super::vectors::{add, finite, max_norm, minus};
use super::{Failure, Implicit, Kkt, Power, State};

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Penalty factor α, N/m, the same at every h.
    pub penalty: f64,
    /// Most Newton iterations per step.
    pub max_iterations: u32,
}

/// Newton stops when |Δq| and |Φ| are below this part of the system's size. With a fixed α both fall by a constant factor per
/// iteration, slower near singularities: a tighter bound is not met in ten iterations on the paper's own free fall.
const STOP: f64 = 1e-8;

/// One step of h seconds. On failure the state is undefined: the caller keeps a copy.
#[inline(never)]
pub fn advance<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    settings: &Settings,
    state: &mut State<N, M>,
    h: f64,
    power: &mut Power,
) -> Result<(), Failure> {
    let alpha = settings.penalty;
    let beta = h * h / 4.0;
    let softness = 1.0 / (alpha * beta);
    let tolerance = STOP * system.size();

    // Predict; trapezoidal rule.
    let State { q: q0, v: v0, a: a0, .. } = *state;
    let mut q: [f64; N] = std::array::from_fn(|i| q0[i] + h * v0[i] + h * h / 2.0 * a0[i]);
    let velocity = |q: &[f64; N]| -> [f64; N] { std::array::from_fn(|i| 2.0 / h * q[i] - (2.0 / h * q0[i] + v0[i])) };
    let acceleration = |q: &[f64; N]| -> [f64; N] {
        std::array::from_fn(|i| 4.0 / (h * h) * q[i] - (4.0 / (h * h) * q0[i] + 4.0 / h * v0[i] + a0[i]))
    };
    // The approximate tangent leaves out ∂(Φ_qᵀλ)/∂q: as if λ were 0.
    let no_multipliers = [0.0; M];

    // Newton: A Δq = −f with f = β [M q̈ + Φ_qᵀ(αΦ + λ*) − Q]; λ* ← λ* + αΦ after every iteration.
    let mut pose = system.pose(&q);
    let mut phi = system.phi(&q, &pose);
    let mut iterations = 0;
    loop {
        iterations += 1;
        state.counters.iterations += 1;
        let v = velocity(&q);
        let inertia = system.mass_times(&pose, &acceleration(&q));
        let constraint = system.phi_q_transposed_times(&pose, &state.lambda);
        let force = system.forces(&q, &pose, &v);
        let residual = std::array::from_fn(|i| -beta * (inertia[i] + constraint[i] - force[i]));
        // By reference: a factor may be large, and `?` would move it.
        let tangent = system.factor_tangent(&q, &pose, &v, &no_multipliers, h, softness);
        let tangent = tangent.as_ref().map_err(|failure| *failure)?;
        let (correction, _) = tangent.solve(&residual, &minus(&phi));
        q = add(&q, &correction);
        pose = system.pose(&q);
        phi = system.phi(&q, &pose);
        state.lambda = std::array::from_fn(|i| state.lambda[i] + alpha * phi[i]);

        let (violation, correction) = (max_norm(&phi), max_norm(&correction));
        if violation < tolerance && correction < tolerance {
            break;
        }
        if iterations == settings.max_iterations {
            return Err(Failure::NotConverged { iterations, violation, tolerance, correction });
        }
    }

    // Project: A q̇ = W q̇*, then A q̈ = W q̈* − βα Φ_qᵀ Φ̇_q q̇, with W = M + h/2 C + h²/4 K.
    let v = velocity(&q);
    let tangent = system.factor_tangent(&q, &pose, &v, &no_multipliers, h, softness);
    let tangent = tangent.as_ref().map_err(|failure| *failure)?;
    let (projected, _) = tangent.solve(&system.weight_times(&q, &pose, &v, h, &v), &[0.0; M]);
    let centripetal = minus(&system.phi_q_dot_times(&pose, &projected));
    let (a, _) = tangent.solve(&system.weight_times(&q, &pose, &v, h, &acceleration(&q)), &centripetal);
    if !(finite(&q) && finite(&projected) && finite(&a)) {
        return Err(Failure::NotFinite);
    }

    let projection: [f64; N] = std::array::from_fn(|i| projected[i] - v[i]);
    state.error_estimate = local_error(system, h, [&a0, &a], &projection);
    (state.q, state.v, state.a) = (q, projected, a);
    if system.follows_work() {
        let at_end = system.power(&q, &pose, &projected);
        state.work = state.work.plus(h / 2.0, *power).plus(h / 2.0, at_end);
        *power = at_end;
    }
    state.observe_modes(system.modes(&pose));
    state.counters.steps += 1;
    state.counters.substeps += 1;
    Ok(())
}
