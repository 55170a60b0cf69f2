//! Checks before a value is read or written (rules 29 and 30 of `docs/notes/fmi.md`).

use super::{CallError, Stage};
use crate::variables::{FmiType, Value, Variable, VariableId};

/// Finds the variable of a value reference; refuses an unknown reference.
#[inline(always)] // 38 instructions less for each input that is set
pub(super) fn find(reference: u32) -> Result<&'static Variable, CallError> {
    Variable::find(reference).ok_or_else(|| CallError::error(format!("value reference {reference} belongs to no variable.")))
}

/// Finds the variable of a value reference; refuses unknown references and variables of another type.
pub(super) fn lookup(reference: u32, fmi_type: FmiType) -> Result<&'static Variable, CallError> {
    let variable = find(reference)?;
    if variable.fmi_type() != fmi_type {
        return Err(CallError::error(format!(
            "{} (value reference {reference}) is of type {}, not {fmi_type}.",
            variable.name,
            variable.type_name()
        )));
    }
    Ok(variable)
}

/// Refuses a variable that may not be set in this stage. Inputs may always be set, parameters before the run, tunable parameters also
/// during it, computed variables never (FMI 2.0.4, section 2.2.7 and footnotes of the table in 4.2.4).
///
/// In model exchange tunable parameters may be set only at events. Beyond the standard, fmi2SetReal sets continuous states as
/// fmi2SetContinuousStates does, since some masters have no other way.
#[inline(always)]
pub(super) fn check_settable(variable: &Variable, stage: Stage) -> Result<(), CallError> {
    let refusal = match variable.id {
        VariableId::Input(_) | VariableId::Sample(_) => return Ok(()),
        VariableId::Parameter(_) if variable.tunable => (stage == Stage::ContinuousTimeMode)
            .then_some("is a tunable parameter and can only be set in event mode, not in continuous-time mode"),
        VariableId::Parameter(_) => (!matches!(stage, Stage::Instantiated | Stage::InitializationMode))
            .then_some("is a fixed parameter and can only be set before fmi2ExitInitializationMode"),
        VariableId::RealComputed(_)
            if variable.state().is_some() && matches!(stage, Stage::EventMode | Stage::ContinuousTimeMode) =>
        {
            None
        }
        VariableId::RealComputed(_) | VariableId::IntegerComputed(_) | VariableId::EnumerationComputed(_) => {
            Some("is computed and cannot be set")
        }
    };
    refusal.map_or(Ok(()), |why| Err(CallError::error(format!("{} {why}.", variable.name))))
}

/// Refuses a value outside the variable's own bounds. Relations between variables are checked when the scene is initialised.
#[inline(always)]
pub(super) fn check_value(variable: &Variable, value: Value) -> Result<(), CallError> {
    // Samples may have any value: the estimator judges them and continues without a rejected one.
    if matches!(variable.id, VariableId::Sample(_)) {
        return Ok(());
    }
    variable.check(value).map_err(CallError::error)
}

/// Refuses a number that is not finite; `what` begins the sentence.
pub(super) fn check_finite(value: f64, what: impl FnOnce() -> String) -> Result<(), CallError> {
    if value.is_finite() { Ok(()) } else { Err(CallError::error(format!("{}, must be finite.", what()))) }
}

/// Discards a computed value that is not finite. Inputs and parameters that are allowed one by one may together be too large.
pub(super) fn check_computed(name: impl FnOnce() -> String, value: f64) -> Result<(), CallError> {
    if value.is_finite() {
        return Ok(());
    }
    Err(CallError::discard(format!(
        "{} = {value} is not available: it must be finite; an input or a parameter is too large or too small for double precision.",
        name()
    )))
}
