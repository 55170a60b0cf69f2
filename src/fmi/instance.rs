//! An instance: parameters, inputs, a simulation once there is one, a clock and a log.
//!
//! Every call either does what it says or changes nothing; the C border asks [`Call::require`](super::Call::require) first
//! and turns a [`CallError`] into a log line and a status.

use super::clock::Clock;
use super::derivatives::check_reach;
use super::messages::{Log, Status};
use super::snapshot::Scene;
use super::values::{check_computed, check_settable, check_value, lookup};
use super::{CallError, Kind, Snapshot, Stage, bindings, computed};
use crate::integrator::MODES;
use crate::observers::{Observation, Observed};
use crate::simulation::{Method, Signal, Simulation, StepFailure};
use crate::variables::{FmiType, Value, Variable, VariableId};

/// An instance of the FMU.
#[derive(Debug)]
pub struct Instance {
    /// What a stored state is a copy of; changed through [`Instance::change`] only.
    pub(super) now: Snapshot,
    /// What has been observed since the last change.
    observation: Option<Observation>,
    /// Before the end of initialisation: the scene made ready with the present values, where an output has been read.
    preview: Option<Box<Scene>>,
    /// Lines for the master.
    pub log: Log,
}

impl Instance {
    /// A fresh instance; `logging_on` as given to fmi2Instantiate.
    pub fn new(kind: Kind, logging_on: bool) -> Self {
        Self { now: Snapshot::fresh(kind), observation: None, preview: None, log: Log::new(logging_on) }
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
                    "ready: method {}, h = {:?} s, adaptive {}, effects: {effects}",
                    bindings::method_name(settings.method),
                    settings.step_size,
                    settings.adaptive,
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
        for &reference in references {
            let variable = lookup(reference, fmi_type)?;
            let value = self.read(variable)?;
            // A sample is told as it was set, whatever the encoder said.
            if let (Value::Real(value), false) = (value, matches!(variable.id, VariableId::RealSample(_))) {
                check_computed(|| variable.name.to_owned(), value)?;
            }
        }
        for (position, &reference) in references.iter().enumerate() {
            take(position, self.read(lookup(reference, fmi_type)?)?);
        }
        Ok(())
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

    /// fmi2DoStep: from `point`, s, by `size`, s. Discarded if the integrator gives up, with everything as before.
    pub fn do_step(&mut self, point: f64, size: f64) -> Result<(), CallError> {
        let wants_events = self.log.wants(Status::Ok);
        let now = self.change();
        let (Some(clock), Scene::Ready(simulation)) = (&mut now.clock, &mut now.scene) else {
            return self.follow(point, size);
        };
        let plan = clock.plan(point, size, simulation.parameters().settings.step_size)?;
        // To look has its price: it is paid only where the log wants the events.
        let before = wants_events.then(|| simulation.singular());
        let last_resorts = simulation.last_resorts();
        let advanced = match (&now.next.parameters, &now.next.signal) {
            (None, None) => {
                let inputs = *simulation.inputs();
                simulation.advance(&inputs, plan.h, plan.steps)
            }
            (None, Some(signal)) => {
                check_reach(signal, size)?;
                simulation.advance_along(signal, plan.h, plan.steps)
            }
            (Some(parameters), signal) => {
                let signal = signal.unwrap_or(Signal::held(*simulation.inputs()));
                check_reach(&signal, size)?;
                // The simulation, not its box: a step allocates nothing.
                let untuned = Simulation::clone(simulation);
                simulation.tune(&parameters.effects)?;
                simulation.advance_along(&signal, plan.h, plan.steps).inspect_err(|_| **simulation = untuned)
            }
        };
        if let Err(failure) = advanced {
            now.stage = Stage::StepFailed;
            return Err(step_discarded(point, size, &failure));
        }
        let last_resorts = simulation.last_resorts() - last_resorts;
        clock.advance(plan);
        now.next.after_step(size);
        now.stage = Stage::StepComplete;
        if last_resorts > 0 {
            warn(&mut self.log, || {
                format!(
                    "between {point:?} s and {:?} s: {last_resorts} steps by the last resort, their equations were not solved: the energy is \
                     kept, the way is not known; see solver.lastResorts and solver.maxWork.",
                    point + size
                )
            });
        }
        self.warn(point + size);
        if let Some(before) = before {
            self.report_passes(before, point, point + size)?;
        }
        Ok(())
    }

    /// fmi2CancelStep: a step is never pending. In a test build with `--cfg forced_panic` a panic, to see what becomes of one.
    pub fn cancel_step(&self) -> Result<(), CallError> {
        if cfg!(forced_panic) {
            panic!("forced by the test build");
        }
        Err(CallError::error("no step is pending: fmi2DoStep never returns fmi2Pending."))
    }

    /// Tells once that servo references are not read, and once that loads are stiff.
    #[inline(always)]
    pub(super) fn warn(&mut self, time: f64) {
        let Some(simulation) = self.now.scene.simulation() else { return };
        if !self.now.warned_of_references && !simulation.model().has_servo && simulation.inputs().has_servo_reference() {
            self.now.warned_of_references = true;
            warn(&mut self.log, || {
                "servo.theta or servo.omega is not 0, but no active effect reads them: servo.enabled is false.".to_owned()
            });
        }
        if !self.now.warned_of_stiffness && simulation.is_stiff() {
            self.now.warned_of_stiffness = true;
            warn(&mut self.log, || {
                format!(
                    "at {time:?} s: steps of method dop853 are limited by its stability: the scene has stiff loads; automatic would do better."
                )
            });
        }
    }

    /// One line for each kind of singularity that a step has passed, and for a start from rest in a vertex.
    #[cold]
    pub(super) fn report_passes(&mut self, before: [u64; MODES + 2], from: f64, to: f64) -> Result<(), CallError> {
        let core = self.observe()?.observation().state().core;
        let counts = core.counters.singular();
        let [launches, passes @ ..]: [u64; MODES + 2] = std::array::from_fn(|i| counts[i].saturating_sub(before[i]));
        for (count, what) in passes.into_iter().zip([
            "constraint singularity (all links in line), straight through",
            "direct singularity (distal links in line)",
            "inverse singularity of the left leg",
            "inverse singularity of the right leg",
        ]) {
            if count > 0 {
                self.log.push(Status::Ok, || format!("passed between {from:?} s and {to:?} s: {what}, {count} times"));
            }
        }
        if launches > 0 {
            self.log.push(Status::Ok, || {
                format!(
                    "between {from:?} s and {to:?} s: started from rest in a constraint singularity on the branch of least constraint, \
                     {} other local minima",
                    core.alternatives
                )
            });
        }
        Ok(())
    }
}

#[cold]
pub(super) fn step_discarded(point: f64, size: f64, failure: &StepFailure) -> CallError {
    let StepFailure { elapsed, cause } = failure;
    CallError::discard(format!(
        "the step from {point:?} s by {size:?} s gave up at {:?} s: {cause}; the state is still that of {point:?} s.",
        point + elapsed
    ))
}

#[cold]
pub(super) fn warn(log: &mut Log, text: impl FnOnce() -> String) {
    log.push(Status::Warning, text);
}
