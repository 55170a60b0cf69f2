//! An instance: parameters, inputs, a simulation once there is one, a clock and a log.
//!
//! Every call either does what it says or changes nothing; the C border asks [`Call::require`](super::Call::require) first
//! and turns a [`CallError`] into a log line and a status.

use super::clock::Clock;
use super::messages::{Log, Status};
use super::snapshot::Scene;
use super::values::{check_computed, check_settable, check_value, lookup};
use super::{CallError, Kind, Snapshot, Stage, bindings, computed};
use crate::observers::{Observation, Observed};
use crate::simulation::Method;
use crate::variables::{FmiType, VARIABLES, Value, Variable, VariableId};

/// An instance of the FMU.
#[derive(Debug)]
pub struct Instance {
    /// What a stored state is a copy of; changed through [`Instance::change`] only.
    pub(super) now: Snapshot,
    /// What has been observed since the last change.
    observation: Option<Observation>,
    /// Before the end of initialisation: the scene made ready with the present values, where an output has been read.
    preview: Option<Box<Scene>>,
    /// What a call has read so far: values are handed over together. Kept for its room, which is there from the
    /// beginning: calls allocate nothing, unless they ask for more values than there are variables.
    read: Vec<Value>,
    /// Lines for the master.
    pub log: Log,
}

impl Instance {
    /// A fresh instance; `logging_on` as given to fmi2Instantiate.
    pub fn new(kind: Kind, logging_on: bool) -> Self {
        Self {
            now: Snapshot::fresh(kind),
            observation: None,
            preview: None,
            read: Vec::with_capacity(VARIABLES.len()),
            log: Log::new(logging_on),
        }
    }

    /// What is about to change: whatever has been observed of it does not hold any more.
    #[inline(always)]
    pub(super) fn change(&mut self) -> &mut Snapshot {
        self.observation = None;
        self.preview = None;
        &mut self.now
    }

    /// What the instance is for.
    pub fn kind(&self) -> Kind {
        self.now.kind
    }

    /// Where the instance is in its life.
    pub fn stage(&self) -> Stage {
        self.now.stage
    }

    /// The master's clock, after fmi2SetupExperiment.
    pub fn clock(&self) -> Option<&Clock> {
        self.now.clock.as_ref()
    }

    /// fmi2SetDebugLogging.
    pub fn set_debug_logging<'a>(&mut self, on: bool, categories: impl Iterator<Item = &'a str>) -> Result<(), CallError> {
        self.log.choose(on, categories)
    }

    /// fmi2SetupExperiment; `tolerance` and `stop` where they are defined. The tolerance is not used:
    /// `solver.errorTolerance` rules, in units that a relative tolerance does not have.
    pub fn setup_experiment(&mut self, tolerance: Option<f64>, start: f64, stop: Option<f64>) -> Result<(), CallError> {
        let clock = Clock::new(start, stop)?;
        self.change().clock = Some(clock);
        if let Some(tolerance) = tolerance {
            self.log.push(Status::Ok, || {
                format!("fmi2SetupExperiment: tolerance {tolerance:?} is not used, solver.errorTolerance is.")
            });
        }
        Ok(())
    }

    /// fmi2EnterInitializationMode.
    pub fn enter_initialization_mode(&mut self) -> Result<(), CallError> {
        if self.now.clock.is_none() {
            return Err(CallError::error("fmi2SetupExperiment must be called before."));
        }
        self.change().stage = Stage::InitializationMode;
        Ok(())
    }

    /// fmi2ExitInitializationMode: validates the scene and closes the loop, or refuses and stays.
    pub fn exit_initialization_mode(&mut self) -> Result<(), CallError> {
        self.observe()?;
        let Some(scene) = self.preview.take() else { unreachable!("an observation before the run makes it") };
        let Some(simulation) = scene.simulation() else { unreachable!("it has been made ready") };
        let settings = &simulation.parameters().settings;
        let kind = self.now.kind;
        self.log.push(Status::Ok, || {
            let effects = simulation.active_effects();
            let effects = if effects.is_empty() { "none".to_owned() } else { effects.join(", ") };
            match kind {
                Kind::ModelExchange => format!("ready: {kind}, effects: {effects}"),
                Kind::CoSimulation => format!(
                    "ready: method {}, h = {:?} s, {}, effects: {effects}",
                    bindings::method_name(settings.method),
                    settings.step_size,
                    match settings.method {
                        Method::I3alpConserving => "strictly fixed".to_owned(),
                        _ => format!("adaptive {}", settings.adaptive),
                    },
                ),
            }
        });
        if kind == Kind::CoSimulation && settings.adaptive && settings.method == Method::I3alpConserving {
            self.log
                .push(Status::Ok, || "solver.adaptive is not used: the steps of i3alpConserving are strictly fixed.".to_owned());
        }
        let now = self.change();
        now.next.take_held_inputs();
        now.scene = *scene;
        now.stage = match kind {
            Kind::ModelExchange => Stage::EventMode,
            Kind::CoSimulation => Stage::StepComplete,
        };
        Ok(())
    }

    /// What fmi2GetFMUstate makes a copy of.
    pub fn snapshot(&self) -> &Snapshot {
        &self.now
    }

    /// fmi2SetFMUstate: everything as it was, but the log and what the master wants to hear of it.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<(), CallError> {
        let (own, other) = (self.now.kind, snapshot.kind);
        if own != other {
            return Err(CallError::error(format!("FMUstate is that of an instance for {other}, this one is for {own}.")));
        }
        self.change().copy(snapshot);
        Ok(())
    }

    /// fmi2Terminate.
    pub fn terminate(&mut self) -> Result<(), CallError> {
        self.change().stage = Stage::Terminated;
        self.log.push(Status::Ok, || "terminated".to_owned());
        Ok(())
    }

    /// fmi2Reset: as fresh as after fmi2Instantiate. Only the master's choice of log categories stays, which is about
    /// the log and not about the simulation.
    pub fn reset(&mut self) -> Result<(), CallError> {
        let fresh = Self::new(self.now.kind, false);
        let log = std::mem::replace(self, fresh).log;
        self.log = log;
        self.log.push(Status::Ok, || "reset".to_owned());
        Ok(())
    }

    /// fmi2SetReal, fmi2SetInteger, fmi2SetBoolean: nothing is written unless every value is allowed.
    pub fn set(&mut self, pairs: impl Iterator<Item = (u32, Value)> + Clone) -> Result<(), CallError> {
        for (reference, value) in pairs.clone() {
            let variable = lookup(reference, value.fmi_type())?;
            check_settable(variable, self.now.stage)?;
            check_value(variable, value)?;
        }
        if self.now.kind == Kind::ModelExchange {
            self.set_states(&mut pairs.clone())?;
        }
        let now = self.change();
        for (reference, value) in pairs {
            let variable = lookup(reference, value.fmi_type())?;
            if variable.start.is_some() {
                now.set(variable, value);
            }
        }
        Ok(())
    }

    /// fmi2GetReal, fmi2GetInteger, fmi2GetBoolean: hands each value with its position to `take`; nothing is handed
    /// over unless every reference is right and every value that is computed finite.
    pub fn get(&mut self, fmi_type: FmiType, references: &[u32], mut take: impl FnMut(usize, Value)) -> Result<(), CallError> {
        let mut values = std::mem::take(&mut self.read);
        values.clear();
        let complete = references.iter().try_for_each(|&reference| {
            values.push(self.read_checked(lookup(reference, fmi_type)?)?);
            Ok(())
        });
        if complete.is_ok() {
            values.iter().enumerate().for_each(|(position, value)| take(position, *value));
        }
        self.read = values;
        complete
    }

    /// A value, unless it is computed and not finite.
    fn read_checked(&mut self, variable: &Variable) -> Result<Value, CallError> {
        let value = self.read(variable)?;
        // A sample is told as it was set, whatever the encoder said.
        if let (Value::Real(value), false) = (value, matches!(variable.id, VariableId::RealSample(_))) {
            check_computed(|| variable.name.to_owned(), value)?;
        }
        Ok(value)
    }

    fn read(&mut self, variable: &Variable) -> Result<Value, CallError> {
        if let Some(value) = self.now.read(variable) {
            return Ok(value);
        }
        Ok(computed::read(&self.observe()?, variable).unwrap_or_else(|| unreachable!("{} is bound", variable.name)))
    }

    /// What is to be seen at the present communication point, with the accelerations and multipliers that belong to the present inputs,
    /// which the master may have changed since the last step.
    pub(super) fn observe(&mut self) -> Result<Observed<'_, f64>, CallError> {
        let Self { now, observation, preview, .. } = self;
        let scene = match (&now.scene, preview) {
            (Scene::Draft(_), Some(scene)) => &**scene,
            (Scene::Draft(parameters), none) => none.insert(Box::new(Scene::made_ready(now.kind, parameters, &now.inputs())?)),
            (ready, _) => ready,
        };
        match scene {
            Scene::Ready(simulation) => {
                let model = simulation.model();
                let observation = observation.get_or_insert_with(|| Observation::new(model, simulation.state_for(&now.inputs())));
                Ok(Observed::new(model, observation))
            }
            Scene::Following(following) => {
                let model = following.simulation().model();
                let observation = observation.get_or_insert_with(|| Observation::new(model, following.state_for(&now.inputs())));
                Ok(Observed::new(model, observation).of_estimate(following))
            }
            Scene::Draft(_) => unreachable!("a preview is made ready"),
        }
    }

    /// fmi2GetString and fmi2SetString: there are no String variables.
    pub fn no_strings(&self, references: &[u32]) -> Result<(), CallError> {
        match references {
            [] => Ok(()),
            [first, ..] => Err(CallError::error(match Variable::find(*first) {
                Some(variable) => format!("{} is of type {}, not String.", variable.name, variable.type_name()),
                None => format!("value reference {first} belongs to no variable."),
            })),
        }
    }
}
