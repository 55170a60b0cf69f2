//! The table of calls allowed in each state: FMI 2.0.4, sections 3.2.3 and 4.2.4, figures and tables.
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
//! The standard's states stepInProgress and stepCanceled do not exist here: a step is never pending. The state error does not exist
//! either: a call that is refused changes nothing, so the instance stays in its state.

use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use super::CallError;

/// Kind of FMU (fmi2Type).
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Kind {
    /// Model exchange: the master integrates the states.
    ModelExchange,
    /// Co-simulation: the instance takes its own steps.
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

/// State of the life cycle of an instance.
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
    /// Model exchange: at an event, and after initialisation.
    EventMode,
    /// Model exchange: between events.
    ContinuousTimeMode,
}

impl Stage {
    /// Whether instances of that kind have the state.
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

/// The FMI functions that take an instance.
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
            // Inputs may also be set after a discarded step, beyond the standard: the step has been rolled back, and other inputs
            // may let it succeed.
            Self::SetReal => &[Instantiated, InitializationMode, StepComplete, StepFailed, EventMode, ContinuousTimeMode],
            Self::SetInteger | Self::SetBoolean | Self::SetString => {
                &[Instantiated, InitializationMode, StepComplete, StepFailed, EventMode]
            }
            Self::SetRealInputDerivatives => &[Instantiated, InitializationMode, StepComplete, StepFailed],
            // The standard asks for fmi2SetFMUstate before a step is tried again; a discarded step has already been rolled back
            // here.
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
            // fmi2CancelStep is allowed everywhere and answered with an error of its own: a step is never pending.
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

    /// Kind of FMU that a function belongs to; `None` for functions common to both.
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
