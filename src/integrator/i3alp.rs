//! The default method: index-3 augmented Lagrangian with velocity and acceleration projections, in dual form.
//!
//! `docs/method.md` derives it from the paper's equations. With A₀ the tangent without penalty and e = 1/(αβ), the penalty step
//! (A₀ + αβ Φ_qᵀΦ_q) Δq = −f, λ* ← λ* + αΦ is the saddle-point system
//!
//! ```text
//! [ A₀   Φ_qᵀ ] [ Δq ]   [ β Q − M (β q̈ₙ + δ) ]
//! [ Φ_q   −e  ] [ βλ ] = [ −Φ − e β λ*         ]        β = h²/4
//! ```
//!
//! in which the unknown is the total multiplier: nothing large enters a diagonal, nothing winds up.

mod damping;
mod events;
mod line_search;
mod newton;
mod stiff_forces;

use super::controller::{LEAST_LOG_ERROR, StepSizeController, ln, next_step};
use super::{
    Approach, Events, Implicit, Passage, PassageLimits, State, StepEnd, StepError, StepLimits, Transit, velocity_correction,
};
use crate::vector::Vector;
use events::{Outcome, Search};
use newton::{Found, Step, constraint_tolerance};
use std::borrow::Borrow;
use stiff_forces::{drive_work, steep_error};

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Whether a macro step is divided into as many sub-steps as the local error asks.
    pub adaptive: bool,
    /// Local error allowed per sub-step, over the link angles, rad.
    pub error_tolerance: f64,
    /// Newton: constraint violation relative to the system's size, at h = 1 ms.
    pub tolerance: f64,
    /// Most Newton iterations per sub-step.
    pub max_iterations: u32,
    /// More work than this in one macro step, that of rejected sub-steps included, ends it with a status: a call never hangs. Newton iterations
    /// by what their linear solve costs, tries of line searches, sub-steps.
    pub max_work: u32,
    /// The balance of energy of a step may be off by the error tolerance times this, J, where forces change steeply.
    pub energy_scale: f64,
    /// Energy at the start, J, of a run where forces change steeply.
    pub energy_at_start: f64,
    /// e = 1/(αβ) = 1/(κ m̄), 1/kg, for a penalty α of κ times m̄/β: the same at every h.
    pub regularization: f64,
}

/// Over a step shorter than this, s, a change of q̈ is round-off and gives no jerk.
const SHORTEST_FOR_JERK: f64 = 1e-10;
/// A step shorter than this, s, moves on by its Taylor series, which is then exact: Newton would divide round-off by h².
const SHORTEST_FOR_NEWTON: f64 = 1e-12;
/// The local error is of third order.
const CONTROLLER: StepSizeController =
    StepSizeController { exponent: 1.0 / 3.0, memory: 0.0, accepted: [0.5, 2.0], rejected: [0.1, 0.7], failed: 0.35 };

/// One macro step of h seconds, from the sides on which the grips of dry friction are: in one step, or in sub-steps. On failure state and
/// sides are undefined: the caller keeps a copy.
#[inline(never)]
pub fn advance<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
    system: &S,
    settings: &Settings,
    state: &mut State<N, M>,
    mode: &mut S::Mode,
    h: f64,
) -> Result<(), StepError> {
    if settings.adaptive {
        return in_substeps(system, settings, (state, mode), h);
    }
    attempt(system, settings, state, h, &StepLimits::NONE)?.accept(system, state, h);
    Ok(())
}

/// A macro step in equal parts, as many as the local error asks, asked anew after each.
#[inline(never)]
fn in_substeps<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
    without_sides: &S,
    settings: &Settings,
    (state, mode): (&mut State<N, M>, &mut S::Mode),
    duration: f64,
) -> Result<(), StepError> {
    let passage = PassageLimits::for_error_tolerance(settings.error_tolerance);
    let (mut rest, mut h, mut error) = (duration, duration, f64::INFINITY);
    let mut search = Search::NONE;
    let done = state.counters.iterations;
    // Every round counts as one more: one through a vertex has no iteration.
    for rounds in 0.. {
        if rounds + without_sides.iteration_work() * (state.counters.iterations - done) > u64::from(settings.max_work) {
            break;
        }
        let in_mode = without_sides.on(*mode);
        let system: &S = in_mode.borrow();
        if system.is_at_rest() {
            state.counters.substeps += 1;
            return Ok(());
        }
        let limits = match system.approach(&passage, &state.departure(rest)) {
            Approach::Clear => StepLimits::NONE,
            Approach::Limited(limits) => limits,
            Approach::Passed(transit) => {
                rest = pass(without_sides, settings, state, (mode, &transit), rest)?;
                if rest <= 0.0 {
                    return Ok(());
                }
                continue;
            }
        };
        let tolerance = settings.error_tolerance.max(limits.round_off);
        h = search.next().unwrap_or_else(|| rest / (rest / state.substep.min(limits.longest)).ceil().max(1.0));
        let attempt = attempt(system, settings, state, h, &limits);
        error = attempt.as_ref().map_or(f64::NAN, |attempt| attempt.error);
        match attempt {
            Ok(attempt) if error <= tolerance => {
                let outcome = if system.has_stick_slip() {
                    search.judge(system, settings, state, (&attempt.end, h))
                } else {
                    Outcome::Passes
                };
                if outcome == Outcome::Again {
                    state.counters.rejected += 1;
                    continue;
                }
                let last = h >= rest;
                state.substep = next_step(h, CONTROLLER.growth(ln(error / tolerance), LEAST_LOG_ERROR), state.substep);
                if settings.watches_rates(system) {
                    state.work.input += drive_work(system, h, state, &attempt.end);
                }
                attempt.accept(system, state, h);
                if outcome == Outcome::Turns {
                    events::turn(system, settings, state, mode);
                }
                search = Search::NONE;
                if last {
                    return Ok(());
                }
                rest -= h;
            }
            _ => {
                search = Search::NONE;
                if let Some(transit) = system.cross_bifurcation(&state.q, &state.v, h) {
                    state.counters.rescued += 1;
                    rest = pass(without_sides, settings, state, (mode, &transit), rest)?;
                    if rest <= 0.0 {
                        return Ok(());
                    }
                    continue;
                }
                state.substep = h * CONTROLLER.reduction(error / tolerance);
                state.counters.rejected += 1;
            }
        }
    }
    let error = if error.is_nan() { f64::INFINITY } else { error };
    Err(StepError::TooMuchWork { most: settings.max_work, substep: h, error })
}

/// Goes where the system has gone by itself; what is left of so many seconds.
#[cold]
fn pass<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
    without_sides: &S,
    settings: &Settings,
    state: &mut State<N, M>,
    (mode, transit): (&mut S::Mode, &Transit<N>),
    rest: f64,
) -> Result<f64, StepError> {
    state.pass_through(without_sides.on(*mode).borrow(), transit, settings.regularization)?;
    *mode = without_sides.mode_of(&state.q, &state.v);
    Ok(rest - transit.duration)
}

/// A sub-step that converged, not yet accepted.
struct Attempt<const N: usize, const M: usize> {
    end: StepEnd<N, M>,
    /// Local error, rad.
    error: f64,
}

/// One step of h: predictor, Newton on positions and total multipliers, velocity projection, acceleration from equilibrium.
#[inline(never)] // one copy for fixed steps and sub-steps: 33 kB, for 1.5 % more instructions of a bare step
fn attempt<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
    system: &S,
    settings: &Settings,
    state: &mut State<N, M>,
    h: f64,
    limits: &StepLimits,
) -> Result<Attempt<N, M>, StepError> {
    if h < SHORTEST_FOR_NEWTON {
        return taylor_step(system, state, h, settings.regularization);
    }
    let settings = Settings { regularization: limits.regularization * settings.regularization, ..*settings };
    let mut step = Step::predict(state, h, constraint_tolerance(&settings, system.length_scale(), h));
    let mut again = false;
    let found = loop {
        match newton::solve(system, &settings, &mut step, &mut state.counters) {
            Ok(found) => break found,
            // Stiff friction lets the rates stay what they are, where the accelerations foretell others.
            Err(_) if settings.watches_rates(system) && !again => (step, again) = (step.with_rates_of(state), true),
            Err(error) => {
                break line_search::solve(&system.general(), settings, step.anew(state), &mut state.counters).ok_or(error)?;
            }
        }
    };

    // Project the velocity, then the acceleration and the multipliers from equilibrium: one factor serves both.
    let Found { q, pose, v } = found;
    let mass = system.factor_mass_in_place(&pose, settings.regularization);
    let correction = velocity_correction(system, &pose, &mass, &v);
    let mut v = v + correction;
    if system.holds() {
        v = system.project_sticking(q, v);
    }
    if let Some(energy) = &limits.energy {
        v = system.energy_scale(energy, &q, &v, h)? * v;
    }
    let mut end = StepEnd::in_balance(system, [q, v], &pose, &mass);
    // Next to a vertex the rates have been given their energy.
    if settings.watches_rates(system) && limits.energy.is_none() {
        end = damping::damped(system, &settings, state, h, (&pose, &mass), end);
    }
    let mut error = local_error(system, h, &(end.a - state.a), &correction);
    if settings.watches_rates(system) {
        error = error.max(steep_error(system, &settings, state, h, (&pose, &end)));
    }
    if error.is_finite() && end.a.is_finite() { Ok(Attempt { end, error }) } else { Err(StepError::NotFinite) }
}

impl Settings {
    /// Whether rates are judged beside the angles: where forces change steeply with them, the angles do not tell that they ring.
    #[inline(always)]
    fn watches_rates<const N: usize, const M: usize>(&self, system: &impl Implicit<N, M>) -> bool {
        self.adaptive && system.has_stiff_forces()
    }
}

/// A step so short that q̈ and λ stay but for round-off.
#[cold]
fn taylor_step<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    state: &State<N, M>,
    h: f64,
    regularization: f64,
) -> Result<Attempt<N, M>, StepError> {
    let end = StepEnd::out_of_line(system, [state.q + h * state.v, state.v + h * state.a], regularization).finite()?;
    Ok(Attempt { end, error: 0.0 })
}

impl<const N: usize, const M: usize> Attempt<N, M> {
    /// Makes the attempt the new state.
    #[inline(always)]
    fn accept(self, system: &impl Implicit<N, M>, state: &mut State<N, M>, h: f64) {
        let Self { end, error } = self;
        if h >= SHORTEST_FOR_JERK {
            state.jerk = (end.a - state.a) / h;
        }
        if system.follows_work() {
            // Trapezoidal rule, of the order of the method.
            state.work = state.work.plus(h / 2.0, state.power).plus(h / 2.0, end.power);
        }
        state.error_estimate = error;
        state.arrive(&end);
    }
}

/// Local error of a step of h over the angles: of the trapezoidal rule, from the change of q̈, and of the velocity projection.
#[inline(always)]
pub(super) fn local_error<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    h: f64,
    jump: &Vector<N>,
    correction: &Vector<N>,
) -> f64 {
    Vector::from([h * h / 12.0 * system.error_norm(jump), h / 2.0 * system.error_norm(correction)]).max_norm()
}
