//! An instance: parameters, inputs, a simulation once there is one, a clock and a log.
//!
//! Every call either does what it says or changes nothing; the C border asks [`Call::require`](super::Call::require) first
//! and turns a [`Rejection`] into a log line and a status.

use super::clock::Clock;
use super::derivatives::check_reach;
use super::messages::{Log, Status};
use super::outputs::{Cache, Outputs};
use super::values::{check_computed, check_settable, check_value, lookup};
use super::{Rejection, Snapshot, Stage, bindings};
use crate::integrator::{self, MODES};
use crate::mechanism::{COORDINATES, MULTIPLIERS};
use crate::simulation::{Inputs, Parameters, Signal, Simulation, StepFailure};
use crate::variables::{Access, Value, Variable};

/// An instance of the FMU.
#[derive(Debug)]
pub struct Instance {
    /// What a stored state is a copy of.
    pub(super) now: Snapshot,
    cache: Cache,
    /// Lines for the master.
    pub log: Log,
}

impl Instance {
    /// A fresh instance; `logging_on` as given to fmi2Instantiate.
    pub fn new(logging_on: bool) -> Self {
        Self { now: Snapshot::fresh(), cache: Cache::default(), log: Log::new(logging_on) }
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
    pub fn set_debug_logging<'a>(&mut self, on: bool, categories: impl Iterator<Item = &'a str>) -> Result<(), Rejection> {
        self.log.choose(on, categories)
    }

    /// fmi2SetupExperiment; `tolerance` and `stop` where they are defined. The tolerance is not used:
    /// `solver.errorTolerance` rules, in units that a relative tolerance does not have.
    pub fn setup_experiment(&mut self, tolerance: Option<f64>, start: f64, stop: Option<f64>) -> Result<(), Rejection> {
        self.now.clock = Some(Clock::new(start, stop)?);
        if let Some(tolerance) = tolerance {
            self.log.push(Status::Warning, || {
                format!("fmi2SetupExperiment: tolerance {tolerance:?} is not used, solver.errorTolerance is.")
            });
        }
        Ok(())
    }

    /// fmi2EnterInitializationMode.
    pub fn enter_initialization_mode(&mut self) -> Result<(), Rejection> {
        if self.now.clock.is_none() {
            return Err(Rejection::error("fmi2SetupExperiment must be called before."));
        }
        self.now.stage = Stage::InitializationMode;
        Ok(())
    }

    /// fmi2ExitInitializationMode: validates the scene and closes the loop, or refuses and stays.
    pub fn exit_initialization_mode(&mut self) -> Result<(), Rejection> {
        let simulation = ready(&mut self.now.simulation, &self.now.parameters, &self.now.signal.value)?;
        let settings = &self.now.parameters.settings;
        self.log.push(Status::Ok, || {
            let effects = simulation.active_effects();
            format!(
                "ready: method {}, h = {:?} s, adaptive {}, effects: {}",
                bindings::method_name(settings.method),
                settings.step_size,
                settings.adaptive,
                if effects.is_empty() { "none".to_owned() } else { effects.join(", ") }
            )
        });
        self.now.tuned = false;
        self.now.stage = Stage::StepComplete;
        Ok(())
    }

    /// What fmi2GetFMUstate makes a copy of.
    pub fn snapshot(&self) -> &Snapshot {
        &self.now
    }

    /// fmi2SetFMUstate: everything as it was, but the log and what the master wants to hear of it.
    pub fn restore(&mut self, snapshot: &Snapshot) {
        self.now.copy(snapshot);
        self.cache = Cache::default();
    }

    /// fmi2Terminate.
    pub fn terminate(&mut self) -> Result<(), Rejection> {
        self.now.stage = Stage::Terminated;
        self.log.push(Status::Ok, || "terminated".to_owned());
        Ok(())
    }

    /// fmi2Reset: as fresh as after fmi2Instantiate. Only the master's choice of log categories stays, which is about
    /// the log and not about the simulation.
    pub fn reset(&mut self) -> Result<(), Rejection> {
        let fresh = Self::new(false);
        let log = std::mem::replace(self, fresh).log;
        self.log = log;
        self.log.push(Status::Ok, || "reset".to_owned());
        Ok(())
    }

    /// fmi2SetReal, fmi2SetInteger, fmi2SetBoolean: nothing is written unless every value is allowed.
    pub fn set(&mut self, pairs: impl Iterator<Item = (u32, Value)> + Clone) -> Result<(), Rejection> {
        for (reference, value) in pairs.clone() {
            let variable = lookup(reference, value.access())?;
            check_settable(variable, self.now.stage)?;
            check_value(variable, value)?;
        }
        for (reference, value) in pairs {
            let variable = lookup(reference, value.access())?;
            if !bindings::write(&mut self.now.parameters, &mut self.now.signal.value, variable, value) {
                unreachable!("{} = {value} has been checked", variable.name);
            }
            self.cache = Cache::default();
            if matches!(self.now.stage, Stage::Instantiated | Stage::InitializationMode) {
                // A scene that was made ready to read an output is made anew with the new values.
                self.now.simulation = None;
            }
            self.now.tuned |= variable.tunable;
        }
        Ok(())
    }

    /// fmi2GetReal, fmi2GetInteger, fmi2GetBoolean: hands each value with its position to `take`; nothing is handed
    /// over unless every reference is right and every value finite.
    pub fn get(&mut self, access: Access, references: &[u32], mut take: impl FnMut(usize, Value)) -> Result<(), Rejection> {
        for &reference in references {
            let variable = lookup(reference, access)?;
            if variable.start.is_none() {
                let outputs = self.outputs()?;
                if access == Access::Real
                    && let Some(Value::Real(value)) = outputs.read(variable)
                {
                    check_computed(|| variable.name.to_owned(), value)?;
                }
            }
        }
        for (position, &reference) in references.iter().enumerate() {
            take(position, self.read(lookup(reference, access)?)?);
        }
        Ok(())
    }

    fn read(&mut self, variable: &Variable) -> Result<Value, Rejection> {
        if let Some(value) = bindings::read(&mut self.now.parameters, &mut self.now.signal.value, variable) {
            return Ok(value);
        }
        Ok(self.outputs()?.read(variable).unwrap_or_else(|| unreachable!("{} is bound", variable.name)))
    }

    /// The outputs at the present communication point, for the present inputs.
    pub(super) fn outputs(&mut self) -> Result<Outputs<'_>, Rejection> {
        let simulation = ready(&mut self.now.simulation, &self.now.parameters, &self.now.signal.value)?;
        Ok(Outputs { simulation, inputs: &self.now.signal.value, cache: &self.cache })
    }

    /// fmi2GetString and fmi2SetString: there are no String variables.
    pub fn no_strings(&self, references: &[u32]) -> Result<(), Rejection> {
        match references {
            [] => Ok(()),
            [first, ..] => Err(Rejection::error(match Variable::find(*first) {
                Some(variable) => format!("{} is of type {}, not String.", variable.name, variable.access()),
                None => format!("value reference {first} belongs to no variable."),
            })),
        }
    }

    /// fmi2DoStep: from `point`, s, by `size`, s. Discarded if the integrator gives up, with everything as before.
    pub fn do_step(&mut self, point: f64, size: f64) -> Result<(), Rejection> {
        let Some(clock) = &mut self.now.clock else { unreachable!("fmi2SetupExperiment has made it") };
        let Some(simulation) = &mut self.now.simulation else { unreachable!("initialisation has made it") };
        let plan = clock.plan(point, size, self.now.parameters.settings.step_size)?;
        if !self.now.signal.is_held() {
            check_reach(&self.now.signal, size)?;
        }
        // To look has its price, and so it is done only for somebody who wants to hear of it.
        let before = self.log.wants(Status::Ok).then(|| simulation.state().core.counters.singular());
        let advanced = if self.now.tuned {
            advance_tuned(simulation, &self.now.parameters, &self.now.signal, plan.h, plan.steps)?
        } else {
            simulation.advance_along(&self.now.signal, plan.h, plan.steps)
        };
        if let Err(failure) = advanced {
            self.now.stage = Stage::StepFailed;
            return Err(gave_up(point, size, &failure));
        }
        clock.advance(plan);
        self.now.signal.end(size);
        self.now.tuned = false;
        if let Some(before) = before {
            report_passes(&mut self.log, before, &simulation.state().core, point, point + size);
        }
        if self.now.signal.value.refers() && !simulation.model().servo && !self.now.warned_of_references {
            self.now.warned_of_references = true;
            warn(&mut self.log, || {
                "servo.theta or servo.omega is not 0, but no active effect reads them: servo.enabled is false.".to_owned()
            });
        }
        if !self.now.warned_of_stiffness && simulation.is_stiff() {
            self.now.warned_of_stiffness = true;
            warn(&mut self.log, || {
                format!(
                    "at {:?} s: steps of method dop853 are limited by its stability: the scene has stiff loads; i3alp would do better.",
                    point + size
                )
            });
        }
        self.cache = Cache::default();
        self.now.stage = Stage::StepComplete;
        Ok(())
    }

    /// fmi2CancelStep: a step is never pending. In a test build with `--cfg forced_panic` a panic, to see what becomes of one.
    pub fn cancel_step(&self) -> Result<(), Rejection> {
        if cfg!(forced_panic) {
            panic!("forced by the test build");
        }
        Err(Rejection::error("no step is pending: fmi2DoStep never returns fmi2Pending."))
    }
}

// What a step does rarely, apart from what it always does.

/// A step for which tunable parameters begin to act; they do not if it fails.
#[cold]
fn advance_tuned(
    simulation: &mut Simulation,
    parameters: &Parameters,
    signal: &Signal,
    h: f64,
    steps: u64,
) -> Result<Result<(), StepFailure>, Rejection> {
    let untuned = simulation.clone();
    simulation.tune(&parameters.effects)?;
    let advanced = simulation.advance_along(signal, h, steps);
    if advanced.is_err() {
        *simulation = untuned;
    }
    Ok(advanced)
}

#[cold]
fn gave_up(point: f64, size: f64, failure: &StepFailure) -> Rejection {
    let StepFailure { elapsed, cause } = failure;
    Rejection::discard(format!(
        "the step from {point:?} s by {size:?} s gave up at {:?} s: {cause}; the state is still that of {point:?} s.",
        point + elapsed
    ))
}

#[cold]
fn warn(log: &mut Log, text: impl FnOnce() -> String) {
    log.push(Status::Warning, text);
}

/// One line for each kind of singularity that a step has passed, and for a start from rest in a vertex.
#[cold]
fn report_passes(log: &mut Log, before: [u64; MODES + 2], after: &integrator::State<COORDINATES, MULTIPLIERS>, from: f64, to: f64) {
    let counts = after.counters.singular();
    let [launches, passes @ ..]: [u64; MODES + 2] = std::array::from_fn(|i| counts[i].saturating_sub(before[i]));
    for (count, what) in passes.into_iter().zip([
        "constraint singularity (all links in line), straight through",
        "direct singularity (distal links in line)",
        "inverse singularity of the left leg",
        "inverse singularity of the right leg",
    ]) {
        if count > 0 {
            log.push(Status::Ok, || format!("passed between {from:?} s and {to:?} s: {what}, {count} times"));
        }
    }
    if launches > 0 {
        log.push(Status::Ok, || {
            format!(
                "between {from:?} s and {to:?} s: started from rest in a constraint singularity on the branch of least constraint, \
                 {} other local minima",
                after.alternatives
            )
        });
    }
}

/// The simulation, made ready with the present values if there is none yet.
fn ready<'a>(
    simulation: &'a mut Option<Box<Simulation>>,
    parameters: &Parameters,
    inputs: &Inputs,
) -> Result<&'a mut Simulation, Rejection> {
    match simulation {
        Some(simulation) => Ok(simulation),
        None => Ok(simulation.insert(Box::new(Simulation::new(parameters, inputs)?))),
    }
}
