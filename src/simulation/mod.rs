//! A simulation: the constant [`Model`] of a scene, and a [`Run`] that advances it by macro steps.
//!
//! The module knows no absolute time, no communication points and no FMI variables: a run is autonomous except for its inputs, which are
//! constant over each macro step.

pub mod angles;
mod bifurcation;
pub mod bindings;
mod commands;
mod correction;
mod dense_run;
mod events;
pub mod five_bar;
mod five_bar_steps;
mod following;
mod join;
mod learned;
mod linearised;
mod macro_steps;
pub mod methods;
pub mod model;
mod model_exchange;
mod passage;
mod restore;
mod run;
mod settings;
mod signal;
mod state;
mod variation;

use crate::copies::clone_by_fields;
use crate::effects;
use crate::integrator::CONFIGURATION_SIGNS;
use crate::mechanism::{self, SceneError, closure};

pub use crate::effects::Inputs;
pub use crate::integrator::Counters;
use bindings::check_bounds;
use commands::Delay;
pub use commands::TooManyCommands;
pub use following::{Estimate, Following};
pub(crate) use learned::NEARLY_IN_PAIRS;
pub use learned::Perturbed;
pub use linearised::FollowedScene;
use macro_steps::MacroSteps;
pub use macro_steps::{FailureCause, StepFailure};
pub use model::{Model, Parameters};
pub use model_exchange::STATES;
use run::Integrator;
pub use run::Run;
use settings::sticking_law;
pub use settings::{Method, Settings};
pub use signal::{ORDERS, Signal};
pub use state::{Core, State};
pub use variation::{Direction, Variation, wrench_change};

/// A simulation of one scene. A clone continues independently, with the same bits.
#[derive(Debug)]
pub struct Simulation {
    parameters: Parameters,
    model: Box<Model>,
    run: Run,
}

clone_by_fields!(Simulation { parameters, model, run });

impl Simulation {
    /// Checks the parameters, closes the loop, selects effects and linear solve, and computes q̈ and λ of the start. Refuses parameters
    /// that are outside their bounds or do not fit together, a loop that cannot be closed, and a start with infinite accelerations or
    /// energies.
    pub fn new(parameters: &Parameters, inputs: &Inputs) -> Result<Self, SceneError> {
        let model = Model::boxed(parameters)?;
        let (q, v) = mechanism::close(&model.mechanism.geometry, &parameters.start)?;
        let run = Run::start(&model, q, v, inputs);
        Self::started(parameters, model, run)
    }

    /// Simulation for model exchange: proximal angles and rates are states that the master sets ([`Simulation::set_states`]). Refuses as
    /// [`Simulation::new`], friction that sticks, and servos that act late.
    pub fn for_model_exchange(parameters: &Parameters, inputs: &Inputs) -> Result<Self, SceneError> {
        refuse_in_model_exchange(parameters)?;
        let model = Model::boxed(parameters)?;
        let (q, v) = mechanism::close(&model.mechanism.geometry, &parameters.start)?;
        let run = Run::start_for_model_exchange(&model, [q, v], inputs, parameters.start.assembly);
        Self::started(parameters, model, run)
    }

    /// Simulation that starts from the angles, rad, and rates, rad/s, of all four links instead of `parameters.start`, also if the proximal
    /// links do not determine the posture (coinciding elbows). Refused unless they close the loop.
    pub fn at(parameters: &Parameters, inputs: &Inputs, theta: [f64; 4], omega: [f64; 4]) -> Result<Self, SceneError> {
        let model = Model::boxed(parameters)?;
        let (q, v) = closure::assemble(&model.mechanism.geometry, theta, omega);
        let run = Run::start(&model, q, v, inputs);
        let simulation = Self::started(parameters, model, run)?;
        let (mechanism, core) = (&simulation.model.mechanism, simulation.state().core);
        let pose = mechanism.pose(&core.q);
        let (gap, tear) = (mechanism.phi(&core.q, &pose).max_norm(), pose.phi_q_times(&core.v).max_norm());
        let speed = parameters.geometry.links.iter().zip(omega).map(|(link, omega)| (link.length * omega).abs()).sum::<f64>();
        if gap > closure::COLLINEARITY_TOLERANCE * simulation.model.length_scale {
            return Err(SceneError(format!("link angles {theta:?} rad do not close the loop: the legs end {gap:e} m apart.")));
        }
        if tear > closure::COLLINEARITY_TOLERANCE * speed {
            return Err(SceneError(format!(
                "link rates {omega:?} rad/s do not keep the loop closed: the legs part at {tear:e} m/s."
            )));
        }
        Ok(simulation)
    }

    fn started(parameters: &Parameters, model: Box<Model>, run: Run) -> Result<Self, SceneError> {
        let simulation = Self { parameters: parameters.clone(), run, model };
        simulation.check_start()?;
        Ok(simulation)
    }

    #[inline(never)]
    fn check_start(&self) -> Result<(), SceneError> {
        let state = self.state();
        if !state.core.a.iter().chain(state.core.lambda.iter()).all(|x| x.is_finite()) || !state.energy_at_start.is_finite() {
            return Err(SceneError(
                "the scene has accelerations or energies that are not finite: one of link[i].*, base.distance, init.*, gravity.g, tau[i], \
                 tip.f* is too large or too small for double precision."
                    .into(),
            ));
        }
        Ok(())
    }

    /// Continues a stored run with the parameters in force. Refused unless the run is finite, closes the loop and is in equilibrium with
    /// its loads.
    pub fn restored(parameters: &Parameters, run: Run) -> Result<Self, SceneError> {
        if run.is_model_exchange() {
            refuse_in_model_exchange(parameters)?;
        }
        Self::continued(parameters, Model::boxed(parameters)?, run)
    }

    /// Continues a stored run of a model with the parameters in force; refused as by [`Simulation::restored`].
    fn continued(parameters: &Parameters, model: Box<Model>, mut run: Run) -> Result<Self, SceneError> {
        run.configure(&model).map_err(|what| SceneError(what.into()))?;
        if let Some((commands, delay)) = run.commands.as_mut().zip(Delay::of(&model)) {
            commands.make_room(delay);
        }
        let simulation = Self { parameters: parameters.clone(), model, run };
        simulation.run.check(&simulation.model, parameters)?;
        Ok(simulation)
    }

    /// Advances by `steps` macro steps of `h` seconds with constant `inputs`.
    ///
    /// Servo references act `servo.delay` later. On failure everything is as before the call. Allocates nothing.
    pub fn advance(&mut self, inputs: &Inputs, h: f64, steps: u64) -> Result<(), StepFailure> {
        if self.run.commands.is_some() {
            return self.advance_delayed(&Signal::held(*inputs), h, steps);
        }
        self.run.advance(&self.model, inputs, MacroSteps { h, count: steps, open_ended: true, change: f64::INFINITY })
    }

    /// Advances by `steps` macro steps of `h` seconds with inputs that change. Each macro step uses their value at its middle: the impulse
    /// of a ramp is then exact, and the motion is of second order in h.
    pub fn advance_along(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        if signal.is_held() { self.advance(&signal.value, h, steps) } else { self.advance_changing(signal, h, steps) }
    }

    #[inline(never)]
    fn advance_changing(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        if self.run.commands.is_some() {
            return self.advance_delayed(signal, h, steps);
        }
        let before = self.run.clone();
        let one = MacroSteps { h, count: 1, open_ended: false, change: f64::INFINITY };
        signal.over((h, steps), |inputs| self.run.advance_apart(&self.model, inputs, one)).inspect_err(|_| self.run = before)
    }

    /// Advances with servo references that act late.
    #[inline(never)]
    fn advance_delayed(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        let Self { model, run, .. } = self;
        let (Some(mut commands), Some(delay)) = (run.commands.take(), Delay::of(model)) else {
            unreachable!("the run has delayed commands, but its model has no servo.delay")
        };
        let before = run.clone();
        let taken = commands.over(delay, signal, (h, steps), &mut |inputs, steps| run.advance_apart(model, inputs, steps));
        if taken.is_err() {
            *run = before;
        }
        run.commands = Some(commands);
        taken
    }

    /// Sets the states of model exchange: proximal angles, rad, left and right, and their rates, rad/s. Refused at a direct singularity and in co-simulation;
    /// a refusal changes nothing.
    pub fn set_states(&mut self, states: [f64; STATES]) -> Result<(), SceneError> {
        let Integrator::ModelExchange(run) = &mut self.run.integrator else {
            return Err(SceneError(
                "the master cannot set states in co-simulation: instantiate the unit for model exchange.".into(),
            ));
        };
        *run = run.moved(&self.model, states)?;
        Ok(())
    }

    /// Completes an integrator step of model exchange at the present states under these inputs.
    pub fn complete(&mut self, inputs: &Inputs) {
        if let Integrator::ModelExchange(run) = &mut self.run.integrator {
            run.complete();
        }
        self.run.inputs = *inputs;
    }

    /// Parameters of the scene, with the tunable effects' parameters in force.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Constant part of the simulation.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Part of the simulation that changes.
    pub fn run(&self) -> &Run {
        &self.run
    }

    /// Inputs of the last step, or of the start.
    pub fn inputs(&self) -> &Inputs {
        &self.run.inputs
    }

    /// Present state; q̈ and λ belong to the inputs of the last step.
    pub fn state(&self) -> State {
        self.run.state(&self.model, &self.run.inputs)
    }

    /// Present state, with the q̈ and λ that belong to `inputs`. Delayed servo references are the ones that act now.
    pub fn state_for(&self, inputs: &Inputs) -> State {
        match &self.run.commands {
            None => self.run.state(&self.model, inputs),
            Some(commands) => self.run.state(&self.model, &commands.acting(inputs, 0.0)),
        }
    }

    /// Counters of the integrator since the start.
    pub fn counters(&self) -> Counters {
        match &self.run.integrator {
            Integrator::MacroStepped(run) => run.core.counters,
            Integrator::Conserving(run) => run.state.counters,
            Integrator::DenseOutput(_) => self.state().core.counters,
            Integrator::ModelExchange(_) => Counters::default(),
        }
    }

    /// Number of steps for which the conserving method used its last fallback stage.
    pub fn fallbacks(&self) -> u64 {
        if let Integrator::Conserving(run) = &self.run.integrator { run.state.counters.fallbacks } else { 0 }
    }

    /// Number of steps of fixed length that failed their checks.
    pub fn breaches(&self) -> u64 {
        if let Integrator::MacroStepped(run) = &self.run.integrator { run.core.counters.breaches } else { 0 }
    }

    /// Number of singularities met since the start; see [`Counters::singular`].
    pub fn singular(&self) -> [u64; CONFIGURATION_SIGNS + 2] {
        self.counters().singular()
    }

    /// Changes parameters of the active effects from now on; the same effects remain active. The change of potential energy counts as input
    /// work. `payload.join` decides how added mass joins. Refuses values that are outside their bounds or do not fit together, a payload
    /// beyond the range of the linear solve, and a current step that cannot be repeated up to the present time. A refusal changes nothing.
    #[inline(never)]
    pub fn tune(&mut self, parameters: &effects::Parameters) -> Result<(), SceneError> {
        let tuned = Parameters { effects: parameters.clone(), ..self.parameters.clone() };
        check_bounds(&tuned)?;
        self.tune_within_bounds(tuned)
    }

    /// Applies checked parameters; only effects may differ.
    fn tune_within_bounds(&mut self, tuned: Parameters) -> Result<(), SceneError> {
        let mut model = Model::clone(&self.model);
        if model.tune(&self.parameters.effects, &tuned)? {
            self.run
                .tune(&self.model, &model, tuned.effects.payload.join)
                .map_err(|cause| SceneError(format!("the current step could not be repeated up to the present time: {cause}.")))?;
            *self.model = model;
        }
        self.parameters = tuned;
        Ok(())
    }

    /// Whether the loads are too stiff for an explicit method: stability instead of accuracy has limited its steps.
    pub fn is_stiff(&self) -> bool {
        matches!(&self.run.integrator, Integrator::DenseOutput(run) if run.step.is_stiff())
    }

    /// Names of the active effects, e.g. `gravity`.
    pub fn active_effects(&self) -> &[&'static str] {
        &self.model.effect_names
    }
}

/// Refuses set-valued friction in model exchange, because the master does not know which joints stick, and delayed servo references, because
/// its integrator may try times in any order.
fn refuse_in_model_exchange(parameters: &Parameters) -> Result<(), SceneError> {
    let delay = parameters.effects.servo.command_delay();
    if delay > 0.0 {
        return Err(SceneError(format!(
            "servo.delay = {delay:?} s is not allowed in model exchange, whose master may try times in any order: it must be 0, or the unit \
             must be instantiated for co-simulation."
        )));
    }
    let Some(name) = sticking_law(&parameters.effects) else { return Ok(()) };
    Err(SceneError(format!(
        "{name} = stick is not allowed in model exchange, whose master does not know which joints stick: it must be smooth, or the \
         unit must be instantiated for co-simulation."
    )))
}
