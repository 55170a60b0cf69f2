//! Newton's method for the equations of a step: unknown increment δ and total multipliers λ (`docs/method.md`, (5) to (10)).

use super::stiff_forces::STIFF_RATE;
use super::{Settings, controls_rates};
use crate::integrator::convergence::{Convergence, LastCorrection};
use crate::integrator::{Counters, Implicit, State, StepError, StickingConstraint, Stuck, TangentPoint};
use crate::vector::Vector;

/// Step length, s, for which [`Settings::tolerance`] is given. Multiplier noise is Φ/β, so the tolerance is proportional to h².
const TOLERANCE_STEP: f64 = 1e-3;
/// Lower limit of the bound on |Φ|, relative to the system's size.
const LEAST_TOLERANCE: f64 = 16.0 * f64::EPSILON;
/// Bound on the last correction, m and rad. Because convergence is quadratic, the remaining error is below round-off.
pub(super) const LAST_CORRECTION: LastCorrection = LastCorrection::below(1e-5);

/// Unknowns of a step, and its constant data.
pub(super) struct Step<const N: usize, const M: usize> {
    /// Step length, s.
    pub(super) h: f64,
    /// β = h²/4, s².
    pub(super) beta: f64,
    /// Bound on max |Φ|, m.
    pub(super) tolerance: f64,
    /// Predictor q + h q̇ + h²/2 q̈.
    pub(super) predicted: Vector<N>,
    /// Predicted velocity q̇ + h q̈.
    v: Vector<N>,
    /// The product β q̈.
    pub(super) inertia: Vector<N>,
    /// Increment δ relative to the predictor, m and rad.
    pub(super) delta: Vector<N>,
    /// Total multipliers λ, N.
    pub(super) lambda: Vector<M>,
}

impl<const N: usize, const M: usize> Step<N, M> {
    /// Starts a step of h. δ is the increment relative to the predictor, which avoids the round-off of q̈ = 4/h² (q − …). Its first guess
    /// is β h times the jerk (19).
    pub(super) fn predict(state: &State<N, M>, h: f64, tolerance: f64) -> Self {
        let State { q, v, a, jerk, lambda, .. } = *state;
        let beta = h * h / 4.0;
        Self {
            h,
            beta,
            tolerance,
            predicted: q + h * (v + h / 2.0 * a),
            v: v + h * a,
            inertia: beta * a,
            delta: beta * h * jerk,
            lambda,
        }
    }

    /// Restarts the iteration with the predictor without jerk.
    pub(super) fn without_jerk(&self, state: &State<N, M>) -> Self {
        Self { delta: Vector::ZERO, lambda: state.lambda, ..*self }
    }

    /// Restarts the iteration with constant rates.
    pub(super) fn with_constant_rates(&self, state: &State<N, M>) -> Self {
        Self { delta: -2.0 * self.beta * state.a, ..self.without_jerk(state) }
    }

    /// Coordinates at the end of the step, m and rad.
    pub(super) fn q(&self) -> Vector<N> {
        self.predicted + self.delta
    }

    /// Velocity q̇ of the trapezoidal rule.
    pub(super) fn velocity(&self) -> Vector<N> {
        self.v + 2.0 / self.h * self.delta
    }

    /// β times the acceleration of the trapezoidal rule: β q̈ + δ.
    pub(super) fn acceleration(&self) -> Vector<N> {
        self.inertia + self.delta
    }
}

/// Newton's method on δ and λ: each iteration solves the saddle-point system (9) at the last iterate, until (17) is satisfied. `pose` is the
/// pose at the step's q, at first of the guess and then of the end: a returned pose would be copied.
pub(super) fn solve<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    step: &mut Step<N, M>,
    pose: &mut S::Pose,
    counters: &mut Counters,
) -> Result<(), StepError> {
    let &Settings { regularization, max_iterations, .. } = settings;
    let beta = step.beta;
    let mut convergence = Convergence::new(step.tolerance, system.length_scale(), LAST_CORRECTION);
    let mut held = None;
    loop {
        let q = step.q();
        let phi = system.phi(&q, pose);
        // Before the first iteration the correction is infinite.
        let met = convergence.is_met(phi.max_norm());
        if met && (!controls_rates(settings, system) || rates_converged(system, settings, step, held, (&q, pose))) {
            return Ok(());
        }
        if convergence.iterations >= max_iterations {
            return Err(convergence.failure());
        }
        counters.iterations += 1;
        let v = step.velocity();
        // Right-hand side of (9), then its solution: the correction Δq and y = β λ.
        let b = beta * system.forces(&q, pose, &v).0 - system.mass_times(pose, &step.acceleration());
        let c = -regularization * beta * step.lambda - phi;
        let at = TangentPoint { q: &q, pose, v: &v, lambda: &step.lambda, h: step.h };
        let (mut correction, mut y) = system.solve_tangent(&at, regularization, &b, &c)?;
        if system.stuck() != Stuck::Nothing {
            let (found, force) = keep_sticking(system, regularization, &at, (correction, y))?;
            ((correction, y), held) = (found, Some(force));
        }
        step.lambda = y / beta;
        step.delta += correction;
        *pose = system.pose(&step.q());
        convergence.corrected(correction.max_norm());
    }
}

/// Correction that keeps the sliding rate of the sticking constraint at 0, and the friction reaction, N and N·m.
#[cold]
fn keep_sticking<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    regularization: f64,
    at: &TangentPoint<'_, S::Pose, N, M>,
    (correction, y): (Vector<N>, Vector<M>),
) -> Result<((Vector<N>, Vector<M>), Vector<N>), StepError> {
    let StickingConstraint::Direction { row, force, .. } = system.sticking_constraint(at.q, at.pose, at.v) else {
        return Ok(((correction, y), Vector::ZERO));
    };
    let beta = at.h * at.h / 4.0;
    let (by_force, y_by_force) = system.solve_tangent(at, regularization, &(beta * force), &Vector::ZERO)?;
    // With the trapezoidal rule a correction changes the rate by 2/h times the correction.
    let mobility = row.dot(&by_force);
    if mobility == 0.0 {
        return Ok(((correction, y), Vector::ZERO));
    }
    let part = -(at.h / 2.0 * row.dot(at.v) + row.dot(&correction)) / mobility;
    Ok(((correction + part * by_force, y + part * y_by_force), part * force))
}

/// Whether the residual of the equilibrium changes the rates by less than a fraction of their admissible error. With stiff forces a small
/// correction of the coordinates does not imply a small residual.
#[cold]
fn rates_converged<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    step: &Step<N, M>,
    held: Option<Vector<N>>,
    (q, pose): (&Vector<N>, &S::Pose),
) -> bool {
    /// Admissible change of the rates, relative to their tolerance.
    const PART: f64 = 0.1;
    let v = step.velocity();
    let joint_forces = system.phi_q_transposed_times(pose, &step.lambda);
    let left = system.forces(q, pose, &v).0 + held.unwrap_or(Vector::ZERO)
        - joint_forces
        - system.mass_times(pose, &(step.acceleration() / step.beta));
    let inertia = system.mass_times(pose, &Vector::from([1.0; N]));
    let change = Vector::from_fn(|i| step.h / 2.0 * left[i] / inertia[i]);
    system.error_norm(&change) <= PART * settings.error_tolerance * (STIFF_RATE + system.error_norm(&v))
}

/// Bound on max |Φ|, m (17): proportional to the size of the machine and to h², but never below round-off.
pub(super) fn constraint_tolerance(settings: &Settings, length_scale: f64, h: f64) -> f64 {
    let scaled = settings.tolerance * (h / TOLERANCE_STEP) * (h / TOLERANCE_STEP);
    length_scale * scaled.clamp(LEAST_TOLERANCE.min(settings.tolerance), settings.tolerance)
}
