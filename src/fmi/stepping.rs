//! A communication step of a simulation and its log lines.

use super::derivatives::check_reach;
use super::messages::{Log, Status};
use super::snapshot::Scene;
use super::{CallError, Instance, Stage};
use crate::integrator::CONFIGURATION_SIGNS;
use crate::simulation::{Signal, Simulation, StepFailure};

impl Instance {
    /// fmi2DoStep from `point`, s, by `size`, s. If the integrator fails, the step is discarded and the instance unchanged.
    pub fn do_step(&mut self, point: f64, size: f64) -> Result<(), CallError> {
        let wants_events = self.log.wants(Status::Ok);
        let now = self.change();
        let (Some(clock), Scene::Ready(simulation)) = (&mut now.clock, &mut now.scene) else {
            return self.follow(point, size);
        };
        let plan = clock.plan(point, size, simulation.parameters().settings.step_size)?;
        // Counters of singularities are copied only where the log passes events on.
        let before = wants_events.then(|| simulation.singular());
        let fallbacks = simulation.fallbacks();
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
                // Clones the simulation into place instead of its box: a step allocates nothing.
                let untuned = Simulation::clone(simulation);
                simulation.tune(&parameters.effects)?;
                simulation.advance_along(&signal, plan.h, plan.steps).inspect_err(|_| **simulation = untuned)
            }
        };
        if let Err(failure) = advanced {
            now.stage = Stage::StepFailed;
            return Err(step_discarded(point, size, &failure));
        }
        let fallbacks = simulation.fallbacks() - fallbacks;
        clock.advance(plan);
        now.next.after_step(size);
        now.stage = Stage::StepComplete;
        if fallbacks > 0 {
            warn(&mut self.log, || {
                let steps = if fallbacks == 1 { "step" } else { "steps" };
                format!(
                    "between {point:?} s and {:?} s: {fallbacks} {steps} used the last fallback stage, since the equations were not solved: energy is \
                     conserved, the trajectory is not resolved; see solver.lastResorts and solver.maxWork.",
                    point + size
                )
            });
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
            warn(&mut self.log, || {
                "servo.theta or servo.omega is not 0, but no active effect reads them: servo.enabled is false.".to_owned()
            });
        }
        if !self.now.warned_of_stiffness && simulation.is_stiff() {
            self.now.warned_of_stiffness = true;
            warn(&mut self.log, || {
                format!(
                    "at {time:?} s: the steps of solver.method dop853 are limited by stability, not by accuracy: the loads are stiff; \
                     automatic takes longer steps."
                )
            });
        }
    }

    /// Logs the passages through each kind of singularity during a step, and a start from rest in a vertex.
    #[cold]
    pub(super) fn log_singularities(
        &mut self,
        before: [u64; CONFIGURATION_SIGNS + 2],
        from: f64,
        to: f64,
    ) -> Result<(), CallError> {
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

#[cold]
pub(super) fn step_discarded(point: f64, size: f64, failure: &StepFailure) -> CallError {
    let StepFailure { elapsed, cause } = failure;
    CallError::discard(format!(
        "the step from {point:?} s by {size:?} s failed at {:?} s: {cause}; the state is still that of {point:?} s.",
        point + elapsed
    ))
}

#[cold]
pub(super) fn warn(log: &mut Log, text: impl FnOnce() -> String) {
    log.push(Status::Warning, text);
}
