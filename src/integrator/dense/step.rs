//! One step with dense output, as the driver calls it: begin, trial, events, length of the next step. `dense.rs` handles steps past a
//! communication point and steps that are redone up to one.

use super::explicit::{Dop853, Explicit, Tsit5};
use super::rosenbrock::{Linearization, Rodas4, Rodas5p, Rosenbrock};
use super::scheme::AcceptedStep;
use super::trial::{ErrorWeights, Origin, StageDerivative, StepResult, Trial, checked_work};
use super::{DenseStep, Horizon, Scheme, Schemes, Settings};
use crate::integrator::checks::Imbalance;
use crate::integrator::controller::{LEAST_LOG_ERROR, is_cut_short, ln, next_step};
use crate::integrator::driver::{self, Limits, Method, Outcome, Trials};
use crate::integrator::events::separation_loss;
use crate::integrator::locator::{self, EventCheck, Probe, SHORTEST};
use crate::integrator::{EnergyBalance, Mechanics, Passage, PassageLimits, State, StepError, StepLimits, System, Transit, Work};

/// Longest step, s, if nothing moves and the error sets no limit.
pub(super) const LONGEST: f64 = 10.0;
/// A step is interpolated if an output lies within this fraction of it. It is more than 1 by the round-off of summed macro steps.
const OUTPUT_MARGIN: f64 = 1.000_001;

/// A step under trial, and the data that its trials share.
struct Attempt<'a, S: Mechanics<N, M>, const N: usize, const M: usize> {
    step: &'a mut DenseStep<N, M, S::Mode>,
    settings: &'a Settings,
    /// Pose at the beginning of the step.
    pose: &'a S::Pose,
    /// Time of the next output and limit of the step while inputs are constant.
    horizon: Horizon,
    /// Step length that the error control suggests, s.
    wanted: f64,
    /// Energy that the step must conserve, near a vertex.
    energy: Option<EnergyBalance>,
    scheme: Scheme,
    /// Tangents at the beginning of the step, for an implicit scheme.
    linearization: Option<Linearization<N>>,
}

impl<S: Mechanics<N, M>, const N: usize, const M: usize> Method<N, M, S> for Attempt<'_, S, N, M> {
    fn start(&self) -> &State<N, M> {
        &self.step.start
    }

    fn end(&self) -> &State<N, M> {
        &self.step.end
    }

    fn initial_mode(&self) -> S::Mode {
        self.step.next_mode_at_end
    }

    fn longest(&self) -> f64 {
        self.horizon.limit.min(LONGEST)
    }

    fn enter(&mut self, system: &S, mode: S::Mode) {
        self.step.set_mode(system, self.settings, (mode, self.pose));
    }

    fn rest(&mut self) {
        self.step.length = self.longest();
        self.step.end = self.step.start;
        self.step.end.counters.substeps += 1;
    }

    fn pass(&mut self, system: &S, transit: &Transit<N>) -> Result<(), StepError> {
        self.step.next_mode_at_end = self.step.end.pass_through(system, transit, self.settings.regularization)?;
        (self.step.length, self.step.is_linear) = (transit.duration, true);
        Ok(())
    }

    fn plan(&mut self, system: &S, near: Option<&StepLimits>, lasting: f64) -> f64 {
        let &mut Self { settings, horizon, .. } = self;
        let State { q, v, .. } = &self.step.start;
        self.energy = near.and_then(|_| system.energy_to_keep(q, v));
        self.step.probe_stiffness(system, settings, (horizon.limit, self.pose));
        let sticks = system.features().may_stick;
        let longest = self.longest().min(near.map_or(f64::INFINITY, |limits| limits.longest)).min(lasting);
        let longest = if sticks { longest.min(self.step.longest_at_rest(system, settings, self.pose)) } else { longest };
        let stiffness_switch = &self.step.memory.stiffness_switch;
        let scheme = if sticks || self.energy.is_some() {
            Scheme::GENERAL
        } else {
            settings.schemes.next(stiffness_switch, settings.error_tolerance, horizon.limit)
        };
        let wanted = if scheme == Scheme::BRIEF { stiffness_switch.brief_step } else { self.step.start.substep };
        self.wanted = if wanted.is_finite() { wanted } else { settings.first_step };
        let is_implicit = scheme.properties().is_implicit;
        self.linearization = if is_implicit { Linearization::about(system, settings, (&self.step.start, self.pose)) } else { None };
        self.scheme = if is_implicit && self.linearization.is_none() { Scheme::GENERAL } else { scheme };
        self.wanted.min(longest)
    }

    fn attempt(&mut self, system: &S, trials: &Trials, from: Option<&Probe<S::GuardValues>>) -> Result<Outcome, StepError> {
        let (start, h) = (&self.step.start, trials.h);
        Ok(match (self.scheme, &self.linearization) {
            (Scheme::Rodas4, Some(tangents)) => {
                let trial = Rosenbrock::<Rodas4, N>::new(system, tangents, (start, &self.origin()), h);
                self.judge(trial, system, trials, from)
            }
            (Scheme::Rodas5p, Some(tangents)) => {
                let trial = Rosenbrock::<Rodas5p, N>::new(system, tangents, (start, &self.origin()), h);
                self.judge(trial, system, trials, from)
            }
            (Scheme::Tsit5, _) => self.judge(Explicit::<Tsit5, N>::new(start, h), system, trials, from),
            // An implicit step cannot begin without tangents; `plan` has replaced its scheme.
            (Scheme::Dop853, _) | (Scheme::Rodas4 | Scheme::Rodas5p, None) => {
                self.judge(Explicit::<Dop853, N>::new(start, h), system, trials, from)
            }
        })
    }

    fn discard(&mut self) {
        self.step.discard();
    }

    fn shorten(&mut self, &Trials { h, rejected, .. }: &Trials, error: f64) -> Result<f64, StepError> {
        if h < SHORTEST {
            return Err(StepError::StepTooShort { substep: h, error: error * self.settings.error_tolerance });
        }
        let properties = self.scheme.properties();
        let before = rejected.filter(|[_, worst]| properties.is_implicit && worst.is_finite() && error > 1.0);
        Ok(h * properties.controller().reduction_after(error, before.map(|[length, worst]| [length / h, worst / error])))
    }
}

impl<'a, S: Mechanics<N, M>, const N: usize, const M: usize> Attempt<'a, S, N, M> {
    /// Beginning of the step, relative to which its stages are evaluated.
    fn origin(&self) -> Origin<'a, S::Pose, N> {
        Origin { q: self.step.start.q, pose: self.pose, regularization: self.settings.regularization }
    }

    /// Completes a trial and accepts it if its error is admissible and no event occurs earlier. `from` is the guard probe at the beginning,
    /// if there are guards.
    fn judge<T: Trial<N>>(
        &mut self,
        mut trial: T,
        system: &S,
        &Trials { h, rejected, events: ref event_trials, .. }: &Trials,
        from: Option<&Probe<S::GuardValues>>,
    ) -> Outcome {
        let origin = &self.origin();
        let &mut Self { ref mut step, settings, horizon, wanted, energy, .. } = self;
        let features = system.features();
        let weights = ErrorWeights::of(settings, features);
        let (error, end) = trial.complete(system, origin, &weights);
        if error.is_nan() || error > 1.0 {
            return Outcome::Rejected(error);
        }
        let work = if features.work { trial.work(system) } else { Work::default() };
        // With events the work is checked after they have been located.
        let checked = if features.events { Ok(work) } else { checked_work(settings, work) };
        let work = match checked {
            Ok(work) => work,
            Err(error) => return Outcome::Rejected(error),
        };
        let projected = trial.project(system, settings, (origin, end), energy.map(|energy| (energy, h)), work);
        let Some(step_result) = projected else { return Outcome::Rejected(error) };
        step.accept(&step_result, h, T::SCHEME);
        let mut longest_next = f64::INFINITY;
        if from.is_some() || horizon.output < OUTPUT_MARGIN * h {
            let end = step.evaluated_end(system, settings);
            step.dense = trial.dense(system, settings.regularization, [&step.start, &end]);
            match from.map(|from| step.check_events(system, settings, (from, event_trials.count), &end)) {
                None => {}
                Some(Ok(EventCheck::Before(when))) => return Outcome::EventAt(when),
                Some(Ok(event)) if step.truncated_from > 0.0 => {
                    longest_next = event_trials.longest_after(&event, (step.length, step.truncated_from));
                }
                Some(Ok(event)) => longest_next = event_trials.longest_next(&event, h),
                Some(Err(error)) => return Outcome::Rejected(error),
            }
        }
        let is_truncated = step.truncated_from > 0.0;
        step.end.error_estimate = error * settings.error_tolerance;
        step.adapt::<T>(h, error, wanted, rejected.is_some());
        let next = step.next_length::<T>();
        *next = next.min(longest_next);
        // Steps with friction that may stick have no choice of scheme, and truncated steps have no stage at their end. Neither updates the
        // switch.
        let chooses = settings.schemes == Schemes::Automatic;
        if chooses && !features.may_stick && !is_truncated {
            let (product, wanted) = (h * trial.fastest_rate(&step.end), *step.next_length::<T>());
            step.memory.stiffness_switch.learn(&AcceptedStep {
                scheme: T::SCHEME,
                length: h,
                product,
                wanted,
                limit: horizon.limit,
                stiff_forces: features.stiff,
            });
        } else if const { !T::SCHEME.properties().is_implicit }
            && !chooses
            && !is_truncated
            && step.memory.stiffness.is_due(step.end.counters.substeps)
        {
            step.memory.stiffness.check(h * trial.fastest_rate(&step.end));
        }
        Outcome::Accepted
    }
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Makes the next step from the end of the current one; its pose may be known.
    pub(super) fn step<S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        horizon: Horizon,
        pose: Option<&S::Pose>,
    ) -> Result<(), StepError> {
        let fresh;
        let pose = match pose {
            Some(pose) => pose,
            None => {
                fresh = system.pose(&self.end.q);
                &fresh
            }
        };
        self.begin(system, settings, pose);
        let (wanted, scheme) = (settings.first_step, Scheme::GENERAL);
        let mut attempt = Attempt { step: self, settings, pose, horizon, wanted, energy: None, scheme, linearization: None };
        let tolerance = settings.error_tolerance;
        let limits = Limits {
            passage: passage_limits(settings),
            tolerance,
            imbalance: Imbalance::of_tolerance(tolerance, settings.energy_scale),
        };
        driver::step(&mut attempt, system, &limits).map(drop)
    }

    /// Updates the stiffness switch from the tangents: at the start, and again after many explicit steps.
    fn probe_stiffness<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings, (limit, pose): (f64, &S::Pose)) {
        let at_start = self.start.counters.substeps == 0;
        // If friction may stick, the scheme is fixed.
        let asks = settings.schemes == Schemes::Automatic
            && !system.features().may_stick
            && (at_start || self.memory.stiffness_switch.is_probing());
        if asks
            && system.features().stiff
            && let Some(linearization) = Linearization::about(system, settings, (&self.start, pose))
        {
            let stiffness_switch = &mut self.memory.stiffness_switch;
            match at_start {
                true => stiffness_switch.begin(settings.first_step.min(limit), linearization.fastest_rate),
                false => stiffness_switch.probe(self.start.substep, linearization.fastest_rate),
            }
        }
    }

    /// Whether the forces at the end of the step have not been evaluated yet.
    fn end_is_unevaluated(&self) -> bool {
        !self.scheme.properties().evaluates_end && self.length > 0.0 && !self.is_linear
    }

    /// State at the end of the step with q̈, λ and power; `system` is in the mode of the step.
    pub(super) fn evaluated_end<S: System<N, M> + Passage<N>>(&self, system: &S, settings: &Settings) -> State<N, M> {
        let mut end = self.end;
        if self.end_is_unevaluated() {
            end.balance(system, &system.pose(&end.q), settings.regularization);
        }
        end
    }

    /// Begins a step at the end of the current one; `pose` is the pose there.
    fn begin<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings, pose: &S::Pose) {
        if self.end_is_unevaluated() {
            self.end.balance(&*system.on(self.mode), pose, settings.regularization);
        }
        self.start = self.end;
        self.before = self.memory;
        (self.elapsed, self.truncated_from) = (0.0, 0.0);
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

    /// Sets the length of the next step from the error of a step of `h` seconds.
    fn adapt<T: Trial<N>>(&mut self, h: f64, error: f64, wanted: f64, rejected: bool) {
        // A rejected step is as long as its error allows; it is not cut short.
        let wanted = if rejected { h } else { wanted };
        let cut_short = is_cut_short(h, wanted);
        let controller = const { T::SCHEME.properties().controller() };
        let next = if cut_short && controller.longest_after(h) <= wanted {
            // Frequent input changes end a step so early that its error carries no information.
            wanted
        } else {
            let log_error = ln(error);
            let growth = controller.growth(log_error, self.memory.log_error);
            if !cut_short {
                self.memory.log_error = log_error.max(LEAST_LOG_ERROR);
            }
            next_step(h, if rejected { growth.min(1.0) } else { growth }, wanted)
        };
        *self.next_length::<T>() = next;
    }

    /// Length of the next step of scheme `T`, s.
    fn next_length<T: Trial<N>>(&mut self) -> &mut f64 {
        if T::SCHEME == Scheme::BRIEF { &mut self.memory.stiffness_switch.brief_step } else { &mut self.end.substep }
    }

    /// Sets the mode of the step. If it changes, forces and accelerations are evaluated again.
    fn set_mode<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings, (mode, pose): (K, &S::Pose)) {
        if mode != self.mode {
            let [before, next_mode] = [system.on(self.mode), system.on(mode)];
            self.start.reinitialize(&*next_mode, pose, settings.regularization);
            if before.has_active_contact() != next_mode.has_active_contact() {
                std::mem::swap(&mut self.start.substep, &mut self.memory.substep_in_other_mode);
                self.before = self.memory;
            }
            self.end = self.start;
        }
        (self.mode, self.next_mode_at_end) = (mode, mode);
    }

    /// Checks a step with an admissible local error for events, after `tries` trials to end it at a guard. Refuses the step, with the error
    /// of its work in tolerances, if that error is inadmissible. `system` is in the mode of the step, `from` is its beginning, and `end`
    /// its evaluated end.
    fn check_events<S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        (from, tries): (&Probe<S::GuardValues>, u32),
        end: &State<N, M>,
    ) -> Result<EventCheck, f64> {
        let length = self.length;
        let (of, path) = ((system, settings.error_tolerance), self.path());
        // Events are located on a dense output that agrees with the stages of the step. If the output does not agree, there is no error
        // estimate.
        if !self.interpolant_is_consistent(settings) {
            return Err(f64::NAN);
        }
        let event = locator::check(of, from, ([&end.q, &end.v, &end.a], length), tries, &path, |when| {
            self.truncate(system, settings, when)
        });
        if let EventCheck::Before(_) = event {
            return Ok(event);
        }
        checked_work(settings, Work::of_pair(self.end.work.pair() - self.start.work.pair()))?;
        self.end.work.dissipated = self.end.work.dissipated.max(self.start.work.dissipated);
        self.end.work.dissipated += separation_loss(system, &from.guard_values, [&self.end.q, &self.end.v]);
        if let EventCheck::AtEnd = event {
            self.next_mode_at_end = system.next_mode(&self.end.q, &self.end.v, settings.error_tolerance);
        }
        Ok(event)
    }
}

/// Thresholds for passages: the local error is far below the impact parameter at any tolerance.
fn passage_limits(settings: &Settings) -> PassageLimits {
    PassageLimits { radius: 1e-4, impact_parameter: 1e-7, longest_with_dissipation: settings.first_step }
}
