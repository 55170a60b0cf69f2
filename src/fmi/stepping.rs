//! A communication step and its log lines.

use super::clock::Plan;
use super::derivatives::check_reach;
use super::messages::Status;
use super::snapshot::{Next, Scene};
use super::{CallError, Instance, Snapshot, Stage};
use crate::estimator::Measured;
use crate::integrator::CONFIGURATION_SIGNS;
use crate::mechanism::SceneError;
use crate::simulation::{Inputs, Parameters, Signal, Simulation, StepFailure};

/// A communication step on its way.
#[derive(Clone, Copy)]
pub(super) struct Step {
    /// Beginning, s.
    pub(super) point: f64,
    /// Length, s.
    pub(super) size: f64,
    /// Its macro steps.
    pub(super) plan: Plan,
}

impl Step {
    /// The refusal of a step that the integrator could not take.
    #[cold]
    pub(super) fn discarded(&self, StepFailure { elapsed, cause }: &StepFailure) -> CallError {
        let Self { point, size, .. } = self;
        CallError::discard(format!(
            "the step from {point:?} s by {size:?} s failed at {:?} s: {cause}; the state is still that of {point:?} s.",
            point + elapsed
        ))
    }

    /// The warning about steps by the last fallback stage.
    #[cold]
    pub(super) fn fallback_message(&self, fallbacks: u64) -> String {
        let many = if fallbacks == 1 { "step" } else { "steps" };
        format!(
            "between {:?} s and {:?} s: {fallbacks} {many} used the last fallback stage, since the equations were not solved: energy is \
             conserved, the trajectory is not resolved; see solver.lastResorts and solver.maxWork.",
            self.point,
            self.point + self.size
        )
    }
}

impl Instance {
    /// fmi2DoStep from `point`, s, by `size`, s. If the integrator fails, the step is discarded and the instance unchanged.
    pub fn do_step(&mut self, point: f64, size: f64) -> Result<(), CallError> {
        let wants_events = self.log.wants(Status::Ok);
        let Snapshot { clock: Some(clock), scene, next, measured, stage, .. } = self.change() else {
            unreachable!("initialisation has made the clock")
        };
        let Some(simulation) = scene.simulation() else { unreachable!("initialisation has made it ready") };
        let step = Step { point, size, plan: clock.plan(point, size, simulation.parameters().settings.step_size)? };
        // Counters of singularities are copied only where the log passes events on.
        let before = wants_events.then(|| simulation.singular());
        let advanced = match scene {
            Scene::Ready(simulation) => advance(simulation, next, measured, step),
            Scene::Following(following) => advance(following, next, measured, step),
            Scene::Draft(_) => unreachable!("a draft has no simulation"),
        };
        let warnings = match advanced {
            Ok(warnings) => warnings,
            Err(refusal) => {
                if refusal.status == Status::Discard {
                    *stage = Stage::StepFailed;
                }
                return Err(refusal);
            }
        };
        clock.advance(step.plan);
        next.after_step(size);
        *stage = Stage::StepComplete;
        for text in warnings {
            self.log.push(Status::Warning, || text);
        }
        self.warn(point + size);
        if let Some(before) = before {
            self.log_singularities(before, point, point + size)?;
        }
        Ok(())
    }

    /// fmi2CancelStep: refused, since a step is never pending. A test build with `--cfg forced_panic` panics here.
    pub fn cancel_step(&self) -> Result<(), CallError> {
        if cfg!(forced_panic) {
            panic!("forced by the test build");
        }
        Err(CallError::error("no step is pending: fmi2DoStep never returns fmi2Pending."))
    }

    /// Warns once that servo references are not read, and once that the loads are stiff.
    #[inline(always)]
    pub(super) fn warn(&mut self, time: f64) {
        let Some(simulation) = self.now.scene.simulation() else { return };
        if !self.now.warned_of_references && !simulation.model().has_servo && simulation.inputs().has_servo_reference() {
            self.now.warned_of_references = true;
            self.log.push(Status::Warning, || {
                "servo.theta or servo.omega is not 0, but no active effect reads them: servo.enabled is false.".to_owned()
            });
        }
        if !self.now.warned_of_stiffness && simulation.is_stiff() {
            self.now.warned_of_stiffness = true;
            self.log.push(Status::Warning, || {
                format!(
                    "at {time:?} s: the steps of solver.method dop853 are limited by stability, not by accuracy: the loads are stiff; \
                     automatic takes longer steps."
                )
            });
        }
    }

    /// Logs the passages through each kind of singularity during a step, and a start from rest in a vertex.
    #[cold]
    fn log_singularities(&mut self, before: [u64; CONFIGURATION_SIGNS + 2], from: f64, to: f64) -> Result<(), CallError> {
        let core = self.observe()?.observation().state().core;
        let counts = core.counters.singular();
        let [launches, passes @ ..]: [u64; CONFIGURATION_SIGNS + 2] = std::array::from_fn(|i| counts[i].saturating_sub(before[i]));
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

/// A simulation, by itself or following a measured machine.
pub(super) trait Machine: Clone {
    /// Whether samples correct the state before a step.
    const IS_MEASURED: bool;
    /// State before a step that warnings after it compare with.
    type Told;

    /// Inputs of the master that the last step held.
    fn inputs(&self) -> &Inputs;

    /// Sets other tunable parameters.
    fn tune(&mut self, parameters: &Parameters) -> Result<(), SceneError>;

    /// Measurement update by the samples that are new at a communication point, s.
    fn correct(&mut self, measured: &Measured, point: f64);

    /// `steps` macro steps of `h` seconds. After a failure the caller puts back the copy that it has, if it has one.
    fn advance_along(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure>;

    /// State before a step that warnings after it compare with.
    fn told(&self) -> Self::Told;

    /// Warnings after a step.
    fn warnings(&mut self, before: Self::Told, step: &Step) -> Vec<String>;
}

/// Takes a communication step, or leaves the machine unchanged: parameters, samples, motion. Answers with warnings.
#[inline(always)]
fn advance<M: Machine>(machine: &mut Box<M>, next: &Next, measured: &Measured, step: Step) -> Result<Vec<String>, CallError> {
    let held;
    let signal = if let Some(signal) = &next.signal {
        check_reach(signal, step.size)?;
        signal
    } else {
        held = Signal::held(*machine.inputs());
        &held
    };
    let told = machine.told();
    // Clones the machine into place instead of its box: a step allocates nothing.
    let before = (M::IS_MEASURED || next.parameters.is_some()).then(|| M::clone(machine));
    let taken = (|| {
        if let Some(parameters) = &next.parameters {
            machine.tune(parameters)?;
        }
        machine.correct(measured, step.point);
        machine.advance_along(signal, step.plan.h, step.plan.steps).map_err(|failure| step.discarded(&failure))
    })();
    if let (Err(_), Some(before)) = (&taken, before) {
        **machine = before;
    }
    taken.map(|()| machine.warnings(told, &step))
}

impl Machine for Simulation {
    const IS_MEASURED: bool = false;
    /// Number of steps by the last fallback stage.
    type Told = u64;

    #[inline(always)]
    fn inputs(&self) -> &Inputs {
        self.inputs()
    }

    fn tune(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        self.tune(&parameters.effects)
    }

    #[inline(always)]
    fn correct(&mut self, _: &Measured, _: f64) {}

    #[inline(always)]
    fn advance_along(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        self.advance_along(signal, h, steps)
    }

    #[inline(always)]
    fn told(&self) -> u64 {
        self.fallbacks()
    }

    #[inline(always)]
    fn warnings(&mut self, before: u64, step: &Step) -> Vec<String> {
        let fallbacks = self.fallbacks() - before;
        if fallbacks == 0 { Vec::new() } else { vec![step.fallback_message(fallbacks)] }
    }
}
