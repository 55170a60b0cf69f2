//! A run by the explicit method, whose steps go past the communication points: the step under way in the link angles.

use std::f64::consts::TAU;

use borsh::{BorshDeserialize, BorshSerialize};

use super::angles::{ANGLES, Angles, ByAngles, CLOSURES, PLACES, angles_of};
use super::five_bar::FiveBar;
use super::restore::check_stick_slip;
use super::run::{MacroSteps, StepFailure};
use super::state::{Core, State, whole_turns};
use super::{Inputs, Model};
use crate::effects::{Mode, StickSlips};
use crate::integrator::dense::{DenseStep, Horizon, Settings};
use crate::integrator::{Bounds, Counters, Inconsistency, StepError, System, Work};
use crate::mechanism::{Coordinates, Multipliers};

/// The step under way, and for how long inputs are held.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct DenseRun {
    pub(super) step: DenseStep<ANGLES, CLOSURES, Mode>,
    /// For how many macro steps the inputs before the present ones were held, 0 at first, and these so far.
    held: [u64; 2],
}

impl DenseRun {
    /// The run that begins with a state.
    pub(super) fn start(model: &Model, settings: &Settings, state: &State) -> Self {
        let system = ByAngles::new(FiveBar::<false>::new(model, &state.inputs, &state.turns));
        let step = DenseStep::start(&system, angles_of(&state.core.q), angles_of(&state.core.v), settings);
        Self { step, held: [0; 2] }
    }

    /// Before model or inputs change: what runs past the present time is thrown away, and the present state is the end of a step. On
    /// failure the run is undefined.
    pub(super) fn stop(&mut self, model: &Model, settings: &Settings, inputs: &Inputs, turns: &[i64; 4]) -> Result<(), StepError> {
        if self.step.finish() {
            return Ok(());
        }
        self.step.truncate_and_redo(&ByAngles::new(FiveBar::<false>::new(model, inputs, turns)), settings)
    }

    /// After they have changed, which did some work.
    pub(super) fn resume(&mut self, model: &Model, settings: &Settings, (inputs, turns): (&Inputs, &[i64; 4]), work: Work) {
        let system = ByAngles::new(FiveBar::<false>::new(model, inputs, turns));
        self.step.restart(&system, settings, &system.pose(self.step.end()), work);
    }

    /// Angles and rates at the present time.
    pub(super) fn motion(&self, model: &Model, held: &Inputs, turns: &[i64; 4]) -> (Angles, Angles) {
        let sample = self.step.sample(&ByAngles::new(FiveBar::<false>::new(model, held, turns)), model.dense_settings());
        (sample.q, sample.v)
    }

    /// Goes on from other angles and rates with other inputs, which puts in some energy, J.
    pub(super) fn resume_from(
        &mut self,
        model: &Model,
        settings: &Settings,
        ([held, inputs], turns): ([&Inputs; 2], &[i64; 4]),
        motion: [Angles; 2],
        external_work: f64,
    ) {
        let [before, after] = [held, inputs].map(|inputs| ByAngles::new(FiveBar::<false>::new(model, inputs, turns)));
        self.step.resume_from([&before, &after], settings, motion, external_work);
        self.held = [self.held[1], 0];
    }

    /// The present state in the twelve coordinates, made with the inputs held, and with the q̈ and λ that belong to others. Interpolated
    /// states are for output only; integration never starts from them.
    pub(super) fn core(&self, model: &Model, [held, inputs]: [&Inputs; 2], turns: &[i64; 4]) -> (Core, StickSlips) {
        let system = ByAngles::new(FiveBar::<false>::new(model, held, turns));
        let sample = self.step.sample(&system, model.dense_settings());
        let (q, v) = system.coordinates(&sample.pose, &sample.q, &sample.v);
        let mut core = Core {
            q,
            v,
            a: Coordinates::ZERO,
            lambda: Multipliers::ZERO,
            jerk: Coordinates::ZERO,
            substep: 0.0,
            error_estimate: 0.0,
            work: Work::default(),
            power: Work::default(),
            configuration_signs: 0,
            on_ray: false,
            alternatives: 0,
            counters: Counters::default(),
        };
        self.step.record(&sample, &mut core);
        let system = if held == inputs {
            FiveBar::<false>::new(model, inputs, turns).on(Mode::of_stick_slip(self.step.mode().stick_slip))
        } else {
            FiveBar::<false>::resolved(model, inputs, turns, [&core.q, &core.v])
        };
        if system.has_sticking() {
            core.balance(&system, &system.pose(&core.q), model.regularization);
        } else {
            let motion = [&sample.q, &sample.v];
            (core.a, core.lambda, core.power) = ByAngles::new(system).balance(motion, &sample.pose, [&core.q, &core.v]);
        }
        (core, system.mode.stick_slip)
    }

    /// Refuses a run that is none of this system.
    pub(super) fn check(&self, system: &ByAngles<'_>, settings: &Settings, bounds: &Bounds) -> Result<(), Inconsistency> {
        if self.held.iter().any(|steps| *steps > self.step.steps()) {
            return Err("inputs are held for more steps than the run has");
        }
        for ((state, mode), ends) in self.step.ends().into_iter().zip([false, true]) {
            let (x, rates) = system.coordinates(&system.pose(&state.q), &state.q, &state.v);
            if mode.closure_branch.is_some_and(|closure_branch| !closure_branch.is_of(&system.model().mechanism.geometry)) {
                return Err("its branch of the closure does not exist");
            }
            check_stick_slip(system.model(), &system.five_bar().on(mode), [&x, &rates], ends)?;
        }
        self.step.check(system, settings, bounds)
    }

    /// How long steps may be while the inputs stay, with `left` macro steps of the call to come.
    fn horizon(&self, steps: MacroSteps, left: u64) -> Horizon {
        // By way of a signed number, which processors know.
        let rest = left as i64 as f64 * steps.h;
        // Inputs that have changed may change again after as many macro steps as before: to step past that would be in vain.
        let limit = match self.held[0].saturating_sub(self.held[1]) {
            _ if !steps.open_ended => rest,
            0 => f64::INFINITY,
            same => same as f64 * steps.h,
        };
        // A step that ends with the call is never interpolated.
        Horizon { output: if limit > rest { rest } else { f64::INFINITY }, limit }
    }
}

/// A run with what its steps hold.
pub(super) struct Held<'a> {
    pub(super) run: &'a mut DenseRun,
    pub(super) inputs: &'a mut Inputs,
    /// Whole turns of links 1 to 4 that the angles under way leave out.
    pub(super) turns: &'a mut [i64; 4],
}

impl Held<'_> {
    /// Macro steps with inputs held. On failure everything is as before.
    pub(super) fn advance(
        mut self,
        model: &Model,
        settings: &Settings,
        inputs: &Inputs,
        steps: MacroSteps,
    ) -> Result<(), StepFailure> {
        // A call that ends inside the step under way, as most do, costs no copy.
        if steps.count == 1 && self.inputs == inputs && self.run.step.advance_within(steps.h, 1) == 1 {
            self.run.held[1] += 1;
            return Ok(());
        }
        let before = (self.run.clone(), *self.inputs, *self.turns);
        self.forward(model, settings, inputs, steps).inspect_err(|_| (*self.run, *self.inputs, *self.turns) = before)
    }

    #[inline(never)]
    fn forward(&mut self, model: &Model, settings: &Settings, inputs: &Inputs, steps: MacroSteps) -> Result<(), StepFailure> {
        let Self { run, inputs: held, turns } = self;
        let mut changed = !model.same_active_inputs(held, inputs);
        if changed {
            run.stop(model, settings, held, turns).map_err(|cause| steps.failure(0, cause))?;
            run.held = [run.held[1], 0];
        }
        **held = *inputs;
        let mut step = 0;
        loop {
            let within = run.step.advance_within(steps.h, steps.count - step);
            run.held[1] += within;
            step += within;
            if step == steps.count {
                return Ok(());
            }
            // Before a new step begins, so that each is made from the angles that it has.
            remove_whole_turns(&mut run.step, turns);
            let system = ByAngles::new(FiveBar::<false>::new(model, inputs, turns));
            let pose = changed.then(|| system.pose(run.step.end()));
            if let Some(pose) = &pose {
                run.step.restart(&system, settings, pose, Work::default());
                changed = false;
            }
            let mut at_hand = pose.as_ref();
            loop {
                let horizon = run.horizon(steps, steps.count - step);
                run.step
                    .advance_past(&system, settings, steps.h, horizon, at_hand.take())
                    .map_err(|cause| steps.failure(step, cause))?;
                let within = run.step.advance_within(steps.h, steps.count - step - 1);
                run.held[1] += 1 + within;
                step += 1 + within;
                if step == steps.count || has_whole_turns(&run.step) {
                    break;
                }
            }
        }
    }
}

/// Whether angles are more than two turns.
#[inline(always)]
fn has_whole_turns(step: &DenseStep<ANGLES, CLOSURES, Mode>) -> bool {
    step.end().max_norm() > 2.0 * TAU
}

/// Moves whole turns of the angles into `turns`, where they are more than two: as [`super::state::remove_whole_turns`] does with q.
#[inline(always)]
fn remove_whole_turns(step: &mut DenseStep<ANGLES, CLOSURES, Mode>, turns: &mut [i64; 4]) {
    if !has_whole_turns(step) {
        return;
    }
    let mut shift = Angles::ZERO;
    for (turns, i) in turns.iter_mut().zip(PLACES) {
        shift[i] = -whole_turns(step.end()[i], turns) * TAU;
    }
    step.shift(&shift);
}
