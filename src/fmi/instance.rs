//! An instance: parameters, inputs, a clock, a log and, after initialisation, a simulation.
//!
//! A call takes effect completely or leaves the instance unchanged. The C interface asks [`Call::require`](super::Call::require) first and
//! turns a [`CallError`] into a log line and a status.

use super::clock::Clock;
use super::messages::{Log, Status};
use super::own::Unit;
use super::snapshot::Scene;
use super::values::{check_computed, check_finite, check_settable, check_value, find, lookup};
use super::{CallError, Kind, Snapshot, Stage, computed, following};
use crate::observers::{Observation, Observed};
use crate::variables::{FmiType, VARIABLES, Value, Variable};

/// An instance of the FMU.
#[derive(Debug)]
pub struct Instance {
    /// State of the instance without its log. Changes go through [`Instance::change`], which drops cached observations.
    pub(super) now: Snapshot,
    /// Unit that the instance belongs to.
    unit: Unit,
    /// Observations cached since the last change.
    observation: Option<Observation>,
    /// Scene initialised with the present values, made when an output is read before the end of initialisation.
    preview: Option<Scene>,
    /// Scene before the last step that could fail midway, for rollback.
    pub(super) before: Option<Scene>,
    /// Values read by the present call. The buffer is allocated once; only a call that reads more values than there are variables allocates
    /// again.
    values: Vec<Value>,
    /// Lines for the master's logger.
    pub log: Log,
}

impl Instance {
    /// A new instance of the plain unit; `logging_on` as passed to fmi2Instantiate.
    pub fn new(kind: Kind, logging_on: bool) -> Self {
        let unit = Unit::plain();
        Self {
            now: Snapshot::fresh(kind, unit.guid),
            unit,
            observation: None,
            preview: None,
            before: None,
            values: Vec::with_capacity(VARIABLES.len()),
            log: Log::new(logging_on),
        }
    }

    /// Makes a new instance belong to another unit: sets its start values.
    pub fn belong_to(&mut self, unit: Unit) {
        self.now.guid = unit.guid;
        for (variable, value) in &unit.starts {
            self.now.set(variable, *value);
        }
        self.unit = unit;
    }

    /// Mutable access to the state; drops cached observations and the preview.
    #[inline(always)]
    pub(super) fn change(&mut self) -> &mut Snapshot {
        self.observation = None;
        self.preview = None;
        &mut self.now
    }

    /// Kind of the instance: co-simulation or model exchange.
    pub fn kind(&self) -> Kind {
        self.now.kind
    }

    /// State of the life cycle.
    pub fn stage(&self) -> Stage {
        self.now.stage
    }

    /// The master's clock, after fmi2SetupExperiment.
    pub fn clock(&self) -> Option<&Clock> {
        self.now.clock.as_ref()
    }

    /// fmi2SetupExperiment; `tolerance` and `stop`, s, if they are defined. The tolerance is not used: it is relative, and
    /// `solver.errorTolerance` has units. Refuses numbers that are not finite, a negative tolerance and a stop before the start.
    pub fn setup_experiment(&mut self, tolerance: Option<f64>, start: f64, stop: Option<f64>) -> Result<(), CallError> {
        let clock = Clock::new(start, stop)?;
        if let Some(tolerance) = tolerance {
            check_finite(tolerance, || format!("tolerance is {tolerance}"))?;
            // Masters that have no tolerance pass 0.
            if tolerance < 0.0 {
                return Err(CallError::error(format!("tolerance is {tolerance}, must not be negative.")));
            }
            self.log.push(Status::Ok, || {
                format!("fmi2SetupExperiment: tolerance {tolerance:?} is not used; solver.errorTolerance sets the accuracy.")
            });
        }
        self.change().clock = Some(clock);
        Ok(())
    }

    /// fmi2EnterInitializationMode: refused before fmi2SetupExperiment.
    pub fn enter_initialization_mode(&mut self) -> Result<(), CallError> {
        if self.now.clock.is_none() {
            return Err(CallError::error("fmi2SetupExperiment must be called before."));
        }
        self.change().stage = Stage::InitializationMode;
        Ok(())
    }

    /// fmi2ExitInitializationMode: validates the scene and closes the loop. If it refuses, the instance stays in initialisation mode.
    pub fn exit_initialization_mode(&mut self) -> Result<(), CallError> {
        self.observe()?;
        let Some(scene) = self.preview.take() else { unreachable!("an observation before the run makes it") };
        let simulation = scene.simulation();
        let settings = &simulation.parameters().settings;
        let kind = self.now.kind;
        self.log.push(Status::Ok, || {
            let effects = simulation.active_effects();
            let effects = if effects.is_empty() { "none".to_owned() } else { effects.join(", ") };
            match kind {
                Kind::ModelExchange => format!("ready: {kind}, effects: {effects}"),
                Kind::CoSimulation => format!(
                    "ready: method {}, h = {:?} s, {}, effects: {effects}",
                    settings.method.name(),
                    settings.step_size,
                    if settings.method.uses_adaptive() {
                        format!("adaptive {}", settings.adaptive)
                    } else {
                        "solver.adaptive is not used".to_owned()
                    },
                ),
            }
        });
        if let Some(text) = scene.following().and_then(following::unlearned_lengths) {
            self.log.push(Status::Warning, || text);
        }
        let now = self.change();
        now.scene = Some(scene);
        now.stage = match kind {
            Kind::ModelExchange => Stage::EventMode,
            Kind::CoSimulation => Stage::StepComplete,
        };
        self.prepare_to_go_back();
        Ok(())
    }

    /// The state that fmi2GetFMUstate copies.
    pub fn snapshot(&self) -> &Snapshot {
        &self.now
    }

    /// fmi2SetFMUstate: restores everything except the log and the master's choice of log categories. Refuses a state of another kind or
    /// unit.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<(), CallError> {
        let (own, other) = (self.now.kind, snapshot.kind);
        if own != other {
            return Err(CallError::error(format!("FMUstate belongs to an instance for {other}, this one is for {own}.")));
        }
        if self.now.guid != snapshot.guid {
            let [own, other] = [&self.now.guid, &snapshot.guid].map(|guid| String::from_utf8_lossy(guid));
            return Err(CallError::error(format!("FMUstate belongs to another unit, with the GUID {other}; this unit has {own}.")));
        }
        self.change().clone_from(snapshot);
        self.prepare_to_go_back();
        Ok(())
    }

    /// Allocates the rollback copy, so that neither steps that may fail midway nor calls that tune parameters allocate it.
    fn prepare_to_go_back(&mut self) {
        let [before, now] = [&self.before, &self.now.scene].map(|scene| scene.as_ref().map(std::mem::discriminant));
        // An estimator and delayed commands have parts of their own that depend on the scene.
        let has_parts = self.now.scene.as_ref().is_some_and(|scene| scene.simulation().run().has_commands());
        if before != now || has_parts || self.now.may_fail_midway() {
            self.before.clone_from(&self.now.scene);
        }
    }

    /// fmi2DeSerializeFMUstate: decodes a state; refuses bytes that are not a state of this unit.
    pub fn deserialize(&self, bytes: &[u8]) -> Result<Snapshot, CallError> {
        Snapshot::from_bytes(&self.now.guid, bytes)
    }

    /// fmi2Terminate.
    pub fn terminate(&mut self) {
        self.change().stage = Stage::Terminated;
        self.log.push(Status::Ok, || "terminated".to_owned());
    }

    /// fmi2Reset: the state after fmi2Instantiate. Only the master's choice of log categories remains.
    pub fn reset(&mut self) {
        let fresh = Self::new(self.now.kind, false);
        let Self { unit, log, .. } = std::mem::replace(self, fresh);
        self.belong_to(unit);
        self.log = log;
        self.log.push(Status::Ok, || "reset".to_owned());
    }

    /// fmi2SetReal, fmi2SetInteger, fmi2SetBoolean: set all values, or none. Refused unless every variable exists, has this type, may be
    /// set now and allows its value.
    pub fn set(&mut self, pairs: impl Iterator<Item = (u32, Value)> + Clone) -> Result<(), CallError> {
        let mut states = None;
        for (reference, value) in pairs.clone() {
            let variable = lookup(reference, value.fmi_type())?;
            check_settable(variable, self.now.stage)?;
            check_value(variable, value)?;
            // Beyond the standard, fmi2SetReal sets continuous states.
            if variable.start.is_none()
                && let (Some(place), Value::Real(value)) = (variable.state(), value)
            {
                states.get_or_insert(self.continuous_states()?)[place] = value;
            }
        }
        if let Some(states) = states {
            self.set_continuous_states(&states)?;
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

    /// fmi2GetReal, fmi2GetInteger, fmi2GetBoolean: refused unless every reference belongs to a variable of this type and every computed
    /// value is finite.
    pub fn get(&mut self, fmi_type: FmiType, references: &[u32]) -> Result<&[Value], CallError> {
        let mut values = std::mem::take(&mut self.values);
        values.clear();
        let complete = references.iter().try_for_each(|&reference| {
            values.push(self.read(lookup(reference, fmi_type)?)?);
            Ok(())
        });
        self.values = values;
        complete.map(|()| self.values.as_slice())
    }

    /// Value of a variable; refuses a computed value that is not finite. Parameters, inputs and samples are returned as the master set
    /// them.
    fn read(&mut self, variable: &Variable) -> Result<Value, CallError> {
        if let Some(value) = self.now.read(variable) {
            return Ok(value);
        }
        let Some(value) = computed::read(&self.observe()?, variable) else { unreachable!("{} is bound", variable.name) };
        if let Value::Real(value) = value {
            check_computed(|| variable.name.to_owned(), value)?;
        }
        Ok(value)
    }

    /// Observation at the present communication point. Accelerations and multipliers belong to the present inputs, which the master may
    /// have changed since the last step. Before the run it is refused unless the scene can be initialised.
    pub(super) fn observe(&mut self) -> Result<Observed<'_, f64>, CallError> {
        let Self { now, observation, preview, .. } = self;
        let scene = match (&now.scene, preview) {
            (Some(scene), _) => scene,
            (None, Some(scene)) => scene,
            (None, none) => none.insert(Scene::initialise(now.kind, &now.parameters, &now.signal.value)?),
        };
        let simulation = scene.simulation();
        let (model, following) = (simulation.model(), scene.following());
        let observation = observation.get_or_insert_with(|| {
            let inputs = &now.signal.value;
            let state = following.map_or_else(|| simulation.state_for(inputs), |following| following.state_for(inputs));
            Observation::new(model, state, inputs)
        });
        Ok(Observed::new(model, observation).with_estimates(following))
    }

    /// fmi2GetString and fmi2SetString: there are no String variables.
    pub fn no_strings(&self, references: &[u32]) -> Result<(), CallError> {
        let Some(first) = references.first() else { return Ok(()) };
        let variable = find(*first)?;
        Err(CallError::error(format!("{} is of type {}, not String.", variable.name, variable.type_name())))
    }
}
