//! The driver of all schemes: begin, try, accept, end at an event, pass a vertex. One accepted step after the other; what follows a step,
//! past a communication point or made again up to one, is in `dense.rs`.

use std::borrow::Borrow;

use super::explicit::{Dop853, Explicit, Tsit5};
use super::rosenbrock::{Linearization, Rodas4, Rodas5p, Rosenbrock};
use super::scheme::AcceptedStep;
use super::trial::{ErrorWeights, Origin, StageDerivative, StepResult, Trial, checked_work};
use super::{DenseStep, Horizon, Scheme, Schemes, Settings};
use crate::integrator::controller::{LEAST_LOG_ERROR, is_cut_short, ln, next_step};
use crate::integrator::locator::{self, EventCheck, EventTrials, SHORTEST};
use crate::integrator::{
    Approach, EnergyBalance, Events, Mechanics, Passage, PassageLimits, State, StepError, Stuck, System, Transit, Work,
};
use crate::vector::Vector;

/// Longest step, s, where nothing moves and the error sets no limit.
pub(super) const LONGEST: f64 = 10.0;
/// Part of the step within which an output must lie for the step to be interpolated; more than 1 by the round-off of summed macro
/// steps.
const OUTPUT_MARGIN: f64 = 1.000_001;
/// Plan of the next step.
struct Plan<'a, P> {
    /// Step length, s.
    h: f64,
    /// Step length that the error control wants, s.
    wanted: f64,
    /// Longest admissible step, s.
    longest: f64,
    /// Whether a vertex is near, where the energy may have to be conserved.
    near: bool,
    /// Time of the next output and limit of the step while inputs are constant.
    horizon: Horizon,
    /// Pose at the beginning of the step, if known.
    pose: Option<&'a P>,
}

/// One trial of a step.
struct Try {
    /// Step length, s.
    h: f64,
    /// Length, s, and error of the last rejected trial.
    rejected: Option<[f64; 2]>,
    /// Trials that are to end at a guard.
    event_trials: EventTrials,
}

impl Try {
    /// First trial of a step, of `h` seconds.
    fn of(h: f64) -> Self {
        Self { h, rejected: None, event_trials: EventTrials::NONE }
    }
}

/// Outcome of a trial.
enum Outcome {
    /// The step is accepted.
    Accepted,
    /// The error, in tolerances, is too large or NaN.
    Rejected(f64),
    /// The step has to end at an event, this many seconds after its beginning.
    EventAt(f64),
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Makes the next step from the end of the current one, whose pose may be known.
    pub(super) fn step<S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        horizon: Horizon,
        pose: Option<&S::Pose>,
    ) -> Result<(), StepError> {
        self.begin(system, settings, pose);
        let (longest, near) = match system.approach(&passage_limits(settings), &self.start.departure(horizon.limit.min(LONGEST))) {
            Approach::Clear => (horizon.limit, false),
            Approach::Limited(limits) => (horizon.limit.min(limits.longest), true),
            Approach::Passed(transit) => {
                self.pass_through(system, &transit, settings)?;
                return Ok(());
            }
        };
        self.probe_stiffness(system, settings, horizon.limit);
        let longest = if system.features().stick_slip { longest.min(self.longest_at_rest(system, settings)) } else { longest };
        // Steps are explicit, of order 8, where friction may stick, and next to a vertex, where tangents are dominated by
        // round-off.
        let scheme = if system.features().stick_slip || near && !system.can_project(&self.start.q) {
            Scheme::Dop853
        } else {
            settings.schemes.next(&self.memory.stiffness_switch, settings.error_tolerance, horizon.limit)
        };
        let lasting = self.reinitialize(system, settings);
        let wanted = match scheme {
            Scheme::Tsit5 if self.memory.stiffness_switch.tsit5_step.is_finite() => self.memory.stiffness_switch.tsit5_step,
            Scheme::Tsit5 => settings.first_step,
            _ if self.start.substep.is_finite() => self.start.substep,
            _ => settings.first_step,
        };
        let h = wanted.min(longest).min(LONGEST).min(lasting);
        if system.on(self.mode).borrow().stuck() == Stuck::Wholly {
            self.length = longest.min(LONGEST);
            self.end = self.start;
            self.end.counters.substeps += 1;
            return Ok(());
        }
        let plan = Plan { h, wanted, longest, near, horizon, pose };
        match scheme {
            Scheme::Tsit5 => self.attempt::<Explicit<Tsit5, N>, S>(system, settings, &plan),
            Scheme::Dop853 => self.attempt::<Explicit<Dop853, N>, S>(system, settings, &plan),
            Scheme::Rodas4 => self.attempt::<Rosenbrock<Rodas4, N>, S>(system, settings, &plan),
            Scheme::Rodas5p => self.attempt::<Rosenbrock<Rodas5p, N>, S>(system, settings, &plan),
        }
    }

    /// Updates the stiffness switch from the tangents: at the start, and again after many explicit steps.
    fn probe_stiffness<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings, limit: f64) {
        let at_start = self.start.counters.substeps == 0;
        // With friction that may stick the scheme is fixed.
        let asks = settings.schemes == Schemes::Automatic
            && !system.features().stick_slip
            && (at_start || self.memory.stiffness_switch.is_probing());
        if asks
            && system.features().stiff
            && let Some(linearization) =
                Linearization::about(system.on(self.mode).borrow(), settings, (&self.start, &system.pose(&self.start.q)))
        {
            let stiffness_switch = &mut self.memory.stiffness_switch;
            match at_start {
                true => stiffness_switch.begin(settings.first_step.min(limit), linearization.fastest_rate),
                false => stiffness_switch.probe(self.start.substep, linearization.fastest_rate),
            }
        }
    }

    /// Makes a step in scheme `T`, shortened until the error is admissible and events are met.
    fn attempt<T: Trial<N>, S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        plan: &Plan<'_, S::Pose>,
    ) -> Result<(), StepError> {
        let fresh;
        let pose = match plan.pose {
            Some(pose) => pose,
            None => {
                fresh = system.pose(&self.start.q);
                &fresh
            }
        };
        let origin = Origin { q: self.start.q, pose, regularization: settings.regularization };
        let mut in_mode = system.on(self.mode);
        let mut linearization = T::linearize(in_mode.borrow(), settings, (&self.start, &origin));
        let mut this = Try::of(plan.h);
        loop {
            let Some(basis) = &linearization else { return self.attempt::<Explicit<Dop853, N>, S>(system, settings, plan) };
            match self.try_once::<T, S>(in_mode.borrow(), settings, plan, (basis, &origin), &this) {
                Outcome::Accepted => return Ok(()),
                Outcome::EventAt(when) => {
                    self.reset_to_start();
                    self.end.counters.rejected += 1;
                    this.event_trials.repeat(this.h, when.min(plan.longest));
                    if let Some(end) = this.event_trials.end {
                        this.h = end;
                    } else {
                        self.apply_transition(system, settings);
                        in_mode = system.on(self.mode);
                        linearization = T::linearize(in_mode.borrow(), settings, (&self.start, &origin));
                    }
                }
                Outcome::Rejected(error) => {
                    self.end.counters.rejected += 1;
                    let h = this.h;
                    let before = this.rejected.replace([h, error]);
                    let before = before.filter(|[_, worst]| T::SCHEME.is_implicit() && worst.is_finite() && error > 1.0);
                    let before = before.map(|[length, worst]| [length / h, worst / error]);
                    if h < SHORTEST {
                        return Err(StepError::StepTooShort { substep: h, error: error * settings.error_tolerance });
                    }
                    this.h *= T::CONTROLLER.reduction_after(error, before);
                }
            }
        }
    }

    /// Makes one trial of a step. A separate function, since most steps need one trial and prepare nothing for another.
    fn try_once<T: Trial<N>, S: Mechanics<N, M, Mode = K>>(
        &mut self,
        on: &S,
        settings: &Settings,
        plan: &Plan<'_, S::Pose>,
        (basis, origin): (&T::Linearization, &Origin<'_, S::Pose, N>),
        Try { h, rejected, event_trials }: &Try,
    ) -> Outcome {
        let (&Plan { wanted, near, horizon, .. }, h) = (plan, *h);
        let energy_target = if near { self.energy_target(on, h) } else { None };
        let mut trial = T::new(on, basis, (&self.start, origin), h);
        let (error, step_result) = trial.conclude(on, settings, origin, &ErrorWeights::of(settings, on.features()), energy_target);
        let Some(step_result) = step_result else { return Outcome::Rejected(error) };
        self.accept(&step_result, h, T::SCHEME);
        let mut longest_next = f64::INFINITY;
        if on.features().events {
            let start = self.start;
            let mut dense = |end: &_| trial.dense(on, settings.regularization, [&start, end]);
            match self.check_events(on, settings, &mut dense, event_trials.count) {
                Ok(EventCheck::Before(when)) => return Outcome::EventAt(when),
                Ok(event) if self.truncated_from > 0.0 => {
                    longest_next = event_trials.longest_after(&event, (self.length, self.truncated_from));
                }
                Ok(event) => longest_next = event_trials.longest_next(&event, h),
                Err(error) => {
                    self.reset_to_start();
                    return Outcome::Rejected(error);
                }
            }
        }
        let interpolated = horizon.output < OUTPUT_MARGIN * h;
        // Event location has computed the coefficients already.
        let is_truncated = on.features().events && self.truncated_from > 0.0;
        if interpolated && !(is_truncated || on.features().events && self.dense != [StageDerivative::NONE; 4]) {
            self.dense = trial.dense(on, settings.regularization, [&self.start, &self.evaluated_end(on, settings)]);
        }
        self.end.error_estimate = error * settings.error_tolerance;
        self.adapt::<T>(h, error, wanted, rejected.is_some());
        let next = self.next_length::<T>();
        *next = next.min(longest_next);
        // Steps with friction that may stick, and truncated steps, do not update the switch: the former have no choice, the latter
        // no stage at their end.
        let chooses = settings.schemes == Schemes::Automatic;
        if chooses && !on.features().stick_slip && !is_truncated {
            let (product, wanted) = (h * trial.fastest_rate(&self.end), *self.next_length::<T>());
            self.memory.stiffness_switch.learn(&AcceptedStep {
                scheme: T::SCHEME,
                length: h,
                product,
                wanted,
                limit: horizon.limit,
                stiff_forces: on.features().stiff,
            });
        } else if !chooses && !is_truncated && self.memory.stiffness.is_due(self.end.counters.substeps) {
            self.memory.stiffness.check(h * trial.fastest_rate(&self.end));
        }
        Outcome::Accepted
    }

    /// Energy that a step of `h` seconds conserves next to a vertex.
    pub(super) fn energy_target<S: Passage<N>>(&self, system: &S, h: f64) -> Option<(EnergyBalance, f64)> {
        system.energy_to_keep(&self.start.q, &self.start.v).map(|energy| (energy, h))
    }

    /// Whether forces at the end of the step are not evaluated yet: after Tsit5 the inputs are expected to change there.
    fn end_is_unevaluated(&self) -> bool {
        self.scheme == Scheme::Tsit5 && self.length > 0.0 && !self.is_linear
    }

    /// State at the end of the step with q̈, λ and power of `system`, which is in the mode of the step.
    pub(super) fn evaluated_end<S: System<N, M> + Passage<N>>(&self, system: &S, settings: &Settings) -> State<N, M> {
        let mut end = self.end;
        if self.end_is_unevaluated() {
            end.balance(system, &system.pose(&end.q), settings.regularization);
        }
        end
    }

    /// Begins a step at the end of the current one, whose pose may be known.
    fn begin<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings, pose: Option<&S::Pose>) {
        if self.end_is_unevaluated() {
            let fresh = pose.is_none().then(|| system.pose(&self.end.q));
            if let Some(pose) = pose.or(fresh.as_ref()) {
                self.end.balance(system.on(self.mode).borrow(), pose, settings.regularization);
            }
        }
        self.start = self.end;
        self.before = self.memory;
        self.elapsed = 0.0;
        self.dense = [StageDerivative::NONE; 4];
        self.is_linear = false;
    }

    /// Sets the end of the step.
    pub(super) fn accept(&mut self, step_result: &StepResult<N, M>, h: f64, scheme: Scheme) {
        let StepResult { iterations, end_state, work } = step_result;
        (self.length, self.scheme) = (h, scheme);
        self.end.take_over(end_state);
        self.end.counters.iterations += u64::from(*iterations);
        self.end.work += *work;
    }

    /// Sets the length of the next step from the error of one of `h` seconds.
    fn adapt<T: Trial<N>>(&mut self, h: f64, error: f64, wanted: f64, rejected: bool) {
        // A rejected step is as long as its error allows, not cut short.
        let wanted = if rejected { h } else { wanted };
        let cut_short = is_cut_short(h, wanted);
        let next = if cut_short && T::CONTROLLER.longest_after(h) <= wanted {
            // Many held inputs end a step so early that its error carries no information.
            wanted
        } else {
            let log_error = ln(error);
            let growth = T::CONTROLLER.growth(log_error, self.memory.log_error);
            if !cut_short {
                self.memory.log_error = log_error.max(LEAST_LOG_ERROR);
            }
            next_step(h, if rejected { growth.min(1.0) } else { growth }, wanted)
        };
        *self.next_length::<T>() = next;
    }

    /// Length of the next step of scheme `T`, s.
    fn next_length<T: Trial<N>>(&mut self) -> &mut f64 {
        if T::SCHEME == Scheme::Tsit5 { &mut self.memory.stiffness_switch.tsit5_step } else { &mut self.end.substep }
    }

    /// Sets the mode at the beginning of a step, after all transitions due there, and returns the longest useful step in that mode,
    /// s.
    fn reinitialize<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings) -> f64 {
        self.truncated_from = 0.0;
        let (mode, lasting) =
            locator::mode_at(system, self.next_mode_at_end, [&self.start.q, &self.start.v], settings.error_tolerance);
        self.set_mode(system, settings, mode);
        lasting
    }

    /// Applies the transition at a guard that the step crosses at its very beginning.
    fn apply_transition<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings) {
        let mode = system.on(self.mode).borrow().next_mode(&self.start.q, &self.start.v, settings.error_tolerance);
        self.set_mode(system, settings, mode);
    }

    /// Sets the mode of the step; if it changes, forces and accelerations are evaluated again.
    fn set_mode<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings, mode: K) {
        if mode != self.mode {
            let [before, next_mode] = [system.on(self.mode), system.on(mode)];
            self.start.reinitialize(next_mode.borrow(), &system.pose(&self.start.q), settings.regularization);
            if before.borrow().has_active_contact() != next_mode.borrow().has_active_contact() {
                std::mem::swap(&mut self.start.substep, &mut self.memory.substep_in_other_mode);
                self.before = self.memory;
            }
            self.end = self.start;
        }
        (self.mode, self.next_mode_at_end) = (mode, mode);
    }

    /// Checks a step with an admissible local error for events, after `tries` trials to end it at a guard; or refuses it with the error
    /// of its work, in tolerances. `system` is in the mode of the step, and `dense` evaluates the interpolant's coefficients.
    fn check_events<S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        dense: &mut dyn FnMut(&State<N, M>) -> [StageDerivative<N>; 4],
        tries: u32,
    ) -> Result<EventCheck, f64> {
        let from = system.guard_values(&self.start.q, &self.start.v);
        let (shown, length) = (system.separation_energy(&from), self.length);
        let end = self.evaluated_end(system, settings);
        self.dense = dense(&end);
        let (of, path) = ((system, settings.error_tolerance), self.path());
        // Events are located on a dense output that agrees with the stages of the step; one that does not gives no error estimate.
        if !self.interpolant_is_consistent(settings) {
            return Err(f64::NAN);
        }
        let event =
            locator::check(of, from, ([&end.q, &end.v, &end.a], length), tries, path, |when| self.truncate(system, settings, when));
        if let EventCheck::Before(_) = event {
            return Ok(event);
        }
        checked_work(settings, Work::of_pair(self.end.work.pair() - self.start.work.pair()))?;
        self.end.work.dissipated = self.end.work.dissipated.max(self.start.work.dissipated);
        if shown > 0.0 {
            self.end.work.dissipated += self.separation_energy(system, [&self.end.q, &self.end.v]);
        }
        if let EventCheck::AtEnd = event {
            self.next_mode_at_end = system.next_mode(&self.end.q, &self.end.v, settings.error_tolerance);
        }
        Ok(event)
    }

    /// Energy dissipated by separated springs between the beginning of the step and a state q, q̇, J.
    pub(super) fn separation_energy<S: Events<N>>(&self, system: &S, [q, v]: [&Vector<N>; 2]) -> f64 {
        let shown = system.separation_energy(&system.guard_values(&self.start.q, &self.start.v));
        if shown > 0.0 { (shown - system.separation_energy(&system.guard_values(q, v))).max(0.0) } else { 0.0 }
    }

    /// Makes a straight step through a vertex.
    #[cold]
    fn pass_through<S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        transit: &Transit<N>,
        settings: &Settings,
    ) -> Result<(), StepError> {
        self.next_mode_at_end = self.end.pass_through(system, transit, settings.regularization)?;
        (self.length, self.is_linear) = (transit.duration, true);
        Ok(())
    }
}

/// Thresholds for passages: the local error is far below the impact parameter at any tolerance.
fn passage_limits(settings: &Settings) -> PassageLimits {
    PassageLimits { radius: 1e-4, impact_parameter: 1e-7, longest_with_dissipation: settings.first_step }
}
