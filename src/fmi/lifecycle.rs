//! Which call is allowed in which state: FMI 2.0.4, sections 3.2.3 and 4.2.4, figures and tables.
//!
//! Co-simulation:
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
//! Model exchange:
//!
//! ```text
//!  fmi2Instantiate                                          fmi2Reset from anywhere
//!        |                                                         |
//!        v        EnterInitializationMode                          v
//!  Instantiated -------------------------> InitializationMode   Instantiated
//!                                                | ExitInitializationMode
//!                                                v                    Terminate
//!                 NewDiscreteStates .-----> EventMode --------------------------> Terminated
//!                                   '---------- | ^                                  ^
//!                     EnterContinuousTimeMode   v | EnterEventMode                   |
//!                                      ContinuousTimeMode ---------------------------'
//! ```
//!
//! The standard's states stepInProgress and stepCanceled do not exist here: a step is never pending. Its state error
//! does not either: a call that is refused changes nothing, so the instance stays where it was.

use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use super::CallError;

/// What an instance is for: fmi2Type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Kind {
    /// The master integrates the states.
    ModelExchange,
    /// The instance makes its own steps.
    CoSimulation,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::ModelExchange => "model exchange",
            Self::CoSimulation => "co-simulation",
        })
    }
}

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
    /// Of model exchange: at an event, and after initialisation.
    EventMode,
    /// Of model exchange: between events.
    ContinuousTimeMode,
}

impl Stage {
    /// Whether an instance of that kind can be there.
    pub(super) fn belongs_to(self, kind: Kind) -> bool {
        match self {
            Self::Instantiated | Self::InitializationMode | Self::Terminated => true,
            Self::StepComplete | Self::StepFailed => kind == Kind::CoSimulation,
            Self::EventMode | Self::ContinuousTimeMode => kind == Kind::ModelExchange,
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Instantiated => "instantiated",
            Self::InitializationMode => "initialization mode",
            Self::StepComplete => "step complete",
            Self::StepFailed => "step failed",
            Self::Terminated => "terminated",
            Self::EventMode => "event mode",
            Self::ContinuousTimeMode => "continuous-time mode",
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
    EnterEventMode,
    NewDiscreteStates,
    EnterContinuousTimeMode,
    CompletedIntegratorStep,
    SetTime,
    SetContinuousStates,
    GetDerivatives,
    GetEventIndicators,
    GetContinuousStates,
    GetNominalsOfContinuousStates,
}

impl fmt::Display for Call {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "fmi2{self:?}")
    }
}

const ANYWHERE: &[Stage] = &[
    Stage::Instantiated,
    Stage::InitializationMode,
    Stage::StepComplete,
    Stage::StepFailed,
    Stage::EventMode,
    Stage::ContinuousTimeMode,
    Stage::Terminated,
];

impl Call {
    /// The stages in which the standard allows the call. The footnotes of the table (which variables may be set
    /// where) are in `values.rs`.
    #[inline(always)]
    pub fn stages(self) -> &'static [Stage] {
        use Stage::{ContinuousTimeMode, EventMode, InitializationMode, Instantiated, StepComplete, StepFailed, Terminated};
        match self {
            Self::SetDebugLogging | Self::Reset => ANYWHERE,
            Self::SetupExperiment | Self::EnterInitializationMode => &[Instantiated],
            Self::ExitInitializationMode => &[InitializationMode],
            Self::Terminate => &[StepComplete, StepFailed, EventMode, ContinuousTimeMode],
            Self::GetReal | Self::GetInteger | Self::GetBoolean | Self::GetString | Self::GetDirectionalDerivative => {
                &[InitializationMode, StepComplete, StepFailed, EventMode, ContinuousTimeMode, Terminated]
            }
            Self::GetRealOutputDerivatives => &[StepComplete, StepFailed, Terminated],
            // After a discard as well, beyond the standard: the step has been rolled back, and another input may be what it needs.
            Self::SetReal => &[Instantiated, InitializationMode, StepComplete, StepFailed, EventMode, ContinuousTimeMode],
            Self::SetInteger | Self::SetBoolean | Self::SetString => {
                &[Instantiated, InitializationMode, StepComplete, StepFailed, EventMode]
            }
            Self::SetRealInputDerivatives => &[Instantiated, InitializationMode, StepComplete, StepFailed],
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
            Self::EnterEventMode | Self::SetTime => &[EventMode, ContinuousTimeMode],
            Self::NewDiscreteStates | Self::EnterContinuousTimeMode => &[EventMode],
            Self::CompletedIntegratorStep | Self::SetContinuousStates => &[ContinuousTimeMode],
            Self::GetDerivatives => &[EventMode, ContinuousTimeMode, Terminated],
            Self::GetEventIndicators | Self::GetContinuousStates => {
                &[InitializationMode, EventMode, ContinuousTimeMode, Terminated]
            }
            Self::GetNominalsOfContinuousStates => &[Instantiated, EventMode, ContinuousTimeMode, Terminated],
        }
    }

    /// What the instance has to be for; `None` of functions common to both.
    #[inline(always)]
    fn kind(self) -> Option<Kind> {
        match self {
            Self::SetRealInputDerivatives
            | Self::GetRealOutputDerivatives
            | Self::DoStep
            | Self::CancelStep
            | Self::GetStatus
            | Self::GetRealStatus
            | Self::GetIntegerStatus
            | Self::GetBooleanStatus
            | Self::GetStringStatus => Some(Kind::CoSimulation),
            Self::EnterEventMode
            | Self::NewDiscreteStates
            | Self::EnterContinuousTimeMode
            | Self::CompletedIntegratorStep
            | Self::SetTime
            | Self::SetContinuousStates
            | Self::GetDerivatives
            | Self::GetEventIndicators
            | Self::GetContinuousStates
            | Self::GetNominalsOfContinuousStates => Some(Kind::ModelExchange),
            _ => None,
        }
    }

    /// Refuses the call on an instance of the other kind, or in a stage that does not allow it.
    #[inline(always)]
    pub fn require(self, kind: Kind, stage: Stage) -> Result<(), CallError> {
        let allowed = self.stages();
        if self.kind().is_some_and(|own| own != kind) {
            Err(wrong_kind(kind))
        } else if allowed.contains(&stage) {
            Ok(())
        } else {
            Err(illegal(stage, kind, allowed))
        }
    }
}

#[cold]
#[inline(never)]
fn wrong_kind(kind: Kind) -> CallError {
    CallError::error(format!("the instance is for {kind}, which does not have this function."))
}

#[cold]
#[inline(never)]
fn illegal(stage: Stage, kind: Kind, allowed: &[Stage]) -> CallError {
    let names: Vec<String> = allowed.iter().filter(|stage| stage.belongs_to(kind)).map(Stage::to_string).collect();
    CallError::error(format!("the state is \"{stage}\", allowed is: {}.", names.join(", ")))
}
