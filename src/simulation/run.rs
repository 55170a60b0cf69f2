//! A run under way: inputs, whole turns and integrator state, by macro steps, with dense output, conserving, or for model exchange.

use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use super::dense_run::{DenseRun, HeldRun};
use super::five_bar::FiveBar;
use super::join::Discontinuity;
use super::model::{Model, Stepper};
use super::model_exchange::ModelExchangeState;
use super::state::{Core, State, remove_whole_turns};
use crate::effects::payload::Join;
use crate::effects::{Inputs, Mode, StickSlips};
use crate::integrator::i3alp_conserving::ConservingRun;
use crate::integrator::{Counters, MacroStepMethod, StepError, System, i3alp};
use crate::linear::cut_loop::CUT_UNKNOWNS;
use crate::mechanism::coordinates::THETA;
use crate::mechanism::{COORDINATES, Coordinates};

/// Changing part of a simulation. A copy is a complete snapshot.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Run {
    /// Whole turns of links 1 to 4 that the angles of the integrator leave out.
    pub(super) turns: [i64; 4],
    /// Held inputs.
    pub(super) inputs: Inputs,
    /// Kinetic plus potential energy at the start, J.
    pub(super) energy_at_start: f64,
    pub(super) integrator: IntegratorState,
}

/// State of the integrator, by the kind of its steps.
#[expect(clippy::large_enum_variant, reason = "a copy is a snapshot, and a step allocates nothing")]
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) enum IntegratorState {
    /// Steps end with the macro step: state and stick-slip states.
    MacroStepped(Core, StickSlips),
    /// Steps run past the macro step: the step under way.
    DenseOutput(DenseRun),
    /// Steps of the conserving method: accelerations and joint forces are not part of the state.
    Conserving(ConservingRun<COORDINATES, CUT_UNKNOWNS>),
    /// States set by a master.
    ModelExchange(ModelExchangeState),
}

/// Failure of an advance. The simulation is as it was before the call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepFailure {
    /// Time reached, s after the beginning of the call.
    pub elapsed: f64,
    /// Cause of the failure.
    pub cause: StepError,
}

impl fmt::Display for StepFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} s into the call, {}", self.elapsed, self.cause)
    }
}

impl std::error::Error for StepFailure {}

/// Equal macro steps with inputs held.
#[derive(Clone, Copy, Debug)]
pub(super) struct MacroSteps {
    /// Length of each, s.
    pub(super) h: f64,
    /// Number.
    pub(super) count: u64,
    /// Whether the inputs may stay the same after them, so that a step may run past their end.
    pub(super) open_ended: bool,
}

impl MacroSteps {
    /// Failure of the macro step with index `step`.
    pub(super) fn failure(&self, step: u64, cause: StepError) -> StepFailure {
        StepFailure { elapsed: step as f64 * self.h, cause }
    }
}

impl Run {
    /// Starts from q and q̇, which satisfy the constraints.
    #[cold]
    pub(super) fn start(model: &Model, q: Coordinates, v: Coordinates, inputs: &Inputs) -> Self {
        let mut turns = [0; 4];
        let system = FiveBar::<false>::resolved(model, inputs, &turns, [&q, &v]);
        let (stick_slip, mut core) = (system.mode.stick_slip, Core::start(&system, q, v, model.regularization));
        // States set from outside keep their whole turns.
        if !matches!(model.stepper, Stepper::ModelExchange(_)) {
            remove_whole_turns(&mut core.q, &mut turns);
        }
        let mut state = State { core, turns, inputs: *inputs, energy_at_start: 0.0, stick_slip };
        state.energy_at_start = state.kinetic_energy(model) + state.potential_energy(model);
        let integrator = match &model.stepper {
            Stepper::MacroStep(_) => IntegratorState::MacroStepped(core, stick_slip),
            Stepper::Conserving(_) => {
                let system = FiveBar::<false>::new(model, inputs, &turns);
                IntegratorState::Conserving(ConservingRun::start(&system, core.q, core.v))
            }
            Stepper::Dense(settings) => IntegratorState::DenseOutput(DenseRun::start(model, settings, &state)),
            Stepper::ModelExchange(_) => {
                IntegratorState::ModelExchange(ModelExchangeState::start(THETA.map(|i| q[i]), THETA.map(|i| v[i])))
            }
        };
        Self { turns, inputs: *inputs, energy_at_start: state.energy_at_start, integrator }
    }

    /// Whether proximal angles and rates are set by a master (model exchange).
    pub fn is_model_exchange(&self) -> bool {
        matches!(self.integrator, IntegratorState::ModelExchange(_))
    }

    /// Advances by macro steps with `inputs` held. A failure changes nothing.
    #[inline(never)] // called from five places
    pub(super) fn advance(&mut self, model: &Model, inputs: &Inputs, steps: MacroSteps) -> Result<(), StepFailure> {
        match (&model.stepper, &mut self.integrator) {
            (Stepper::MacroStep(method), IntegratorState::MacroStepped(core, stick_slip)) => {
                let before = (*core, *stick_slip, self.turns, self.inputs);
                if !model.same_active_inputs(&self.inputs, inputs) {
                    let system = FiveBar::<false>::resolved(model, inputs, &self.turns, [&core.q, &core.v]);
                    *stick_slip = system.mode.stick_slip;
                    core.restart(&system, &system.pose(&core.q), model.regularization);
                }
                self.inputs = *inputs;
                let held = (&self.inputs, &mut self.turns);
                let mut mode = Mode::of_stick_slip(*stick_slip);
                let advanced = match method {
                    // The default method has a form compiled for the bare mechanism; of the other methods the saving is not worth the code
                    // size.
                    MacroStepMethod::I3alp(settings) if model.is_bare() => {
                        macro_steps::<true, _>(model, core, held, steps, |system, core, h| {
                            i3alp::advance(system, settings, core, &mut mode, h)
                        })
                    }
                    MacroStepMethod::I3alp(settings) => {
                        let settings = i3alp::Settings { energy_at_start: self.energy_at_start, ..*settings };
                        macro_steps::<false, _>(model, core, held, steps, |system, core, h| {
                            i3alp::advance(system, &settings, core, &mut mode, h)
                        })
                    }
                    _ => macro_steps::<false, _>(model, core, held, steps, |system, core, h| {
                        method.advance(system, core, &mut mode, h)
                    }),
                };
                *stick_slip = mode.stick_slip;
                advanced.inspect_err(|_| (*core, *stick_slip, self.turns, self.inputs) = before)
            }
            (Stepper::Conserving(settings), IntegratorState::Conserving(run)) => {
                let before = (*run, self.turns, self.inputs);
                if !model.same_active_inputs(&self.inputs, inputs) {
                    run.change();
                }
                self.inputs = *inputs;
                let held = (&self.inputs, &mut self.turns);
                let advanced = if model.is_bare() {
                    macro_steps::<true, _>(model, run, held, steps, |system, run, h| {
                        run.advance((system, &system.general()), settings, h)
                    })
                } else {
                    macro_steps::<false, _>(model, run, held, steps, |system, run, h| {
                        run.advance((system, &system.general()), settings, h)
                    })
                };
                advanced.inspect_err(|_| (*run, self.turns, self.inputs) = before)
            }
            (Stepper::Dense(settings), IntegratorState::DenseOutput(run)) => {
                HeldRun { run, inputs: &mut self.inputs, turns: &mut self.turns }.advance(model, settings, inputs, steps)
            }
            _ => unreachable!("a run is made for its method"),
        }
    }

    /// Present state, with the q̈ and λ that belong to `inputs`.
    pub(super) fn state(&self, model: &Model, inputs: &Inputs) -> State {
        let &Self { turns, energy_at_start, ref integrator, .. } = self;
        let same = model.same_active_inputs(&self.inputs, inputs);
        let (core, stick_slip) = match integrator {
            IntegratorState::MacroStepped(core, stick_slip) if same => (*core, *stick_slip),
            IntegratorState::MacroStepped(core, _) => {
                let mut core = *core;
                let system = FiveBar::<false>::resolved(model, inputs, &turns, [&core.q, &core.v]);
                core.balance(&system, &system.pose(&core.q), model.regularization);
                (core, system.mode.stick_slip)
            }
            IntegratorState::Conserving(run) => {
                (run.state(&FiveBar::<false>::new(model, inputs, &turns), model.regularization), StickSlips::OPEN)
            }
            IntegratorState::DenseOutput(run) => run.core(model, [&self.inputs, inputs], &turns),
            IntegratorState::ModelExchange(run) => (run.core(model, inputs), StickSlips::OPEN),
        };
        State { core, turns, inputs: *inputs, energy_at_start, stick_slip }
    }

    /// Replaces the model: the change of potential energy counts as input work, and added mass joins as `join` says. A failure changes
    /// nothing.
    pub(super) fn tune(&mut self, before: &Model, after: &Model, join: Join) -> Result<(), StepError> {
        let mut tuned = self.clone();
        if let (Stepper::Dense(settings), IntegratorState::DenseOutput(run)) = (&before.stepper, &mut tuned.integrator) {
            run.stop(before, settings, &tuned.inputs, &tuned.turns)?;
        }
        let present = tuned.state(before, &self.inputs);
        let Discontinuity { work, motion } = Discontinuity::new(&present, before, after, join);
        match (&after.stepper, &mut tuned.integrator) {
            (Stepper::Dense(settings), IntegratorState::DenseOutput(run)) => {
                if let Some(motion) = motion {
                    run.step.jump(&motion.rates);
                }
                run.resume(after, settings, (&tuned.inputs, &tuned.turns), work);
            }
            (_, IntegratorState::Conserving(run)) => {
                if let Some(motion) = motion {
                    (run.q, run.v) = (motion.q, motion.v);
                }
                run.restart(work);
            }
            (_, IntegratorState::ModelExchange(run)) => run.jump(work, motion.map(|motion| motion.rates)),
            (_, IntegratorState::MacroStepped(core, stick_slip)) => {
                if let Some(motion) = motion {
                    (core.q, core.v) = (motion.q, motion.v);
                }
                core.work += work;
                let system = FiveBar::<false>::resolved(after, &tuned.inputs, &tuned.turns, [&core.q, &core.v]);
                *stick_slip = system.mode.stick_slip;
                core.restart(&system, &system.pose(&core.q), after.regularization);
            }
            _ => unreachable!("a run is made for its method"),
        }
        *self = tuned;
        Ok(())
    }
}

/// Runs whose steps end with the macro step.
trait MacroStepped {
    /// Coordinates, whose whole turns are counted separately, and counters.
    fn counted(&mut self) -> (&mut Coordinates, &mut Counters);
}

impl MacroStepped for Core {
    #[inline(always)]
    fn counted(&mut self) -> (&mut Coordinates, &mut Counters) {
        (&mut self.q, &mut self.counters)
    }
}

impl MacroStepped for ConservingRun<COORDINATES, CUT_UNKNOWNS> {
    #[inline(always)]
    fn counted(&mut self) -> (&mut Coordinates, &mut Counters) {
        (&mut self.q, &mut self.counters)
    }
}

/// Macro steps by a method whose steps end with them. A failure leaves the state undefined.
#[inline(always)]
fn macro_steps<const BARE: bool, R: MacroStepped>(
    model: &Model,
    run: &mut R,
    (inputs, turns): (&Inputs, &mut [i64; 4]),
    steps: MacroSteps,
    mut advance: impl FnMut(&FiveBar<'_, BARE>, &mut R, f64) -> Result<(), StepError>,
) -> Result<(), StepFailure> {
    let turns_at_start = *turns;
    let system = FiveBar::<BARE>::new(model, inputs, &turns_at_start);
    for step in 0..steps.count {
        advance(&system.with_turns(turns), run, steps.h).map_err(|cause| steps.failure(step, cause))?;
        let (q, counters) = run.counted();
        counters.steps += 1;
        remove_whole_turns(q, turns);
    }
    Ok(())
}
