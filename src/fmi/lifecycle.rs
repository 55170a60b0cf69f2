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
//! FMI's states stepInProgress and stepCanceled do not exist here, because a step is never pending. Nor does the state error: a refused
//! call changes nothing, so the instance remains in its state.

use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use super::CallError;

/// Kind of FMU (fmi2Type).
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Kind {
    /// Model exchange: the master integrates the states.
    ModelExchange,
    /// Co-simulation: the instance makes its own steps.
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
    /// Name of the stage, and the kind of instance that has it; `None` for both kinds.
    fn about(self) -> (&'static str, Option<Kind>) {
        match self {
            Self::Instantiated => ("instantiated", None),
            Self::InitializationMode => ("initialization mode", None),
            Self::StepComplete => ("step complete", Some(Kind::CoSimulation)),
            Self::StepFailed => ("step failed", Some(Kind::CoSimulation)),
            Self::Terminated => ("terminated", None),
            Self::EventMode => ("event mode", Some(Kind::ModelExchange)),
            Self::ContinuousTimeMode => ("continuous-time mode", Some(Kind::ModelExchange)),
        }
    }

    /// Whether instances of this kind have the stage.
    pub(super) fn belongs_to(self, kind: Kind) -> bool {
        self.about().1.is_none_or(|own| own == kind)
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.about().0)
    }
}

/// Defines [`Call`] from a table: kind of FMU that has the functions, the functions, the stages in which they are allowed.
macro_rules! calls {
    ($($kind:ident: $($call:ident)+ => [$($stage:ident)+];)+) => {
        /// The FMI functions that take an instance.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[expect(missing_docs, non_camel_case_types, reason = "each is the standard's function of that name")]
        pub enum Call { $($($call),+),+ }

        impl Call {
            /// Kind of FMU that has the function, `None` for both kinds, and the stages in which it is allowed.
            #[inline(always)]
            fn rule(self) -> (Option<Kind>, &'static [Stage]) {
                match self { $($(Self::$call)|+ => ($kind, &[$(Stage::$stage),+]),)+ }
            }
        }
    };
}

const BOTH: Option<Kind> = None;
const CO_SIMULATION: Option<Kind> = Some(Kind::CoSimulation);
const MODEL_EXCHANGE: Option<Kind> = Some(Kind::ModelExchange);

calls! {
    // `values.rs` has the footnotes of the standard's tables about variables that may be set in each state. A step is never pending, so
    // fmi2CancelStep is allowed everywhere and returns an error of its own.
    BOTH: fmi2SetDebugLogging fmi2Reset
        fmi2GetFMUstate fmi2SetFMUstate fmi2FreeFMUstate fmi2SerializedFMUstateSize fmi2SerializeFMUstate fmi2DeSerializeFMUstate
        => [Instantiated InitializationMode StepComplete StepFailed EventMode ContinuousTimeMode Terminated];
    CO_SIMULATION: fmi2CancelStep
        => [Instantiated InitializationMode StepComplete StepFailed Terminated];
    BOTH: fmi2SetupExperiment fmi2EnterInitializationMode
        => [Instantiated];
    BOTH: fmi2ExitInitializationMode
        => [InitializationMode];
    BOTH: fmi2Terminate
        => [StepComplete StepFailed EventMode ContinuousTimeMode];
    BOTH: fmi2GetReal fmi2GetInteger fmi2GetBoolean fmi2GetString fmi2GetDirectionalDerivative
        => [InitializationMode StepComplete StepFailed EventMode ContinuousTimeMode Terminated];

    // Beyond the standard, inputs may be set after a discarded step, and the step may be tried again at once: it has been rolled back, and
    // other inputs may let it succeed.
    BOTH: fmi2SetReal
        => [Instantiated InitializationMode StepComplete StepFailed EventMode ContinuousTimeMode];
    BOTH: fmi2SetInteger fmi2SetBoolean fmi2SetString
        => [Instantiated InitializationMode StepComplete StepFailed EventMode];
    CO_SIMULATION: fmi2SetRealInputDerivatives
        => [Instantiated InitializationMode StepComplete StepFailed];
    CO_SIMULATION: fmi2DoStep
        => [StepComplete StepFailed];
    CO_SIMULATION: fmi2GetRealOutputDerivatives
        fmi2GetStatus fmi2GetRealStatus fmi2GetIntegerStatus fmi2GetBooleanStatus fmi2GetStringStatus
        => [StepComplete StepFailed Terminated];

    MODEL_EXCHANGE: fmi2SetTime fmi2EnterEventMode
        => [EventMode ContinuousTimeMode];
    MODEL_EXCHANGE: fmi2NewDiscreteStates fmi2EnterContinuousTimeMode
        => [EventMode];
    MODEL_EXCHANGE: fmi2SetContinuousStates fmi2CompletedIntegratorStep
        => [ContinuousTimeMode];
    MODEL_EXCHANGE: fmi2GetDerivatives
        => [EventMode ContinuousTimeMode Terminated];
    MODEL_EXCHANGE: fmi2GetContinuousStates fmi2GetEventIndicators
        => [InitializationMode EventMode ContinuousTimeMode Terminated];
    MODEL_EXCHANGE: fmi2GetNominalsOfContinuousStates
        => [Instantiated EventMode ContinuousTimeMode Terminated];
}

impl Call {
    /// Refuses the call on an instance of the other kind, or in a stage that does not allow it.
    #[inline(always)]
    pub fn require(self, kind: Kind, stage: Stage) -> Result<(), CallError> {
        let (own, allowed) = self.rule();
        if own.is_some_and(|own| own != kind) {
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
