//! A run by an error-controlled method with dense output, in the link angles: the step under way runs past the communication point.

use std::f64::consts::TAU;

use borsh::{BorshDeserialize, BorshSerialize};

use super::angles::{ANGLES, AngleSystem, Angles, CLOSURES, LINK_INDICES, angles_of};
use super::five_bar::FiveBar;
use super::macro_steps::{MacroSteps, StepFailure};
use super::state::{Core, State, whole_turns};
use super::{Inputs, Model};
use crate::hybrid::{Mode, StickSlips};
use crate::integrator::dense::{DenseStep, Horizon, Settings};
use crate::integrator::{Bounds, Inconsistency, StepError, Stuck, System, Work};
use crate::mechanism::Coordinates;

/// Step under way, and the number of macro steps since the inputs changed.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct DenseRun {
    pub(super) settings: Settings,
    pub(super) step: DenseStep<ANGLES, CLOSURES, Mode>,
    /// Numbers of macro steps with the previous inputs (0 at first) and with the present inputs.
    held: [u64; 2],
}

impl DenseRun {
    /// Starts a run from a state.
    pub(super) fn start(model: &Model, settings: Settings, state: &State) -> Self {
        let system = AngleSystem::of(model, &state.inputs, &state.turns);
        let step = DenseStep::start(&system, angles_of(&state.core.q), angles_of(&state.core.v), &settings);
        Self { settings, step, held: [0; 2] }
    }

    /// Truncates the step under way at the present time, before model or inputs change. A failure leaves the run undefined.
    pub(super) fn stop(&mut self, model: &Model, inputs: &Inputs, turns: &[i64; 4]) -> Result<(), StepError> {
        self.step.truncate_and_redo(&AngleSystem::of(model, inputs, turns), &self.settings)
    }

    /// Discards the step under way, before the motion is replaced.
    pub(super) fn abandon(&mut self, model: &Model, inputs: &Inputs, turns: &[i64; 4]) {
        self.step.abandon(&AngleSystem::of(model, inputs, turns), &self.settings);
        self.held = [self.held[1], 0];
    }

    /// Restarts with another model or inputs, and from another motion if one is given, after the step under way has been ended; the change
    /// does `work`.
    pub(super) fn resume(
        &mut self,
        model: &Model,
        (inputs, turns): (&Inputs, &[i64; 4]),
        motion: Option<[Coordinates; 2]>,
        work: Work,
    ) {
        let system = AngleSystem::of(model, inputs, turns);
        self.step.replace(motion.map(|motion| motion.map(|x| angles_of(&x))));
        self.step.restart(&system, &self.settings, &system.pose(self.step.end()), work);
    }

    /// Angles, rad, and rates, rad/s, at the present time.
    pub(super) fn motion(&self, model: &Model, held: &Inputs, turns: &[i64; 4]) -> (Angles, Angles) {
        let sample = self.step.sample(&AngleSystem::of(model, held, turns), &self.settings);
        (sample.q, sample.v)
    }

    /// Present state in the twelve coordinates under the inputs `held`, with the q̈ and λ that belong to `inputs`. Interpolated states are
    /// for output only; integration never starts from them.
    pub(super) fn core(&self, model: &Model, [held, inputs]: [&Inputs; 2], turns: &[i64; 4]) -> (Core, StickSlips) {
        let system = AngleSystem::of(model, held, turns);
        let sample = self.step.sample(&system, &self.settings);
        let (q, v) = system.coordinates(&sample.pose, &sample.q, &sample.v);
        let mut core = Core::of_motion([q, v], 0);
        self.step.record(&sample, &mut core);
        let system = if held == inputs {
            FiveBar::new(model, inputs, turns).on(Mode::of_stick_slip(self.step.mode().stick_slip))
        } else {
            FiveBar::resolved(model, inputs, turns, [&core.q, &core.v])
        };
        if system.stuck() != Stuck::Nothing {
            core.balance(&system, &system.pose(&core.q), model.regularization);
        } else {
            let motion = [&sample.q, &sample.v];
            (core.a, core.lambda, core.power) = AngleSystem::new(system).balance(motion, &sample.pose, [&core.q, &core.v]);
        }
        (core, system.mode.stick_slip)
    }

    /// Refuses a run that is inconsistent with this system.
    pub(super) fn check(&self, system: &AngleSystem<'_>, bounds: &Bounds) -> Result<(), Inconsistency> {
        if self.held.iter().any(|steps| *steps > self.step.steps()) {
            return Err("inputs are held for more steps than the run has");
        }
        for ((state, mode), ends) in self.step.ends().into_iter().zip([false, true]) {
            let (x, rates) = system.coordinates(&system.pose(&state.q), &state.q, &state.v);
            if mode.closure_branch.is_some_and(|closure_branch| !closure_branch.is_of(&system.model().mechanism.geometry)) {
                return Err("its branch of the closure does not exist");
            }
            system.five_bar().on(mode).check_stick_slip([&x, &rates], ends)?;
        }
        self.step.check(system, &self.settings, bounds)
    }

    /// Limits of the next step if the inputs remain constant, with `left` macro steps until the end of the call.
    fn horizon(&self, steps: MacroSteps, left: u64) -> Horizon {
        // Converted through a signed integer, for which processors have an instruction.
        let rest = left as i64 as f64 * steps.h;
        // Inputs that have changed may change again after as many macro steps as before; the rest of a longer step would be discarded.
        let limit = match self.held[0].saturating_sub(self.held[1]) {
            _ if !steps.open_ended => rest,
            0 => steps.change,
            same => steps.change.min(same as f64 * steps.h),
        };
        // A step that cannot pass the end of the call needs no interpolant: no output lies inside it.
        Horizon { output: if limit > rest { rest } else { f64::INFINITY }, limit }
    }

    /// Advances by macro steps with constant `inputs`. A failure changes nothing.
    pub(super) fn advance(
        &mut self,
        model: &Model,
        (held, turns): (&mut Inputs, &mut [i64; 4]),
        inputs: &Inputs,
        mut steps: MacroSteps,
    ) -> Result<(), StepFailure> {
        if steps.change == steps.h {
            // The step under way also ends at this change, up to the round-off of sums of macro steps.
            steps.h = self.step.rounded_to_end(steps.h);
            steps.change = steps.h;
        }
        // Most calls end inside the step under way and need no copy.
        if steps.count == 1 && held == inputs && self.step.advance_within(steps.h, 1) == 1 {
            self.held[1] += 1;
            return Ok(());
        }
        let before = (self.clone(), *held, *turns);
        self.forward(model, (held, turns), inputs, steps).inspect_err(|_| (*self, *held, *turns) = before)
    }

    fn forward(
        &mut self,
        model: &Model,
        (held, turns): (&mut Inputs, &mut [i64; 4]),
        inputs: &Inputs,
        steps: MacroSteps,
    ) -> Result<(), StepFailure> {
        let settings = self.settings;
        let mut changed = !model.same_active_inputs(held, inputs);
        if changed {
            self.stop(model, held, turns).map_err(|cause| steps.failure(0, cause))?;
            self.held = [self.held[1], 0];
        }
        *held = *inputs;
        let mut step = 0;
        loop {
            let within = self.step.advance_within(steps.h, steps.count - step);
            self.held[1] += within;
            step += within;
            if step == steps.count {
                return Ok(());
            }
            // Whole turns are removed before a new step begins, so that a step does not mix both counts.
            remove_whole_turns(&mut self.step, turns);
            let system = AngleSystem::of(model, inputs, turns);
            let pose = changed.then(|| system.pose(self.step.end()));
            if let Some(pose) = &pose {
                self.step.restart(&system, &settings, pose, Work::default());
                changed = false;
            }
            let mut at_hand = pose.as_ref();
            loop {
                let horizon = self.horizon(steps, steps.count - step);
                self.step
                    .advance_past(&system, &settings, steps.h, horizon, at_hand.take())
                    .map_err(|cause| steps.failure(step, cause))?;
                let within = self.step.advance_within(steps.h, steps.count - step - 1);
                self.held[1] += 1 + within;
                step += 1 + within;
                if step == steps.count || has_whole_turns(&self.step) {
                    break;
                }
            }
        }
    }
}

/// Whether an angle exceeds two turns.
fn has_whole_turns(step: &DenseStep<ANGLES, CLOSURES, Mode>) -> bool {
    step.end().max_norm() > 2.0 * TAU
}

/// Moves whole turns from angles that exceed two turns into `turns`, as [`super::state::remove_whole_turns`] does for q.
fn remove_whole_turns(step: &mut DenseStep<ANGLES, CLOSURES, Mode>, turns: &mut [i64; 4]) {
    if !has_whole_turns(step) {
        return;
    }
    let mut shift = Angles::ZERO;
    for (turns, i) in turns.iter_mut().zip(LINK_INDICES) {
        shift[i] = -whole_turns(step.end()[i], turns) * TAU;
    }
    step.shift(&shift);
}
