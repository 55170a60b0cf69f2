//! A communication step of a machine that is followed: samples of the encoders correct the state, then the prediction is
//! integrated.

use super::derivatives::check_reach;
use super::messages::Status;
use super::snapshot::Scene;
use super::stepping::{step_discarded, warn};
use super::{CallError, Instance};
use crate::estimator::Fault;
use crate::simulation::Signal;

impl Instance {
    /// fmi2DoStep from `point`, s, by `size`, s. If the integrator fails, the step is discarded and the instance unchanged.
    #[cold]
    #[inline(never)]
    pub(super) fn follow(&mut self, point: f64, size: f64) -> Result<(), CallError> {
        let wants_events = self.log.wants(Status::Ok);
        let now = self.change();
        let (Some(clock), Scene::Following(following)) = (&mut now.clock, &mut now.scene) else {
            unreachable!("initialisation has made both")
        };
        let plan = clock.plan(point, size, following.parameters().settings.step_size)?;
        let signal = now.next.signal.unwrap_or(Signal::held(*following.inputs()));
        check_reach(&signal, size)?;
        let passes = wants_events.then(|| following.simulation().singular());
        // Clones the estimate into place instead of its box: a step allocates nothing.
        let before = (**following).clone();
        let advanced = (|| {
            if let Some(parameters) = &now.next.parameters {
                following.tune(&parameters.effects, &parameters.estimator)?;
            }
            following.correct(&now.measured, point);
            following.advance_along(&signal, plan.h, plan.steps).map_err(|failure| step_discarded(point, size, &failure))
        })();
        if let Err(refusal) = advanced {
            if refusal.status == Status::Discard {
                now.stage = super::Stage::StepFailed;
            }
            **following = before;
            return Err(refusal);
        }
        let news = following.take_reports();
        // `has_restarted` stays true until the next samples.
        let restarted = following.estimator().has_restarted() && !before.estimator().has_restarted();
        clock.advance(plan);
        now.next.after_step(size);
        now.stage = super::Stage::StepComplete;
        for (encoder, fault) in news {
            warn(&mut self.log, || fault_message(encoder, fault, point));
        }
        if restarted {
            warn(&mut self.log, || {
                format!(
                    "at {point:?} s: measured.theta[1..2] differed from the estimate by more than 0.1 rad for most of 0.1 s: the estimate \
                     diverged and restarts from the measured angles."
                )
            });
        }
        self.warn(point + size);
        if let Some(passes) = passes {
            self.log_singularities(passes, point, point + size)?;
        }
        Ok(())
    }
}

/// The warning about a fault of an encoder: silent, or samples rejected.
fn fault_message(encoder: usize, fault: Fault, time: f64) -> String {
    let name = format!("measured.theta[{}]", encoder + 1);
    let what = match fault {
        Fault::None => "has been silent for longer than the interval of its last samples: the estimate continues without it",
        Fault::Rejected => "is too far from the predicted angle: the sample is not used",
        Fault::Late => "is older than estimator.maxDelay or than the stored history: the sample is not used",
        Fault::Future => "has a time after the communication point: the sample is not used",
        Fault::Invalid => "or its time is not finite, or the angle exceeds 1e9 rad: the sample is not used",
        Fault::Stuck => "repeats its value while the machine moves: its samples are not used until it changes",
    };
    format!("at {time:?} s: {name} {what}. This warning comes once for each encoder; see estimated.status.")
}
