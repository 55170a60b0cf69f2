//! Macro steps that a run is asked for, and the failure of one.

use std::fmt;

use crate::integrator::StepError;

/// Failure of an advance. The simulation is as before the call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepFailure {
    /// Time reached, s after the beginning of the call.
    pub elapsed: f64,
    /// Cause of the failure.
    pub cause: StepError,
}

impl fmt::Display for StepFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} s into the call, {}", self.elapsed, self.cause)
    }
}

impl std::error::Error for StepFailure {}

/// Equal macro steps with constant inputs.
#[derive(Clone, Copy, Debug)]
pub(super) struct MacroSteps {
    /// Length of each, s.
    pub(super) h: f64,
    /// Number of macro steps.
    pub(super) count: u64,
    /// Whether the inputs may stay the same afterwards, so that a step may run past the end.
    pub(super) open_ended: bool,
}

impl MacroSteps {
    /// Failure of the macro step with index `step`.
    pub(super) fn failure(&self, step: u64, cause: StepError) -> StepFailure {
        StepFailure { elapsed: step as f64 * self.h, cause }
    }
}
