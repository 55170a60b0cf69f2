//! A request for macro steps, and the failure of a macro step.

use std::fmt;

use super::commands::TooManyCommands;
use crate::integrator::StepError;

/// Failure of an advance. The simulation is as before the call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepFailure {
    /// Time reached, s after the beginning of the call.
    pub elapsed: f64,
    /// Cause of the failure.
    pub cause: FailureCause,
}

/// Cause of a failed advance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FailureCause {
    /// The integrator could not make a step.
    Step(StepError),
    /// More commands wait for their effect than there is room for.
    Commands(TooManyCommands),
}

impl fmt::Display for FailureCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Step(error) => error.fmt(f),
            Self::Commands(refusal) => refusal.fmt(f),
        }
    }
}

impl StepFailure {
    /// The failure of a call that began `begin` seconds earlier.
    pub(super) fn after(self, begin: f64) -> Self {
        Self { elapsed: begin + self.elapsed, ..self }
    }
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
    /// Whether the inputs may remain constant afterwards, so that a step may run past the end.
    pub(super) open_ended: bool,
    /// Time until the inputs are known to change, s; infinite if no change is known. If it is finite, there is one macro step.
    pub(super) change: f64,
}

impl MacroSteps {
    /// Failure of the macro step with index `step`.
    pub(super) fn failure(&self, step: u64, cause: StepError) -> StepFailure {
        StepFailure { elapsed: step as f64 * self.h, cause: FailureCause::Step(cause) }
    }
}
