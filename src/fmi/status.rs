//! The status functions of co-simulation (FMI 2.0.4, section 4.2.3).

use super::{CallError, Instance};

/// fmi2LastSuccessfulTime, a number of fmi2StatusKind.
const LAST_SUCCESSFUL_TIME: i32 = 2;
/// fmi2Terminated, a number of fmi2StatusKind.
const TERMINATED: i32 = 3;

impl Instance {
    /// fmi2GetRealStatus: the communication point reached, s.
    pub fn real_status(&self, kind: i32) -> Result<f64, CallError> {
        match (kind, self.clock()) {
            (LAST_SUCCESSFUL_TIME, Some(clock)) => Ok(clock.point()),
            _ => Err(unavailable(kind)),
        }
    }

    /// fmi2GetBooleanStatus: this library never wants to end the simulation.
    pub fn boolean_status(&self, kind: i32) -> Result<bool, CallError> {
        if kind == TERMINATED { Ok(false) } else { Err(unavailable(kind)) }
    }

    /// fmi2GetStatus, fmi2GetIntegerStatus and fmi2GetStringStatus: no status of these types is available.
    pub fn other_status(&self, kind: i32) -> Result<(), CallError> {
        Err(unavailable(kind))
    }
}

/// Refusal of a status: fmi2Discard, as the standard requires for a status that is not available, or an error if the number is no
/// fmi2StatusKind.
fn unavailable(kind: i32) -> CallError {
    CallError::discard(match kind {
        0 => "there is no fmi2DoStepStatus: a step is never pending.",
        1 => "there is no fmi2PendingStatus: a step is never pending.",
        LAST_SUCCESSFUL_TIME => "fmi2LastSuccessfulTime is a Real, ask fmi2GetRealStatus.",
        TERMINATED => "fmi2Terminated is a Boolean, ask fmi2GetBooleanStatus.",
        _ => return CallError::error(format!("status kind is {kind}, must be 0 to 3.")),
    })
}
