//! The status functions of co-simulation (FMI 2.0.4, section 4.2.3).

use super::{CallError, Instance};

/// fmi2StatusKind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StatusKind {
    DoStepStatus,
    PendingStatus,
    LastSuccessfulTime,
    Terminated,
}

impl StatusKind {
    /// The kind of that number in fmi2FunctionTypes.h.
    fn from_number(number: i32) -> Result<Self, CallError> {
        match number {
            0 => Ok(Self::DoStepStatus),
            1 => Ok(Self::PendingStatus),
            2 => Ok(Self::LastSuccessfulTime),
            3 => Ok(Self::Terminated),
            _ => Err(CallError::error(format!("status kind is {number}, must be 0 to 3."))),
        }
    }

    /// fmi2Discard, the standard's answer where a status is not available.
    fn unavailable(self) -> CallError {
        CallError::discard(match self {
            Self::DoStepStatus => "there is no fmi2DoStepStatus: a step is never pending.",
            Self::PendingStatus => "there is no fmi2PendingStatus: a step is never pending.",
            Self::LastSuccessfulTime => "fmi2LastSuccessfulTime is a Real, ask fmi2GetRealStatus.",
            Self::Terminated => "fmi2Terminated is a Boolean, ask fmi2GetBooleanStatus.",
        })
    }
}

impl Instance {
    /// fmi2GetRealStatus: the communication point reached, s.
    pub fn real_status(&self, kind: i32) -> Result<f64, CallError> {
        match (StatusKind::from_number(kind)?, self.clock()) {
            (StatusKind::LastSuccessfulTime, Some(clock)) => Ok(clock.point()),
            (kind, _) => Err(kind.unavailable()),
        }
    }

    /// fmi2GetBooleanStatus: this library never wants to end the simulation.
    pub fn boolean_status(&self, kind: i32) -> Result<bool, CallError> {
        match StatusKind::from_number(kind)? {
            StatusKind::Terminated => Ok(false),
            kind => Err(kind.unavailable()),
        }
    }

    /// fmi2GetStatus, fmi2GetIntegerStatus and fmi2GetStringStatus: no status of these types is available.
    pub fn other_status(&self, kind: i32) -> Result<(), CallError> {
        Err(StatusKind::from_number(kind)?.unavailable())
    }
}
