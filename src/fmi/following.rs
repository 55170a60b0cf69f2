//! A communication step of a machine that is followed: samples of the encoders correct the state, then the prediction is
//! integrated.

use super::CallError;
use super::derivatives::check_reach;
use super::snapshot::Next;
use super::stepping::Step;
use crate::estimator::{Fault, Measured};
use crate::simulation::{Following, Signal};

/// Corrects and advances a machine that is followed by a communication step, or leaves it unchanged. Answers with warnings.
#[cold]
#[inline(never)]
pub(super) fn follow(
    following: &mut Box<Following>,
    next: &Next,
    measured: &Measured,
    step: Step,
) -> Result<Vec<String>, CallError> {
    let Step { point, size, plan } = step;
    let signal = next.signal.unwrap_or(Signal::held(*following.inputs()));
    check_reach(&signal, size)?;
    // Clones the estimate into place instead of its box: a step allocates nothing.
    let before = Following::clone(following);
    let advanced = (|| {
        if let Some(parameters) = &next.parameters {
            following.tune(&parameters.effects, &parameters.estimator)?;
        }
        following.correct(measured, point);
        following.advance_along(&signal, plan.h, plan.steps).map_err(|failure| step.discarded(&failure))
    })();
    if let Err(refusal) = advanced {
        **following = before;
        return Err(refusal);
    }
    let mut warnings: Vec<String> =
        following.take_reports().into_iter().map(|(encoder, fault)| fault_message(encoder, fault, point)).collect();
    // `has_restarted` stays true until the next samples.
    if following.estimator().has_restarted() && !before.estimator().has_restarted() {
        warnings.push(format!(
            "at {point:?} s: measured.theta[1..2] differed from the estimate by more than 0.1 rad for most of 0.1 s: the estimate \
             diverged and restarts from the measured angles."
        ));
    }
    Ok(warnings)
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
