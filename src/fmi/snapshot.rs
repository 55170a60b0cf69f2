//! Stored states (FMI 2.0.4, section 2.1.8): the state of an instance without its log. `stored.rs` turns them into bytes.

use borsh::{BorshDeserialize, BorshSerialize};

use super::clock::Clock;
use super::{Guid, Kind, Stage};
use crate::copies::{clone_by_fields, place};
use crate::estimator::Measured;
use crate::mechanism::SceneError;
use crate::simulation::bindings::{self, Field};
use crate::simulation::{Following, Inputs, Parameters, Signal, Simulation};
use crate::variables::{Value, Variable, VariableId};

/// State of an instance without its log.
#[derive(Debug)]
pub struct Snapshot {
    pub(super) kind: Kind,
    /// GUID of the unit that the instance belongs to.
    pub(super) guid: Guid,
    pub(super) stage: Stage,
    /// Clock, after fmi2SetupExperiment.
    pub(super) clock: Option<Clock>,
    /// Parameters as the master has set them.
    pub(super) parameters: Parameters,
    /// Whether a tunable parameter has been set that takes effect only with the next step or event.
    pub(super) is_tuned: bool,
    /// Inputs from the present communication point on.
    pub(super) signal: Signal,
    /// Last samples of the encoders.
    pub(super) measured: Measured,
    /// Scene, once it has been initialised.
    pub(super) scene: Option<Scene>,
    pub(super) warned: Warned,
}

clone_by_fields!(Snapshot { kind, guid, stage, clock, parameters, is_tuned, signal, measured, scene, warned });

/// Warnings that the master has received; each comes once.
#[derive(Clone, Copy, Debug, Default, BorshSerialize, BorshDeserialize)]
pub(super) struct Warned {
    /// No active effect reads the servo references.
    pub(super) references: bool,
    /// The loads are stiff.
    pub(super) stiffness: bool,
    /// Steps of fixed length failed their checks.
    pub(super) breaches: bool,
}

/// An initialised scene, with the parameters and inputs in force.
#[derive(Debug)]
pub(super) enum Scene {
    /// Simulation without an estimator.
    Ready(Box<Simulation>),
    /// Simulation with an estimator.
    Following(Box<Following>),
}

impl Clone for Scene {
    fn clone(&self) -> Self {
        match self {
            Self::Ready(simulation) => Self::Ready(simulation.clone()),
            Self::Following(following) => Self::Following(following.clone()),
        }
    }

    /// Allocates nothing if both are of the same kind.
    fn clone_from(&mut self, other: &Self) {
        match (self, other) {
            (Self::Ready(own), Self::Ready(other)) => own.clone_from(other),
            (Self::Following(own), Self::Following(other)) => own.clone_from(other),
            (own, other) => *own = other.clone(),
        }
    }
}

impl Scene {
    /// Validates the parameters and initialises the simulation. Refuses an estimator in model exchange, and parameters that do not make a
    /// scene.
    pub(super) fn initialise(kind: Kind, parameters: &Parameters, inputs: &Inputs) -> Result<Self, SceneError> {
        match (kind, parameters.estimator.enabled) {
            (Kind::CoSimulation, false) => boxed(|| Simulation::new(parameters, inputs)).map(Self::Ready),
            (Kind::CoSimulation, true) => boxed(|| Following::new(parameters, inputs)).map(Self::Following),
            (Kind::ModelExchange, false) => boxed(|| Simulation::for_model_exchange(parameters, inputs)).map(Self::Ready),
            (Kind::ModelExchange, true) => Err(SceneError(
                "estimator.enabled = true is not allowed in model exchange, whose states are the master's: it must be false, or the unit \
                 must be instantiated for co-simulation."
                    .to_owned(),
            )),
        }
    }

    /// Simulation of the scene.
    pub(super) fn simulation(&self) -> &Simulation {
        match self {
            Self::Ready(simulation) => simulation,
            Self::Following(following) => following.simulation(),
        }
    }

    /// Parameters in force, as the master has set them.
    pub(super) fn parameters(&self) -> &Parameters {
        match self {
            Self::Ready(simulation) => simulation.parameters(),
            Self::Following(following) => following.parameters(),
        }
    }

    /// The scene with its estimator, if a machine is tracked.
    pub(super) fn following(&self) -> Option<&Following> {
        if let Self::Following(following) = self { Some(following) } else { None }
    }
}

/// Makes a large value for the heap. Not inlined: the stack has room for the value while it is made, but not for a second one.
#[inline(never)]
pub(super) fn boxed<T>(make: impl FnOnce() -> Result<T, SceneError>) -> Result<Box<T>, SceneError> {
    let place = place();
    Ok(Box::write(place, make()?))
}

impl Snapshot {
    /// State of an instance at the start values of the XML, after fmi2Instantiate.
    pub(super) fn fresh(kind: Kind, guid: Guid) -> Self {
        Self {
            kind,
            guid,
            stage: Stage::Instantiated,
            clock: None,
            parameters: bindings::default_parameters(),
            is_tuned: false,
            signal: Signal::held(bindings::default_inputs()),
            measured: Measured::default(),
            scene: None,
            warned: Warned::default(),
        }
    }

    /// Whether the next step may fail after it has changed the scene. Only then is a copy kept for rollback.
    pub(super) fn may_fail_midway(&self) -> bool {
        self.is_tuned || matches!(self.scene, Some(Scene::Following(_)))
    }

    /// The present value of a parameter, input or sample; `None` for a computed variable.
    pub(super) fn read(&self, variable: &Variable) -> Option<Value> {
        match variable.id {
            VariableId::Parameter(id) => Some(bindings::parameter(&self.parameters, id).value()),
            VariableId::Input(id) => Some(bindings::input(&self.signal.value, id).value()),
            VariableId::Sample(id) => Some(bindings::sample(&self.measured, id).value()),
            VariableId::RealComputed(_) | VariableId::IntegerComputed(_) | VariableId::EnumerationComputed(_) => None,
        }
    }

    /// Sets a parameter, input or sample to a value that has been checked.
    pub(super) fn set(&mut self, variable: &Variable, value: Value) {
        let written = match variable.id {
            VariableId::Parameter(id) => {
                self.is_tuned = self.scene.is_some();
                bindings::parameter_mut(&mut self.parameters, id).set(value)
            }
            VariableId::Input(id) => bindings::input_mut(&mut self.signal.value, id).set(value),
            VariableId::Sample(id) => bindings::sample_mut(&mut self.measured, id).set(value),
            VariableId::RealComputed(_) | VariableId::IntegerComputed(_) | VariableId::EnumerationComputed(_) => false,
        };
        if !written {
            unreachable!("{} = {value} has been checked", variable.name);
        }
    }
}
