//! One accepted step: approach to vertices, choice of scheme, trials, error control.

use std::borrow::Borrow;

use super::dop853::Dop853;
use super::events::EventCheck;
use super::plan::{Outcome, Plan, Try};
use super::rosenbrock::{Linearization, Rodas4, Rodas5p, Rosenbrock};
use super::scheme::AcceptedStep;
use super::trial::{ErrorWeights, Origin, RATE, StageDerivative, StepResult, Trial};
use super::tsit5::Tsit5;
use super::{DenseStep, Horizon, Scheme, Schemes, Settings};
use crate::integrator::controller::{LEAST_LOG_ERROR, is_cut_short, ln, next_step};
use crate::integrator::{Approach, EnergyBalance, Events, Passage, PassageLimits, State, StepError, System};

/// Shortest step that is rejected for another trial, s.
pub(super) const SHORTEST: f64 = 1e-15;
/// Longest step, s, where nothing moves and the error sets no limit.
pub(super) const LONGEST: f64 = 10.0;
/// Part of the step within which an output must lie for the step to be interpolated; more than 1 by the round-off of summed macro
/// steps.
const OUTPUT_MARGIN: f64 = 1.000_001;
/// Admissible inconsistency of an interpolant's rates with its coordinates, in tolerances; good steps differ by at most 60.
const LARGEST_INCONSISTENCY: f64 = 1e3;
/// Admissible error of a slow rate, relative to the regularisation velocity: larger errors would step over sticking.
const SLOW_RATE_PART: f64 = 0.3;
/// Largest next step, relative to a step whose interpolant has shown a false event, or an event early in the step. Oscillation
/// about a guard is so resolved within a few steps.
const AFTER_FALSE_EVENT: f64 = 0.3;
/// Part of the original step below which a truncated step counts as ended early.
const EARLY: f64 = 0.01;
/// Round-off of a difference of coordinates, rad.
const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Makes the next step from the end of the current one, whose pose may be known.
    #[inline(never)]
    pub(super) fn step<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        horizon: Horizon,
        pose: Option<&S::Pose>,
    ) -> Result<(), StepError> {
        self.begin(system, settings, pose);
        let (longest, near) = match system.approach(&settings.passage(), &self.start.departure(horizon.limit.min(LONGEST))) {
            Approach::Clear => (horizon.limit, false),
            Approach::Limited(limits) => (horizon.limit.min(limits.longest), true),
            Approach::Passed(transit) => {
                self.pass_through(system, &transit, settings)?;
                return Ok(());
            }
        };
        self.probe_stiffness(system, settings, horizon.limit);
        let longest = if system.has_stick_slip() { longest.min(self.longest_at_rest(system, settings)) } else { longest };
        // Steps are explicit, of order 8, where friction may stick, and next to a vertex, where tangents are dominated by
        // round-off.
        let scheme = if system.has_stick_slip() || near && !system.can_project(&self.start.q) {
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
        if system.has_stick_slip() && system.on(self.mode).borrow().is_at_rest() {
            self.length = longest.min(LONGEST);
            self.end = self.start;
            self.end.counters.substeps += 1;
            return Ok(());
        }
        let plan = Plan { h, wanted, longest, near, locates_events: true, horizon, pose };
        match scheme {
            Scheme::Tsit5 => self.attempt::<Tsit5<N>, S>(system, settings, &plan),
            Scheme::Dop853 => self.attempt::<Dop853<N>, S>(system, settings, &plan),
            Scheme::Rodas4 => self.attempt::<Rosenbrock<Rodas4, N>, S>(system, settings, &plan),
            Scheme::Rodas5p => self.attempt::<Rosenbrock<Rodas5p, N>, S>(system, settings, &plan),
        }
    }

    /// Updates the stiffness switch from the tangents: at the start, and again after many explicit steps.
    #[inline]
    fn probe_stiffness<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings, limit: f64) {
        let at_start = self.start.counters.substeps == 0;
        // With friction that may stick the scheme is fixed.
        let asks = settings.schemes == Schemes::Automatic
            && !system.has_stick_slip()
            && (at_start || self.memory.stiffness_switch.is_probing());
        if asks
            && system.has_stiff_forces()
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
    #[inline(never)]
    fn attempt<T: Trial<N>, S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        plan: &Plan<'_, S::Pose>,
    ) -> Result<(), StepError> {
        // Two calls instead of one reference to a pose, because stages need little of a pose and keep it in registers.
        let origin = match plan.pose {
            Some(pose) => Origin::new(system, &self.start.q, pose, settings.regularization),
            None => Origin::new(system, &self.start.q, &system.pose_in_place(&self.start.q), settings.regularization),
        };
        let mut in_mode = system.on(self.mode);
        let mut linearization = T::linearize(in_mode.borrow(), settings, (&self.start, &origin));
        let mut this = Try::of(plan.h);
        loop {
            let Some(basis) = &linearization else { return self.attempt::<Dop853<N>, S>(system, settings, plan) };
            match self.try_once::<T, S>(in_mode.borrow(), settings, plan, (basis, &origin), &this) {
                Outcome::Accepted => return Ok(()),
                Outcome::EventAt(when) => {
                    self.reset_to_start();
                    self.end.counters.rejected += 1;
                    this.event_trials += 1;
                    if when < SHORTEST {
                        this.event_shown_by = f64::INFINITY;
                        self.apply_transition(system, settings);
                        in_mode = system.on(self.mode);
                        linearization = T::linearize(in_mode.borrow(), settings, (&self.start, &origin));
                    } else {
                        this.event_shown_by = this.h;
                        this.h = when.min(plan.longest);
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
    #[inline(never)]
    pub(super) fn try_once<T: Trial<N>, S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        on: &S,
        settings: &Settings,
        plan: &Plan<'_, S::Pose>,
        (basis, origin): (&T::Linearization, &Origin<S::TrigBase, N>),
        &Try { h, rejected, event_trials, event_shown_by }: &Try,
    ) -> Outcome {
        let &Plan { wanted, near, locates_events, horizon, .. } = plan;
        let energy_target = if near { self.energy_target(on, h) } else { None };
        let mut trial = T::new(on, basis, (&self.start, origin), h);
        let (error, step_result) = trial.conclude(on, settings, origin, &settings.error_weights(on), energy_target);
        let Some(step_result) = step_result else { return Outcome::Rejected(error) };
        self.accept(&step_result, h, T::SCHEME);
        let mut tried = f64::INFINITY;
        if on.has_events() && locates_events {
            let start = self.start;
            let mut dense = |end: &_| trial.dense(on, settings.regularization, [&start, end]);
            match self.event_check(on, settings, &mut dense, event_trials) {
                // The event that the interpolant of a longer trial has shown does not exist.
                EventCheck::Clear => tried = event_shown_by,
                EventCheck::AtEnd => {
                    self.next_mode_at_end = on.next_mode(&self.end.q, &self.end.v, settings.error_tolerance);
                    tried = if self.truncated_from > 0.0 { self.truncated_from } else { event_shown_by };
                    tried = if self.length < EARLY * tried { tried } else { f64::INFINITY };
                }
                EventCheck::Before(when) => return Outcome::EventAt(when),
                EventCheck::WorkError(error) => {
                    self.reset_to_start();
                    self.next_mode_at_end = self.mode;
                    return Outcome::Rejected(error);
                }
            }
        }
        let interpolated = horizon.output < OUTPUT_MARGIN * h;
        // Event location has computed the coefficients already.
        let is_truncated = on.has_events() && self.truncated_from > 0.0;
        if interpolated && !(is_truncated || on.has_events() && self.dense != [StageDerivative::NONE; 4]) {
            self.dense = trial.dense(on, settings.regularization, [&self.start, &self.evaluated_end(on, settings)]);
        }
        self.end.error_estimate = error * settings.error_tolerance;
        self.adapt::<T>(h, error, wanted, rejected.is_some());
        let next = self.next_length::<T>();
        *next = next.min((AFTER_FALSE_EVENT * tried).max(SHORTEST));
        // Steps with friction that may stick, and truncated steps, do not update the switch: the former have no choice, the latter
        // no stage at their end.
        let chooses = settings.schemes == Schemes::Automatic;
        if chooses && !on.has_stick_slip() && !is_truncated {
            let (product, wanted) = (h * trial.fastest_rate(&self.end), *self.next_length::<T>());
            self.memory.stiffness_switch.learn(&AcceptedStep {
                scheme: T::SCHEME,
                length: h,
                product,
                wanted,
                limit: horizon.limit,
                stiff_forces: on.has_stiff_forces(),
            });
        } else if !chooses && !is_truncated && self.memory.stiffness.is_due(self.end.counters.substeps) {
            self.memory.stiffness.check(h * trial.fastest_rate(&self.end));
        }
        Outcome::Accepted
    }

    /// Energy that a step of `h` seconds conserves next to a vertex.
    #[inline]
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
    fn begin<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        pose: Option<&S::Pose>,
    ) {
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
    #[inline]
    pub(super) fn accept(&mut self, step_result: &StepResult<N, M>, h: f64, scheme: Scheme) {
        let StepResult { iterations, end_state, work } = step_result;
        (self.length, self.scheme) = (h, scheme);
        self.end.take_over(end_state);
        self.end.counters.iterations += u64::from(*iterations);
        self.end.work += *work;
    }

    /// Whether the interpolant is consistent: its rates are the derivatives of its coordinates within [`LARGEST_INCONSISTENCY`].
    /// Stages may miss a force that the further stages of the dense output meet. Schemes with one polynomial for both are always
    /// consistent.
    #[cold]
    pub(super) fn interpolant_is_consistent(&self, settings: &Settings) -> bool {
        if self.scheme != Scheme::Dop853 {
            return true;
        }
        let (positions, velocities) = (self.positions(), self.velocities());
        [0.125, 0.5, 0.875].into_iter().all(|part| {
            let v = velocities.at(part);
            let defect = positions.rate_at(part) - self.length * v;
            (0..N).all(|i| {
                let admissible = LARGEST_INCONSISTENCY * settings.error_tolerance * (RATE + v[i].abs()) * self.length;
                defect[i].abs() <= admissible + ROUND_OFF * (1.0 + self.end.q[i].abs())
            })
        })
    }

    /// Sets the length of the next step from the error of one of `h` seconds.
    #[inline]
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
}

impl Settings {
    /// Weights of the local error. With events the work is weighted too: it depends on discontinuous forces, whose error the motion
    /// does not show.
    #[inline]
    pub(super) fn error_weights<const N: usize>(&self, system: &impl Events<N>) -> ErrorWeights {
        let rate = RATE.min(SLOW_RATE_PART * system.regularization_velocity() / self.error_tolerance);
        ErrorWeights {
            coordinate: self.error_tolerance,
            rate,
            work: system.has_events().then_some(self.error_tolerance * self.energy_scale),
            has_sharp_nonlinearity: system.has_sharp_nonlinearity(),
        }
    }

    /// Thresholds for passages: the local error is far below the impact parameter at any tolerance.
    pub(super) fn passage(&self) -> PassageLimits {
        PassageLimits { radius: 1e-4, impact_parameter: 1e-7, longest_with_dissipation: self.first_step }
    }
}
