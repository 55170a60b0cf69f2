//! A run under way: inputs, whole turns, and the integrator with its settings and state. There are four kinds: by macro steps, with dense
//! output, conserving, and for model exchange.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bifurcation;
use super::commands::Commands;
use super::dense_run::DenseRun;
use super::five_bar::FiveBar;
use super::join::discontinuity;
use super::macro_steps::{MacroSteps, StepFailure};
use super::methods::{MacroStepMethod, MethodSettings, method_settings};
use super::model::Model;
use super::model_exchange::ModelExchangeState;
use super::state::{Core, State, remove_whole_turns};
use crate::copies::clone_by_fields;
use crate::effects::Inputs;
use crate::effects::payload::Join;
use crate::hybrid::{Mode, StickSlips};
use crate::integrator::i3alp_conserving::{self, ConservingRun};
use crate::integrator::{Counters, Implicit, StepError, System, Work};
use crate::linear::cut_loop::CUT_UNKNOWNS;
use crate::mechanism::coordinates::link_angles;
use crate::mechanism::{Assembly, COORDINATES, Coordinates};

/// Changing part of a simulation. A copy is a complete snapshot.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Run {
    /// Whole turns of links 1 to 4 that the angles of the integrator omit.
    pub(super) turns: [i64; 4],
    /// Inputs of the last step.
    pub(super) inputs: Inputs,
    /// Kinetic plus potential energy at the start, J.
    pub(super) energy_at_start: f64,
    pub(super) integrator: Integrator,
    /// Servo references that act late, if `servo.delay` is not 0.
    pub(super) commands: Option<Box<Commands>>,
}

clone_by_fields!(Run { turns, inputs, energy_at_start, integrator, commands });

/// Integrator with its settings and state, by the kind of its steps.
#[expect(clippy::large_enum_variant, reason = "a copy is a snapshot, and a step allocates nothing")]
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) enum Integrator {
    /// Steps end with the macro step.
    MacroStepped(MacroStepped),
    /// Steps run past the macro step.
    DenseOutput(DenseRun),
    /// Steps of the conserving method.
    Conserving(Conserving),
    /// States set by a master.
    ModelExchange(ModelExchangeState),
}

/// Run by a method whose steps end with the macro step.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct MacroStepped {
    pub(super) method: MacroStepMethod,
    pub(super) core: Core,
    pub(super) mode: Mode,
}

/// Run by the conserving method. Accelerations and joint forces are not part of its state.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Conserving {
    pub(super) settings: i3alp_conserving::Settings,
    pub(super) state: ConservingRun<COORDINATES, CUT_UNKNOWNS>,
}

impl MacroStepped {
    /// Continues from a state that has jumped, or with other inputs; the change did this work, J. Mode and signs of the singularity
    /// determinants follow from the state.
    pub(super) fn restart(&mut self, model: &Model, (inputs, turns): (&Inputs, &[i64; 4]), work: Work) {
        let Self { core, mode, .. } = self;
        let system = FiveBar::resolved(model, inputs, turns, [&core.q, &core.v]);
        *mode = system.mode;
        core.work += work;
        let pose = system.pose(&core.q);
        core.configuration_signs = system.configuration_signs(&pose);
        core.restart(&system, &pose, model.regularization);
    }
}

impl Run {
    /// Starts from q and q̇, which satisfy the constraints.
    pub(super) fn start(model: &Model, q: Coordinates, v: Coordinates, inputs: &Inputs) -> Self {
        let mut turns = [0; 4];
        let system = FiveBar::resolved(model, inputs, &turns, [&q, &v]);
        let (mode, mut core) = (system.mode, Core::start(&system, q, v, model.regularization));
        remove_whole_turns(&mut core.q, &mut turns);
        let mut state = State { core, turns, inputs: *inputs, energy_at_start: 0.0, stick_slip: mode.stick_slip };
        state.energy_at_start = state.energy(model);
        let energy_at_start = state.energy_at_start;
        let integrator = match method_settings(model, energy_at_start) {
            MethodSettings::MacroStep(method) => Integrator::MacroStepped(MacroStepped { method, core, mode }),
            MethodSettings::Conserving(settings) => {
                let system = FiveBar::new(model, inputs, &turns);
                Integrator::Conserving(Conserving { settings, state: ConservingRun::start(&system, core.q, core.v) })
            }
            MethodSettings::Dense(settings) => Integrator::DenseOutput(DenseRun::start(model, settings, &state)),
        };
        Self { turns, inputs: *inputs, energy_at_start, integrator, commands: Commands::start(model, inputs) }
    }

    /// Starts a run for model exchange: the master sets proximal angles and rates, which keep their whole turns. The distal links stay in
    /// `assembly`.
    pub(super) fn start_for_model_exchange(model: &Model, [q, v]: [Coordinates; 2], inputs: &Inputs, assembly: Assembly) -> Self {
        let states = ModelExchangeState::start(link_angles(&q), link_angles(&v), assembly);
        let core = states.core(model, inputs);
        let state = State { core, turns: [0; 4], inputs: *inputs, energy_at_start: 0.0, stick_slip: StickSlips::OPEN };
        let energy_at_start = state.energy(model);
        Self { turns: [0; 4], inputs: *inputs, energy_at_start, integrator: Integrator::ModelExchange(states), commands: None }
    }

    /// Whether a master sets proximal angles and rates (model exchange).
    pub fn is_model_exchange(&self) -> bool {
        matches!(self.integrator, Integrator::ModelExchange(_))
    }

    /// Whether servo references act late.
    pub fn has_commands(&self) -> bool {
        self.commands.is_some()
    }

    /// Sets the settings of the model's method; refused if a method of another kind made the run.
    pub(super) fn configure(&mut self, model: &Model) -> Result<(), crate::integrator::Inconsistency> {
        match (method_settings(model, self.energy_at_start), &mut self.integrator) {
            (MethodSettings::MacroStep(method), Integrator::MacroStepped(run)) => run.method = method,
            (MethodSettings::Conserving(settings), Integrator::Conserving(run)) => run.settings = settings,
            (MethodSettings::Dense(settings), Integrator::DenseOutput(run)) => run.settings = settings,
            (_, Integrator::ModelExchange(_)) => {}
            _ => return Err("its run was made by another solver.method"),
        }
        Ok(())
    }

    /// Advances by macro steps with constant `inputs`; the states of model exchange do not change. A failure changes nothing.
    pub(super) fn advance(&mut self, model: &Model, inputs: &Inputs, steps: MacroSteps) -> Result<(), StepFailure> {
        let Self { turns, inputs: held, .. } = self;
        match &mut self.integrator {
            Integrator::MacroStepped(run) => run.advance(model, (held, turns), inputs, steps),
            Integrator::Conserving(run) => run.advance(model, (held, turns), inputs, steps),
            Integrator::DenseOutput(run) => run.advance(model, (held, turns), inputs, steps),
            Integrator::ModelExchange(_) => Ok(()),
        }
    }

    /// As [`advance`](Self::advance), but not inlined: one copy for all calls except the plain one keeps the library small.
    #[inline(never)]
    pub(super) fn advance_apart(&mut self, model: &Model, inputs: &Inputs, steps: MacroSteps) -> Result<(), StepFailure> {
        self.advance(model, inputs, steps)
    }

    /// Present state, with the q̈ and λ that belong to `inputs`.
    pub(super) fn state(&self, model: &Model, inputs: &Inputs) -> State {
        let &Self { turns, energy_at_start, .. } = self;
        let (core, stick_slip) = match &self.integrator {
            Integrator::MacroStepped(run) if model.same_active_inputs(&self.inputs, inputs) => (run.core, run.mode.stick_slip),
            Integrator::MacroStepped(MacroStepped { core, .. }) => {
                let mut core = *core;
                let system = FiveBar::resolved(model, inputs, &turns, [&core.q, &core.v]);
                core.balance(&system, &system.pose(&core.q), model.regularization);
                (core, system.mode.stick_slip)
            }
            Integrator::Conserving(run) => {
                (run.state.state(&FiveBar::new(model, inputs, &turns), model.regularization), StickSlips::OPEN)
            }
            Integrator::DenseOutput(run) => run.core(model, [&self.inputs, inputs], &turns),
            Integrator::ModelExchange(run) => (run.core(model, inputs), StickSlips::OPEN),
        };
        State { core, turns, inputs: *inputs, energy_at_start, stick_slip }
    }

    /// Replaces the model. The change of potential energy counts as input work, and `join` decides how added mass joins. A failure changes
    /// nothing.
    pub(super) fn tune(&mut self, before: &Model, after: &Model, join: Join) -> Result<(), StepError> {
        // Commands do not change, and a copy of them would need memory.
        let commands = self.commands.take();
        let tuned = self.tuned(before, after, join).map(|tuned| *self = tuned);
        self.commands = commands;
        tuned
    }

    fn tuned(&self, before: &Model, after: &Model, join: Join) -> Result<Self, StepError> {
        let mut tuned = self.clone();
        if let Integrator::DenseOutput(run) = &mut tuned.integrator {
            run.stop(before, &tuned.inputs, &tuned.turns)?;
        }
        let present = tuned.state(before, &self.inputs);
        let (motion, work) = discontinuity(&present, before, after, join);
        // The method is the same, so the configuration cannot fail.
        let _ = tuned.configure(after);
        tuned.resume(after, motion, work);
        Ok(tuned)
    }

    /// Continues with the present inputs after a change that did this work, J, and may have led to other coordinates and velocities. A step
    /// under way has already been ended.
    pub(super) fn resume(&mut self, model: &Model, motion: Option<[Coordinates; 2]>, work: Work) {
        let Self { turns, inputs, integrator, .. } = self;
        match integrator {
            Integrator::MacroStepped(run) => {
                if let Some([q, v]) = motion {
                    (run.core.q, run.core.v) = (q, v);
                }
                (run.core.energy, run.core.branch) = (None, None);
                run.restart(model, (inputs, turns), work);
            }
            Integrator::Conserving(Conserving { state, .. }) => {
                if let Some([q, v]) = motion {
                    (state.q, state.v) = (q, v);
                    state.configuration_signs = model.mechanism.pose(&q).configuration_signs();
                }
                state.restart(work);
            }
            Integrator::DenseOutput(run) => run.resume(model, (inputs, turns), motion, work),
            Integrator::ModelExchange(run) => run.resume(motion, work),
        }
    }
}

/// Runs whose steps end with the macro step.
trait ByMacroSteps: Copy {
    /// Continues with other inputs.
    fn change(&mut self, model: &Model, held: (&Inputs, &[i64; 4]));

    /// Makes one macro step of h seconds. A failure leaves the state undefined.
    fn step<const BARE: bool>(&mut self, system: &FiveBar<'_, BARE>, h: f64) -> Result<(), StepError>;

    /// Coordinates and counters. Whole turns are counted separately and not part of the coordinates.
    fn counted(&mut self) -> (&mut Coordinates, &mut Counters);

    /// Advances by macro steps with constant `inputs`. A failure changes nothing.
    fn advance(
        &mut self,
        model: &Model,
        (held, turns): (&mut Inputs, &mut [i64; 4]),
        inputs: &Inputs,
        steps: MacroSteps,
    ) -> Result<(), StepFailure> {
        let before = (*self, *turns, *held);
        if !model.same_active_inputs(held, inputs) {
            self.change(model, (inputs, turns));
        }
        *held = *inputs;
        let taken = match model.is_bare() {
            true => self.take::<true>(model, (held, turns), steps),
            false => self.take::<false>(model, (held, turns), steps),
        };
        taken.inspect_err(|_| (*self, *turns, *held) = before)
    }

    /// Makes macro steps in one form of the system. A failure leaves the state undefined.
    fn take<const BARE: bool>(
        &mut self,
        model: &Model,
        (inputs, turns): (&Inputs, &mut [i64; 4]),
        steps: MacroSteps,
    ) -> Result<(), StepFailure> {
        let turns_at_start = *turns;
        let system = FiveBar::new(model, inputs, &turns_at_start).in_form::<BARE>();
        for step in 0..steps.count {
            self.step(&system.with_turns(turns), steps.h).map_err(|cause| steps.failure(step, cause))?;
            let (q, counters) = self.counted();
            counters.steps += 1;
            remove_whole_turns(q, turns);
        }
        Ok(())
    }
}

impl ByMacroSteps for MacroStepped {
    fn change(&mut self, model: &Model, held: (&Inputs, &[i64; 4])) {
        self.restart(model, held, Work::default());
    }

    fn step<const BARE: bool>(&mut self, system: &FiveBar<'_, BARE>, h: f64) -> Result<(), StepError> {
        self.method.advance(system, &mut self.core, &mut self.mode, h)
    }

    fn counted(&mut self) -> (&mut Coordinates, &mut Counters) {
        (&mut self.core.q, &mut self.core.counters)
    }
}

impl Conserving {
    /// Makes a step of h seconds in the link angles, on the closure branch, and scales the rates to the energy if nothing dissipates it.
    /// Returns whether the step was possible.
    #[cold]
    #[inline(never)]
    fn cross(&mut self, system: FiveBar<'_>, h: f64) -> Result<bool, StepError> {
        let core = self.state.state(&system, self.settings.equilibrium);
        let Some(transit) = bifurcation::conserving_crossing(system, &core, h) else { return Ok(false) };
        self.state.cross(&system, &transit)?;
        Ok(true)
    }
}

impl ByMacroSteps for Conserving {
    fn change(&mut self, _: &Model, _: (&Inputs, &[i64; 4])) {
        self.state.change();
    }

    fn step<const BARE: bool>(&mut self, system: &FiveBar<'_, BARE>, h: f64) -> Result<(), StepError> {
        if bifurcation::may_leave_branch(system, [&self.state.q, &self.state.v], h) && self.cross(system.general(), h)? {
            return Ok(());
        }
        self.state.advance(system, &system.general(), &self.settings, h)
    }

    fn counted(&mut self) -> (&mut Coordinates, &mut Counters) {
        (&mut self.state.q, &mut self.state.counters)
    }
}
