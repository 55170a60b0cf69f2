//! Stored states (FMI 2.0.4, section 2.1.8): the state of an instance without its log. `stored.rs` turns them into bytes.

use super::bindings::{self, Field};
use super::clock::Clock;
use super::{Guid, Kind, Stage};
use crate::estimator::Measured;
use crate::mechanism::SceneError;
use crate::simulation::{Following, Inputs, Parameters, Signal, Simulation};
use crate::variables::{Value, Variable, VariableId};

/// State of an instance without its log.
#[derive(Clone, Debug)]
pub struct Snapshot {
    pub(super) kind: Kind,
    /// GUID of the unit that the instance belongs to.
    pub(super) guid: Guid,
    pub(super) stage: Stage,
    /// Clock, once fmi2SetupExperiment has been called.
    pub(super) clock: Option<Clock>,
    pub(super) scene: Scene,
    pub(super) next: Next,
    /// Last samples of the encoders.
    pub(super) measured: Measured,
    /// Whether the master has been told that no active effect reads the servo references.
    pub(super) warned_of_references: bool,
    /// Whether the master has been told that the loads are stiff.
    pub(super) warned_of_stiffness: bool,
}

/// The scene before and after the end of initialisation.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "to set a parameter allocates nothing")]
pub(super) enum Scene {
    /// Parameters before the end of initialisation.
    Draft(Parameters),
    /// Simulation with its parameters and inputs in force.
    Ready(Box<Simulation>),
    /// Simulation with an estimator.
    Following(Box<Following>),
}

impl Scene {
    /// Validates the parameters and initialises the simulation, or refuses.
    pub(super) fn initialise(kind: Kind, parameters: &Parameters, inputs: &Inputs) -> Result<Self, SceneError> {
        match (kind, parameters.estimator.enabled) {
            (Kind::CoSimulation, false) => Ok(Self::Ready(Box::new(Simulation::new(parameters, inputs)?))),
            (Kind::CoSimulation, true) => Ok(Self::Following(Box::new(Following::new(parameters, inputs)?))),
            (Kind::ModelExchange, false) => Ok(Self::Ready(Box::new(Simulation::for_model_exchange(parameters, inputs)?))),
            (Kind::ModelExchange, true) => Err(SceneError(
                "estimator.enabled = true is not allowed in model exchange, whose states are the master's: it must be false, or the unit \
                 instantiated for co-simulation."
                    .to_owned(),
            )),
        }
    }

    /// Simulation of the scene, after the end of initialisation.
    pub(super) fn simulation(&self) -> Option<&Simulation> {
        match self {
            Self::Draft(_) => None,
            Self::Ready(simulation) => Some(simulation),
            Self::Following(following) => Some(following.simulation()),
        }
    }

    /// Parameters of the draft, or those in force.
    pub(super) fn parameters(&self) -> &Parameters {
        match self {
            Self::Draft(parameters) => parameters,
            Self::Ready(simulation) => simulation.parameters(),
            Self::Following(following) => following.parameters(),
        }
    }

    /// The scene with its estimator, where a machine is followed.
    pub(super) fn following(&self) -> Option<&Following> {
        if let Self::Following(following) = self { Some(following) } else { None }
    }
}

/// Inputs and parameters that the master has set and that act from the present communication point on.
#[derive(Clone, Debug, Default)]
pub(super) struct Next {
    /// Input signal, where it differs from the held inputs.
    pub(super) signal: Option<Signal>,
    /// Parameters, where a tunable one has been set.
    pub(super) parameters: Option<Parameters>,
}

impl Next {
    /// Ends a communication step of `size` seconds: parameters are in force, and inputs with derivatives keep their values at its
    /// end.
    #[inline(always)]
    pub(super) fn after_step(&mut self, size: f64) {
        self.parameters = None;
        if self.signal.is_some() {
            self.drop_held_signal();
            if let Some(signal) = &mut self.signal {
                signal.end(size);
            }
        }
    }

    /// Drops a signal without derivatives, whose values the simulation holds.
    pub(super) fn drop_held_signal(&mut self) {
        self.signal.take_if(|signal| signal.is_held());
    }
}

impl Snapshot {
    /// State of an instance at the start values of the XML, after fmi2Instantiate.
    pub(super) fn fresh(kind: Kind, guid: Guid) -> Self {
        Self {
            kind,
            guid,
            stage: Stage::Instantiated,
            clock: None,
            scene: Scene::Draft(bindings::default_parameters()),
            next: Next::default(),
            measured: Measured::default(),
            warned_of_references: false,
            warned_of_stiffness: false,
        }
    }

    /// Copies `other`. Allocates nothing where both hold a simulation.
    pub fn copy(&mut self, other: &Self) {
        let Self { kind, guid, stage, clock, scene, next, measured, warned_of_references, warned_of_stiffness } = other;
        self.kind = *kind;
        self.guid = *guid;
        self.stage = *stage;
        self.clock.clone_from(clock);
        match (&mut self.scene, scene) {
            (Scene::Ready(own), Scene::Ready(other)) => own.clone_from(other),
            (Scene::Following(own), Scene::Following(other)) => own.clone_from(other),
            (own, other) => *own = other.clone(),
        }
        self.next.clone_from(next);
        self.measured = *measured;
        self.warned_of_references = *warned_of_references;
        self.warned_of_stiffness = *warned_of_stiffness;
    }

    /// Input signal from the present communication point on.
    pub(super) fn signal(&self) -> Signal {
        self.next.signal.unwrap_or_else(|| Signal::held(self.inputs()))
    }

    /// Values of the inputs at the present communication point.
    pub(super) fn inputs(&self) -> Inputs {
        match (&self.next.signal, &self.scene) {
            (Some(signal), _) => signal.value,
            (None, Scene::Draft(_)) => bindings::default_inputs(),
            (None, Scene::Ready(simulation)) => *simulation.inputs(),
            (None, Scene::Following(following)) => *following.inputs(),
        }
    }

    /// Parameters as the master has set them.
    fn parameters(&self) -> &Parameters {
        self.next.parameters.as_ref().unwrap_or_else(|| self.scene.parameters())
    }

    /// Parameters for the master to set: the draft's, or those that act from the next step on.
    fn parameters_mut(&mut self) -> &mut Parameters {
        match &mut self.scene {
            Scene::Draft(parameters) => parameters,
            ready => self.next.parameters.get_or_insert_with(|| ready.parameters().clone()),
        }
    }

    /// The present value of a parameter or input; `None` for an output.
    pub(super) fn read(&self, variable: &Variable) -> Option<Value> {
        match variable.id {
            VariableId::Parameter(id) => Some(bindings::parameter(self.parameters(), id).value()),
            VariableId::Input(id) => Some(bindings::input(&self.inputs(), id).value()),
            VariableId::Sample(id) => Some(bindings::sample(&self.measured, id).value()),
            VariableId::RealComputed(_) | VariableId::IntegerComputed(_) | VariableId::EnumerationComputed(_) => None,
        }
    }

    /// Sets a parameter or input to a value that has been checked.
    pub(super) fn set(&mut self, variable: &Variable, value: Value) {
        let written = match variable.id {
            VariableId::Parameter(id) => bindings::parameter_mut(self.parameters_mut(), id).set(value),
            VariableId::Input(id) => {
                let held = self.inputs();
                bindings::input_mut(&mut self.next.signal.get_or_insert_with(|| Signal::held(held)).value, id).set(value)
            }
            VariableId::Sample(id) => bindings::sample_mut(&mut self.measured, id).set(value),
            VariableId::RealComputed(_) | VariableId::IntegerComputed(_) | VariableId::EnumerationComputed(_) => false,
        };
        if !written {
            unreachable!("{} = {value} has been checked", variable.name);
        }
    }
}
