//! A communication step and its log lines.

use super::clock::Plan;
use super::derivatives::check_reach;
use super::following::follow;
use super::messages::Status;
use super::snapshot::{Next, Scene};
use super::{CallError, Instance, Snapshot, Stage};
use crate::integrator::CONFIGURATION_SIGNS;
use crate::simulation::{Signal, Simulation, StepFailure};

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
            Scene::Ready(simulation) => advance(simulation, next, step),
            Scene::Following(following) => follow(following, next, measured, step),
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

/// Advances a simulation by a communication step, or leaves it unchanged. Answers with warnings.
#[inline(always)]
fn advance(simulation: &mut Box<Simulation>, next: &Next, step: Step) -> Result<Vec<String>, CallError> {
    let Step { point, size, plan: Plan { h, steps, .. } } = step;
    let fallbacks = simulation.fallbacks();
    let advanced = match (&next.parameters, &next.signal) {
        (None, None) => {
            let inputs = *simulation.inputs();
            simulation.advance(&inputs, h, steps)
        }
        (None, Some(signal)) => {
            check_reach(signal, size)?;
            simulation.advance_along(signal, h, steps)
        }
        (Some(parameters), signal) => {
            let signal = signal.unwrap_or(Signal::held(*simulation.inputs()));
            check_reach(&signal, size)?;
            // Clones the simulation into place instead of its box: a step allocates nothing.
            let untuned = Simulation::clone(simulation);
            simulation.tune(&parameters.effects)?;
            simulation.advance_along(&signal, h, steps).inspect_err(|_| **simulation = untuned)
        }
    };
    advanced.map_err(|failure| step.discarded(&failure))?;
    let fallbacks = simulation.fallbacks() - fallbacks;
    if fallbacks == 0 {
        return Ok(Vec::new());
    }
    let many = if fallbacks == 1 { "step" } else { "steps" };
    Ok(vec![format!(
        "between {point:?} s and {:?} s: {fallbacks} {many} used the last fallback stage, since the equations were not solved: energy is \
         conserved, the trajectory is not resolved; see solver.lastResorts and solver.maxWork.",
        point + size
    )])
}
