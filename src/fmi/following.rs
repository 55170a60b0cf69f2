//! Warnings of a communication step of a machine that is followed: faults of its encoders, and restarts of the estimate.

use crate::estimator::Fault;
use crate::simulation::Following;

/// Warnings after a step from `point`, s: faults of encoders, and a restart of the estimate unless the samples before had `restarted` it.
pub(super) fn warnings(following: &mut Following, restarted: bool, point: f64) -> Vec<String> {
    let faults = following.take_reports();
    let mut warnings: Vec<String> = faults.into_iter().map(|(encoder, fault)| fault_message(encoder, fault, point)).collect();
    // `has_restarted` stays true until the next samples.
    if following.estimator().has_restarted() && !restarted {
        warnings.push(format!(
            "at {point:?} s: measured.theta[1..2] differed from the estimate by more than 0.1 rad for most of 0.1 s: the estimate \
             diverged and restarts from the measured angles."
        ));
    }
    warnings
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
