//! The default method: index-3 augmented Lagrangian with projections (i3-ALP) in dual form, with error-controlled sub-steps.
//!
//! `docs/method.md` (section 5) derives the step from the paper's equations. With the tangent A₀ without penalty and e = 1/(αβ), the
//! penalty step (A₀ + αβ Φ_qᵀΦ_q) Δq = −f, λ* ← λ* + αΦ is equivalent to the saddle-point system
//!
//! ```text
//! [ A₀   Φ_qᵀ ] [ Δq ]   [ β Q − M (β q̈ₙ + δ) ]
//! [ Φ_q   −e  ] [ βλ ] = [ −Φ − e β λ*         ]        β = h²/4
//! ```
//!
//! for the total multiplier λ. No diagonal contains a large term, and no multiplier accumulates over the steps.

mod damping;
mod line_search;
mod newton;
mod stiff_forces;

use borsh::{BorshDeserialize, BorshSerialize};

use super::checks::Imbalance;
use super::controller::{LEAST_LOG_ERROR, StepSizeController, ln, next_step};
use super::dense_output::Interpolant;
pub use super::driver::Progress;
use super::driver::{self, Limits, Method, Outcome, Trials};
use super::equilibrium::project_sticking;
use super::events::separation_loss;
use super::locator::{self, EventCheck, Path, Probe};
use super::{
    Events, Implicit, Mechanics, PassageLimits, Posed, State, StepEnd, StepError, StepLimits, Stuck, Transit, velocity_correction,
};
use crate::vector::Vector;
use newton::{Step, constraint_tolerance};
use stiff_forces::stiff_error;

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Settings {
    /// Whether a macro step is divided into sub-steps by the local error.
    pub adaptive: bool,
    /// Admissible local error per sub-step, over the link angles, rad.
    pub error_tolerance: f64,
    /// Admissible constraint violation of Newton's method, relative to the system's size, at h = 1 ms.
    pub tolerance: f64,
    /// Largest number of Newton iterations per sub-step.
    pub max_iterations: u32,
    /// Largest work per macro step including rejected sub-steps, so that every call ends. Work counts Newton iterations, weighted by the
    /// cost of their linear solve, line-search trials and sub-steps.
    pub max_work: u32,
    /// Energy scale, J. Its product with the error tolerance bounds the error of a step's energy balance; used with stiff forces.
    pub energy_scale: f64,
    /// Total energy at the start, J; used with stiff forces.
    pub energy_at_start: f64,
    /// Regularisation e = 1/(αβ) = 1/(κ m̄), 1/kg, for the penalty α = κ m̄/β, at every h.
    pub regularization: f64,
}

/// Shortest sub-step for which the predictor uses a jerk, s: in shorter sub-steps the change of q̈ is round-off.
const SHORTEST_FOR_JERK: f64 = 1e-10;
/// Shortest step solved by Newton's method, s. In shorter steps the Taylor series is exact, while Newton's method would divide round-off by
/// h².
const SHORTEST_FOR_NEWTON: f64 = 1e-12;
/// Longest stretch for a parabola of sticking friction, relative to the step. The local error bounds the change of the accelerations, so
/// reactions bend little over a step.
const LONGEST_PARABOLA: f64 = 1.0;
/// Step-size controller for a local error of third order.
const CONTROLLER: StepSizeController =
    StepSizeController { exponent: 1.0 / 3.0, memory: 0.0, accepted: [0.5, 2.0], rejected: [0.1, 0.7], failed: 0.35 };

/// A macro step in progress.
#[derive(Clone, Copy, Debug)]
pub struct MacroStep {
    /// Time left, s.
    rest: f64,
    /// Work done: sub-steps, whether tried or through a vertex, and weighted iterations.
    work: u64,
    /// Length, s, and error, rad, of the last sub-step tried.
    last: [f64; 2],
    /// Longest sub-step after the last rejection, s.
    shorter: f64,
    /// Whether the system could not compute a step near a bifurcation, so that this method tries the rest.
    uncrossed: bool,
}

impl MacroStep {
    /// Starts a macro step of `h` seconds.
    pub fn of(h: f64) -> Self {
        Self { rest: h, work: 0, last: [h, f64::INFINITY], shorter: h, uncrossed: false }
    }

    /// Continues in `mode`, in one step or in error-controlled sub-steps. Fails if a fixed step cannot be solved, a sub-step fails its
    /// checks or the work exceeds its limit; `state` and `mode` are then undefined, so the caller keeps a copy.
    #[inline(never)]
    pub fn advance<const N: usize, const M: usize, S: Implicit<N, M> + Mechanics<N, M>>(
        &mut self,
        system: &S,
        settings: &Settings,
        state: &mut State<N, M>,
        mode: &mut S::Mode,
    ) -> Result<Progress, StepError> {
        if !settings.adaptive {
            let h = self.rest;
            attempt(system, settings, state, h, (&StepLimits::NONE, None))?.accept(system, state, h);
            return Ok(Progress::Done);
        }
        let tolerance = settings.error_tolerance;
        let passage = PassageLimits::for_error_tolerance(tolerance);
        let limits = Limits { passage, tolerance, imbalance: Imbalance::of_third_order(tolerance, settings.energy_scale) };
        while self.rest > 0.0 {
            self.check_work(settings)?;
            if !self.uncrossed
                && let Some(h) = system.must_cross(&state.q, &state.v, state.substep.min(self.rest), self.rest)
            {
                return Ok(Progress::Blocked(h));
            }
            let mut substep = Substep { of: self, settings, state, mode, limits: StepLimits::NONE };
            if let Progress::Blocked(h) = driver::step(&mut substep, system, &limits)? {
                return Ok(Progress::Blocked(h));
            }
        }
        Ok(Progress::Done)
    }

    /// Continues after a blocked sub-step: applies the transit past the bifurcation or, without one, tries a shorter sub-step. Returns
    /// whether the macro step is done or blocked again.
    pub fn cross<const N: usize, const M: usize, S: Implicit<N, M> + Mechanics<N, M>>(
        &mut self,
        system: &S,
        settings: &Settings,
        state: &mut State<N, M>,
        mode: &mut S::Mode,
        transit: Option<&Transit<N>>,
    ) -> Result<Progress, StepError> {
        if let Some(transit) = transit {
            state.counters.rescued += 1;
            *mode = state.pass_through(system, transit, settings.regularization)?;
            self.work += 1;
            self.rest = if transit.duration >= self.rest { 0.0 } else { self.rest - transit.duration };
        } else {
            self.uncrossed = true;
            state.substep = state.substep.min(self.shorter);
            state.counters.rejected += 1;
        }
        self.advance(system, settings, state, mode)
    }

    /// Sub-step, s, that divides the remaining time into equal parts of at most `longest` seconds.
    fn divided(&self, longest: f64) -> f64 {
        self.rest / (self.rest / longest).ceil().max(1.0)
    }

    /// Refuses work above the limit of a macro step.
    fn check_work(&self, &Settings { max_work, .. }: &Settings) -> Result<(), StepError> {
        let [substep, error] = self.last;
        let error = if error.is_nan() { f64::INFINITY } else { error };
        if self.work <= u64::from(max_work) { Ok(()) } else { Err(StepError::TooMuchWork { most: max_work, substep, error }) }
    }
}

/// A sub-step under trial. Each sub-step again divides the rest of the macro step into equal parts.
struct Substep<'a, S: Events<N>, const N: usize, const M: usize> {
    of: &'a mut MacroStep,
    settings: &'a Settings,
    state: &'a mut State<N, M>,
    mode: &'a mut S::Mode,
    limits: StepLimits,
}

impl<S: Implicit<N, M> + Mechanics<N, M>, const N: usize, const M: usize> Method<N, M, S> for Substep<'_, S, N, M> {
    fn start(&self) -> &State<N, M> {
        self.state
    }

    fn end(&self) -> &State<N, M> {
        self.state
    }

    fn initial_mode(&self) -> S::Mode {
        *self.mode
    }

    fn longest(&self) -> f64 {
        self.of.rest
    }

    fn enter(&mut self, system: &S, mode: S::Mode) {
        if mode != *self.mode {
            *self.mode = mode;
            self.state.reinitialize(&*system.on(mode), &system.pose(&self.state.q), self.settings.regularization);
        }
    }

    fn rest(&mut self) {
        self.state.counters.substeps += 1;
        self.of.rest = 0.0;
    }

    #[cold]
    fn pass(&mut self, system: &S, transit: &Transit<N>) -> Result<(), StepError> {
        *self.mode = self.state.pass_through(system, transit, self.settings.regularization)?;
        self.of.work += 1;
        self.of.rest -= transit.duration;
        Ok(())
    }

    fn plan(&mut self, _: &S, near: Option<&StepLimits>, lasting: f64) -> f64 {
        self.limits = near.copied().unwrap_or(StepLimits::NONE);
        self.of.divided(self.state.substep.min(self.limits.longest).min(lasting))
    }

    fn attempt(
        &mut self,
        system: &S,
        &Trials { h, ref events, .. }: &Trials,
        from: Option<&Probe<S::GuardValues>>,
    ) -> Result<Outcome, StepError> {
        let Self { of, settings, state, limits, .. } = self;
        of.check_work(settings)?;
        let tolerance = settings.error_tolerance.max(limits.round_off);
        let iterations = state.counters.iterations;
        let attempt = attempt(system, settings, state, h, (limits, from.map(|from| &from.guard_values)));
        of.work += 1 + system.iteration_work() * (state.counters.iterations - iterations);
        of.last = [h, attempt.as_ref().map_or(f64::NAN, |attempt| attempt.error)];
        let attempt = match &attempt {
            Ok(attempt) if attempt.error <= tolerance => attempt,
            _ => {
                let error = of.last[1] / tolerance;
                of.shorter = h * CONTROLLER.reduction(error);
                return Ok(Outcome::Rejected(error));
            }
        };
        let event = from.map_or(EventCheck::Clear, |from| attempt.check_events(system, settings, (state, from), h, events.count));
        if let EventCheck::Before(when) = event {
            return Ok(Outcome::EventAt(when));
        }
        let wanted = next_step(h, CONTROLLER.growth(ln(attempt.error / tolerance), LEAST_LOG_ERROR), state.substep);
        if controls_rates(settings, system) {
            state.work.input += attempt.driven;
        }
        state.substep = wanted.min(events.longest_next(&event, h));
        attempt.accept(system, state, h);
        of.rest = if h >= of.rest { 0.0 } else { of.rest - h };
        if let EventCheck::AtEnd = event {
            let next = system.next_mode(&state.q, &state.v, settings.error_tolerance);
            self.enter(system, next);
        }
        Ok(Outcome::Accepted)
    }

    fn discard(&mut self) {
        self.state.counters.rejected += 1;
    }

    fn shorten(&mut self, _: &Trials, _: f64) -> Result<f64, StepError> {
        self.state.substep = self.of.shorter;
        Ok(self.of.divided(self.state.substep))
    }
}

/// A sub-step that has converged and is not yet accepted.
struct Attempt<const N: usize, const M: usize> {
    end: StepEnd<N, M>,
    /// Local error, rad.
    error: f64,
    /// Energy dissipated by springs that have separated, J.
    separated: f64,
    /// Work of drives beyond the trapezoidal rule, J, if the error of the rates is controlled.
    driven: f64,
}

/// Tries one step of `h` seconds (`docs/method.md`, section 5): predictor and Newton's method on δ and λ, (5) to (11); velocity projection
/// (15); acceleration and multipliers from equilibrium (16); local error (18). `from` are the guard values at the beginning, if events are
/// located.
#[inline(never)] // one shared copy for fixed steps and sub-steps saves 33 kB and costs 1.5 % of the instructions of a bare step
fn attempt<const N: usize, const M: usize, S: Implicit<N, M> + Mechanics<N, M>>(
    system: &S,
    settings: &Settings,
    state: &mut State<N, M>,
    h: f64,
    (limits, from): (&StepLimits, Option<&S::GuardValues>),
) -> Result<Attempt<N, M>, StepError> {
    if h < SHORTEST_FOR_NEWTON {
        return taylor_step(system, state, h, settings.regularization);
    }
    let settings = Settings { regularization: limits.regularization * settings.regularization, ..*settings };
    // Predictor (19), then Newton's method (9) and its fallbacks.
    let mut step = Step::predict(state, h, constraint_tolerance(&settings, system.length_scale(), h));
    let mut retried = false;
    let mut pose = system.pose(&step.q());
    loop {
        match newton::solve(system, &settings, &mut step, &mut pose, &mut state.counters) {
            Ok(()) => break,
            // Stiff friction may keep rates constant that the predicted accelerations would change, so constant rates are tried.
            Err(_) if controls_rates(&settings, system) && !retried => {
                (step, retried) = (step.with_constant_rates(state), true);
                pose = system.pose(&step.q());
            }
            Err(error) => {
                step = step.without_jerk(state);
                line_search::solve(&system.general(), settings, &mut step, &mut pose, &mut state.counters).ok_or(error)?;
                break;
            }
        }
    }

    // Projection of the velocity (15), then acceleration and multipliers from equilibrium (16). One factorisation serves both.
    let (q, v) = (step.q(), step.velocity());
    let mass = system.factor_mass(&pose, settings.regularization);
    let correction = velocity_correction(system, &pose, &mass, &v);
    let mut v = v + correction;
    if system.stuck() != Stuck::Nothing {
        v = project_sticking(system, Posed { q: &q, pose: &pose, v: &v }, &mass);
    }
    if let Some(energy) = &limits.energy {
        v = system.energy_scale(energy, &q, &v, h)? * v;
    }
    let mut end = StepEnd::in_balance(system, [q, v], &pose, &mass);
    // Near a vertex the rates are already scaled to the energy.
    if controls_rates(&settings, system)
        && limits.energy.is_none()
        && let Some(damped) = damping::damped(system, &settings, state, h, (&pose, &mass), &end)
    {
        end = damped;
    }
    let mut error = local_error(system, h, &(end.a - state.a), &correction);
    let separated = from.map_or(0.0, |from| separation_loss(system, from, [&end.q, &end.v]));
    let mut driven = 0.0;
    if controls_rates(&settings, system) {
        let stiff;
        (stiff, driven) = stiff_error(system, &settings, state, h, (&end, &pose, separated));
        error = error.max(stiff);
    }
    if error.is_finite() && end.a.is_finite() { Ok(Attempt { end, error, separated, driven }) } else { Err(StepError::NotFinite) }
}

/// Whether the error of the rates is controlled in addition to the error of the angles: with stiff forces, rates oscillate at almost
/// constant angles.
fn controls_rates<const N: usize, const M: usize>(settings: &Settings, system: &impl Implicit<N, M>) -> bool {
    settings.adaptive && system.features().stiff
}

/// Takes a step so short that q̈ and λ change only by round-off.
#[cold]
fn taylor_step<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    state: &State<N, M>,
    h: f64,
    regularization: f64,
) -> Result<Attempt<N, M>, StepError> {
    let end = StepEnd::out_of_line(system, [state.q + h * state.v, state.v + h * state.a], regularization).finite()?;
    Ok(Attempt { end, error: 0.0, separated: 0.0, driven: 0.0 })
}

impl<const N: usize, const M: usize> Attempt<N, M> {
    /// Checks the sub-step for events after `tries` trials to end it at a guard. The dense output is the quintic of both ends, with the
    /// integral of the rates as displacement. The displacement of the trapezoidal rule differs from it by the local error, which divided by
    /// h would look like slip.
    #[cold]
    fn check_events<S: Implicit<N, M> + Events<N>>(
        &self,
        system: &S,
        settings: &Settings,
        (from, at_start): (&State<N, M>, &Probe<S::GuardValues>),
        h: f64,
        tries: u32,
    ) -> EventCheck {
        let Self { end: to, .. } = self;
        let displacement = h / 2.0 * (from.v + to.v) + h * h / 12.0 * (from.a - to.a);
        let path = Path {
            origin: from.q,
            increment: Interpolant::between([[Vector::ZERO, from.v, from.a], [displacement, to.v, to.a]], h),
            length: h,
            longest_parabola: LONGEST_PARABOLA,
        };
        locator::check((system, settings.error_tolerance), at_start, ([&to.q, &to.v, &to.a], h), tries, &path, |_| false)
    }

    /// Accepts the attempt as the new state.
    fn accept(&self, system: &impl Implicit<N, M>, state: &mut State<N, M>, h: f64) {
        let Self { end, error, separated, .. } = self;
        if h >= SHORTEST_FOR_JERK {
            state.jerk = (end.a - state.a) / h;
        }
        if system.features().work {
            // Trapezoidal rule, which has the order of the method.
            state.work = state.work.plus(h / 2.0, state.power).plus(h / 2.0, end.power);
            state.work.dissipated += separated;
        }
        state.error_estimate = *error;
        state.take_over(end);
    }
}

/// Local error of a step of h over the angles, rad (18): of the trapezoidal rule, from the change of q̈, and of the velocity projection.
pub(super) fn local_error<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    h: f64,
    jump: &Vector<N>,
    correction: &Vector<N>,
) -> f64 {
    Vector::from([h * h / 12.0 * system.error_norm(jump), h / 2.0 * system.error_norm(correction)]).max_norm()
}
