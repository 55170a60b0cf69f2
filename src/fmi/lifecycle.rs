//! Which call is allowed in which state: FMI 2.0.4, section 4.2.4, figure and table.
//!
//! ```text
//!  fmi2Instantiate                                          fmi2Reset from anywhere
//!        |                                                         |
//!        v        EnterInitializationMode                          v
//!  Instantiated -------------------------> InitializationMode   Instantiated
//!                                                | ExitInitializationMode
//!                                                v                Terminate
//!                    DoStep: OK .----------> StepComplete ------------------> Terminated
//!                               '--------------- | ^                             ^
//!                                DoStep: Discard v | DoStep: OK, tried again     |
//!                                            StepFailed -------------------------'
//! ```
//!
//! The standard's states stepInProgress and stepCanceled do not exist here: a step is never pending. Its state error
//! does not either: a call that is refused changes nothing, so the instance stays where it was.

use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use super::CallError;

/// Where an instance is in its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Stage {
    /// After fmi2Instantiate or fmi2Reset.
    Instantiated,
    /// Between fmi2EnterInitializationMode and fmi2ExitInitializationMode.
    InitializationMode,
    /// At a communication point.
    StepComplete,
    /// At the communication point before a step that was discarded.
    StepFailed,
    /// After fmi2Terminate.
    Terminated,
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Instantiated => "instantiated",
            Self::InitializationMode => "initialization mode",
            Self::StepComplete => "step complete",
            Self::StepFailed => "step failed",
            Self::Terminated => "terminated",
        })
    }
}

/// Every function that takes an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is the standard's function of that name")]
pub enum Call {
    SetDebugLogging,
    SetupExperiment,
    EnterInitializationMode,
    ExitInitializationMode,
    Terminate,
    Reset,
    GetReal,
    GetInteger,
    GetBoolean,
    GetString,
    SetReal,
    SetInteger,
    SetBoolean,
    SetString,
    GetFMUstate,
    SetFMUstate,
    FreeFMUstate,
    SerializedFMUstateSize,
    SerializeFMUstate,
    DeSerializeFMUstate,
    GetDirectionalDerivative,
    SetRealInputDerivatives,
    GetRealOutputDerivatives,
    DoStep,
    CancelStep,
    GetStatus,
    GetRealStatus,
    GetIntegerStatus,
    GetBooleanStatus,
    GetStringStatus,
}

impl fmt::Display for Call {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "fmi2{self:?}")
    }
}

const ANYWHERE: &[Stage] =
    &[Stage::Instantiated, Stage::InitializationMode, Stage::StepComplete, Stage::StepFailed, Stage::Terminated];

impl Call {
    /// The stages in which the standard allows the call. The footnotes of the table (which variables may be set
    /// where) are in `values.rs`.
    #[inline(always)]
    pub fn stages(self) -> &'static [Stage] {
        use Stage::{InitializationMode, Instantiated, StepComplete, StepFailed, Terminated};
        match self {
            Self::SetDebugLogging | Self::Reset => ANYWHERE,
            Self::SetupExperiment | Self::EnterInitializationMode => &[Instantiated],
            Self::ExitInitializationMode => &[InitializationMode],
            Self::Terminate => &[StepComplete, StepFailed],
            Self::GetReal | Self::GetInteger | Self::GetBoolean | Self::GetString => {
                &[InitializationMode, StepComplete, StepFailed, Terminated]
            }
            Self::GetDirectionalDerivative => &[InitializationMode, StepComplete, StepFailed, Terminated],
            Self::GetRealOutputDerivatives => &[StepComplete, StepFailed, Terminated],
            Self::SetReal | Self::SetInteger | Self::SetBoolean | Self::SetString | Self::SetRealInputDerivatives => {
                // After a discard as well, beyond the standard: the step has been rolled back, and another input may be what it needs.
                &[Instantiated, InitializationMode, StepComplete, StepFailed]
            }
            // The standard wants fmi2SetFMUstate before a step is tried again; here a discarded step has already been
            // rolled back, so it may be tried again at once.
            Self::DoStep => &[StepComplete, StepFailed],
            Self::GetStatus | Self::GetRealStatus | Self::GetIntegerStatus | Self::GetBooleanStatus | Self::GetStringStatus => {
                &[StepComplete, StepFailed, Terminated]
            }
            Self::GetFMUstate
            | Self::SetFMUstate
            | Self::FreeFMUstate
            | Self::SerializedFMUstateSize
            | Self::SerializeFMUstate
            | Self::DeSerializeFMUstate => ANYWHERE,
            // Answered with an error of its own: a step is never pending.
            Self::CancelStep => ANYWHERE,
        }
    }

    /// Refuses the call in a stage that does not allow it.
    #[inline(always)]
    pub fn require(self, stage: Stage) -> Result<(), CallError> {
        let allowed = self.stages();
        if allowed.contains(&stage) { Ok(()) } else { Err(illegal(stage, allowed)) }
    }
}

#[cold]
fn illegal(stage: Stage, allowed: &[Stage]) -> CallError {
    let names: Vec<String> = allowed.iter().map(Stage::to_string).collect();
    CallError::error(format!("the state is \"{stage}\", allowed is: {}.", names.join(", ")))
}
