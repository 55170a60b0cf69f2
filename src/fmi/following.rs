//! A machine that is followed, in a communication step: samples of the encoders correct the state, and their faults are told.

use super::stepping::{Machine, Step};
use crate::estimator::{Fault, Measured};
use crate::mechanism::SceneError;
use crate::simulation::{Following, Inputs, Parameters, Signal, StepFailure};

impl Machine for Following {
    const IS_MEASURED: bool = true;
    /// Number of steps by the last fallback stage, and whether the estimate had been restarted by the samples before.
    type Told = (u64, bool);

    fn inputs(&self) -> &Inputs {
        self.inputs()
    }

    fn tune(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        self.tune(&parameters.effects, &parameters.estimator)
    }

    fn correct(&mut self, measured: &Measured, point: f64) {
        self.correct(measured, point);
    }

    fn advance_along(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        self.advance_along(signal, h, steps)
    }

    fn told(&self) -> (u64, bool) {
        (self.simulation().fallbacks(), self.estimator().has_restarted())
    }

    fn warnings(&mut self, (fallbacks, restarted): (u64, bool), step: &Step) -> Vec<String> {
        let point = step.point;
        let faults = self.take_reports();
        let mut warnings: Vec<String> = faults.into_iter().map(|(encoder, fault)| fault_message(encoder, fault, point)).collect();
        // `has_restarted` stays true until the next samples.
        if self.estimator().has_restarted() && !restarted {
            warnings.push(format!(
                "at {point:?} s: measured.theta[1..2] differed from the estimate by more than 0.1 rad for most of 0.1 s: the estimate \
                 diverged and restarts from the measured angles."
            ));
        }
        let fallbacks = self.simulation().fallbacks() - fallbacks;
        if fallbacks > 0 {
            warnings.push(step.fallback_message(fallbacks));
        }
        warnings
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
