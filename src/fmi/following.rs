//! Warnings of a communication step in a scene with an estimator: encoder faults, restarts of the estimate, and learned values at a bound.

use crate::estimator::Fault;
use crate::estimator::error_state::{DRY, LENGTHS, MASSES, OFFSETS};
use crate::simulation::{Following, NEARLY_IN_PAIRS};

/// Warnings after a step from `point`, s: encoder faults, a restart of the estimate unless it had already `restarted` before the step, and
/// learned values that have reached a bound.
pub(super) fn warnings(following: &mut Following, restarted: bool, point: f64) -> Vec<String> {
    let faults = following.take_reports();
    let mut warnings: Vec<String> = faults.into_iter().map(|(encoder, fault)| fault_message(encoder, fault, point)).collect();
    // `has_restarted` remains true until the next samples.
    if following.estimator().has_restarted() && !restarted {
        warnings.push(format!(
            "at {point:?} s: measured.theta[1..2] differed from the estimate by more than 0.1 rad for most of 0.1 s: the estimate \
             diverged and restarts from the measured angles."
        ));
    }
    if following.parameters().estimator.learn_enabled {
        warnings.extend(following.take_bounds().into_iter().map(|reached| bound_message(reached, point)));
    }
    warnings
}

/// Warning at the start: lengths are uncertain but not learned.
pub(super) fn unlearned_lengths(following: &Following) -> Option<String> {
    let parameters = following.parameters();
    let sigma = parameters.estimator.sigma0_length;
    (parameters.estimator.learn_enabled && sigma > 0.0 && !parameters.learns_lengths()).then(|| {
        let [pair, base] = NEARLY_IN_PAIRS.map(|times| times * sigma);
        format!(
            "link[i].length and base.distance are not learned, but remain uncertain by estimator.sigma0.length = {sigma:?} m: base.distance = {:?} m is \
             at most {base:?} m, and the lengths are equal in pairs to {pair:?} m, so that their errors decide how the machine leaves a posture with all \
             links in line.",
            parameters.geometry.base_distance
        )
    })
}

/// Warning about a learned value that was moved to a bound.
fn bound_message((parameter, value, [least, most]): (usize, f64, [f64; 2]), time: f64) -> String {
    let (name, unit) = match parameter {
        DRY => ("estimated.friction".to_owned(), ""),
        _ if MASSES.contains(&parameter) => (format!("estimated.mass[{}]", parameter - MASSES.start + 1), " kg"),
        _ if LENGTHS.contains(&parameter) => (format!("estimated.length[{}]", parameter - LENGTHS.start + 1), " m"),
        _ => (format!("estimated.offset[{}]", parameter - OFFSETS.start + 1), " rad"),
    };
    format!(
        "at {time:?} s: {name} = {value:?}{unit} has been moved to its bound (allowed: {least:?} to {most:?}{unit}): the machine differs \
         from its description, or has an effect that is not modelled. This warning comes again only after all values have been within their bounds for 1 s."
    )
}

/// Warning about a silent encoder or rejected samples.
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
