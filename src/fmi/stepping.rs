//! A communication step and its log lines.

use super::derivatives::check_reach;
use super::following;
use super::messages::Status;
use super::snapshot::Scene;
use super::{CallError, Instance, Snapshot, Stage};
use crate::integrator::CONFIGURATION_SIGNS;
use crate::simulation::{FailureCause, Settings, StepFailure};

impl Instance {
    /// fmi2DoStep from `point`, s, by `size`, s. Refuses a point or size as [`Clock::plan`](super::clock::Clock::plan) does, inputs that
    /// become infinite within the step, and tuned parameters that do not fit together. If the integrator fails, the step is discarded and
    /// rolled back.
    pub fn do_step(&mut self, point: f64, size: f64) -> Result<(), CallError> {
        let wants_events = self.log.wants(Status::Ok);
        let may_fail_midway = self.change().may_fail_midway();
        let Self { now, before, .. } = self;
        let Snapshot { clock: Some(clock), scene: Some(scene), parameters, is_tuned, signal, measured, stage, .. } = now else {
            unreachable!("initialisation has made clock and scene")
        };
        let simulation = scene.simulation();
        let plan = clock.plan(point, size, simulation.parameters().settings.step_size)?;
        check_reach(signal, size)?;
        // Counters of singularities are copied only if the log passes events on.
        let singular_before = wants_events.then(|| simulation.singular());
        let fallbacks_before = simulation.fallbacks();
        let restarted_before = scene.following().is_some_and(|following| following.estimator().has_restarted());
        let discarded = |failure| discarded(failure, point, size);
        if may_fail_midway {
            let Some(before) = before else { unreachable!("initialisation has made the rollback copy") };
            before.clone_from(scene);
        }
        let taken = match scene {
            Scene::Ready(simulation) => {
                let tuned = if *is_tuned { simulation.tune(&parameters.effects) } else { Ok(()) };
                tuned
                    .map_err(CallError::from)
                    .and_then(|()| simulation.advance_along(signal, plan.h, plan.steps).map_err(discarded))
            }
            Scene::Following(following) => apart(|| {
                if *is_tuned {
                    following.tune(&parameters.effects, &parameters.estimator)?;
                }
                following.correct(measured, point);
                following.advance_along(signal, plan.h, plan.steps).map_err(discarded)
            }),
        };
        if let Err(refusal) = taken {
            if may_fail_midway {
                std::mem::swap(&mut now.scene, before);
            }
            if refusal.status == Status::Discard {
                *stage = Stage::StepFailed;
            }
            return Err(refusal);
        }
        clock.advance(plan);
        signal.end(size);
        *is_tuned = false;
        *stage = Stage::StepComplete;
        let fallbacks = scene.simulation().fallbacks() - fallbacks_before;
        if let Scene::Following(following) = scene {
            for text in following::warnings(following, restarted_before, point) {
                self.log.push(Status::Warning, || text);
            }
        }
        if fallbacks > 0 {
            self.log.push(Status::Warning, || fallback_message(fallbacks, point, point + size));
        }
        self.warn(point + size);
        if let Some(before) = singular_before {
            self.log_singularities(before, point, point + size)?;
        }
        Ok(())
    }

    /// fmi2CancelStep: refused, because a step is never pending. A test build with `--cfg forced_panic` panics here.
    pub fn cancel_step(&self) -> Result<(), CallError> {
        if cfg!(forced_panic) {
            panic!("forced by the test build");
        }
        Err(CallError::error("no step is pending: fmi2DoStep never returns fmi2Pending."))
    }

    /// Warns once if servo references are not read, if the loads are stiff, and if steps of fixed length failed their checks.
    #[inline(always)]
    pub(super) fn warn(&mut self, time: f64) {
        let Some(simulation) = self.now.scene.as_ref().map(Scene::simulation) else { return };
        if !self.now.warned.references && !simulation.model().has_servo && simulation.inputs().has_servo_reference() {
            self.now.warned.references = true;
            self.log.push(Status::Warning, || {
                "servo.theta or servo.omega is not 0, but no active effect reads them: servo.enabled is false.".to_owned()
            });
        }
        if !self.now.warned.stiffness && simulation.is_stiff() {
            self.now.warned.stiffness = true;
            self.log.push(Status::Warning, || {
                format!(
                    "at {time:?} s: the steps of solver.method {} are limited by stability, not by accuracy: the loads are stiff; \
                     automatic takes longer steps.",
                    simulation.parameters().settings.method.name()
                )
            });
        }
        if !self.now.warned.breaches && simulation.breaches() > 0 {
            self.now.warned.breaches = true;
            let Settings { method, step_size, .. } = simulation.parameters().settings;
            self.log.push(Status::Warning, || {
                format!(
                    "at {time:?} s: a step of solver.method {} failed its checks: it changed the energy by 1 % without a force, or changed \
                     the sign of a determinant away from its singularity. solver.stepSize = {step_size:?} s is too long for this motion.",
                    method.name()
                )
            });
        }
    }

    /// Logs passages through each kind of singularity during a step, and a start from rest in a vertex.
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

/// Runs `work` in a function of its own, so that other paths of the caller need no stack for it.
#[inline(never)]
fn apart<T>(work: impl FnOnce() -> T) -> T {
    work()
}

/// Error of a step from `point`, s, by `size`, s, that the integrator could not take, or that has too many commands.
fn discarded(StepFailure { elapsed, cause }: StepFailure, point: f64, size: f64) -> CallError {
    if let FailureCause::Commands(refusal) = cause {
        return CallError::error(format!("{refusal}."));
    }
    CallError::discard(format!(
        "the step from {point:?} s by {size:?} s failed at {:?} s: {cause}; the state at {point:?} s is unchanged.",
        point + elapsed
    ))
}

/// Warning about steps between two times, s, that used the last fallback stage.
fn fallback_message(fallbacks: u64, from: f64, to: f64) -> String {
    let many = if fallbacks == 1 { "step" } else { "steps" };
    format!(
        "between {from:?} s and {to:?} s: {fallbacks} {many} used the last fallback stage, since the equations were not solved: energy is \
         conserved, the trajectory is not resolved; see solver.lastResorts and solver.maxWork."
    )
}
