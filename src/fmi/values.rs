//! The checks that come before a value is read or written (rules 29 and 30 of this project).

use super::{Rejection, Stage};
use crate::variables::{Access, Slot, Value, Variable};

/// The variable of a reference, where it is one of the function's type.
pub(super) fn lookup(reference: u32, access: Access) -> Result<&'static Variable, Rejection> {
    let variable = Variable::find(reference)
        .ok_or_else(|| Rejection::error(format!("value reference {reference} belongs to no variable.")))?;
    if variable.access() != access {
        return Err(Rejection::error(format!(
            "{} (value reference {reference}) is of type {}, not {access}.",
            variable.name,
            variable.access()
        )));
    }
    Ok(variable)
}

/// Whether a variable may be set in a stage that allows setting: inputs and tunable parameters always, other parameters before
/// the run, outputs never (FMI 2.0.4, section 2.2.7 and footnotes of the table in 4.2.4).
pub(super) fn check_settable(variable: &Variable, stage: Stage) -> Result<(), Rejection> {
    match variable.slot {
        Slot::RealInput(_) => Ok(()),
        _ if variable.tunable => Ok(()),
        Slot::RealParameter(_) | Slot::IntegerParameter(_) | Slot::BooleanParameter(_) | Slot::EnumerationParameter(_) => {
            match stage {
                Stage::Instantiated | Stage::InitializationMode => Ok(()),
                Stage::StepComplete | Stage::StepFailed | Stage::Terminated => Err(Rejection::error(format!(
                    "{} is a fixed parameter and can only be set before fmi2ExitInitializationMode.",
                    variable.name
                ))),
            }
        }
        Slot::RealOutput(_) | Slot::IntegerOutput(_) | Slot::EnumerationOutput(_) => {
            Err(Rejection::error(format!("{} is an output and cannot be set.", variable.name)))
        }
    }
}

/// A variable's own bounds; relations between variables are checked when the scene is made ready.
pub(super) fn check_value(variable: &Variable, value: Value) -> Result<(), Rejection> {
    let number = match value {
        Value::Real(x) => x,
        Value::Integer(n) => f64::from(n),
        Value::Boolean(_) => return Ok(()),
    };
    // Only a refusal makes text: setting an input allocates nothing.
    let unit = || variable.unit.filter(|unit| *unit != "1").map(|unit| format!(" {unit}")).unwrap_or_default();
    let refuse = |allowed: String| {
        Err(Rejection::error(format!("{} = {value}{} is not allowed: it must be {allowed}.", variable.name, unit())))
    };
    if !number.is_finite() {
        return refuse("finite".to_owned());
    }
    if !variable.items.is_empty() && variable.items.iter().all(|item| Value::Integer(item.value) != value) {
        let items: Vec<String> = variable.items.iter().map(|item| format!("{} ({})", item.value, item.name)).collect();
        return refuse(format!("one of {}", items.join(", ")));
    }
    match (variable.min, variable.max) {
        (Some(min), _) if number < min => refuse(format!("at least {}{}", shortest(min), unit())),
        (_, Some(max)) if number > max => refuse(format!("at most {}{}", shortest(max), unit())),
        _ => Ok(()),
    }
}

/// What has been computed is told where it is a number: inputs and parameters that are allowed one by one may be too large together.
pub(super) fn check_computed(name: impl FnOnce() -> String, value: f64) -> Result<(), Rejection> {
    if value.is_finite() {
        return Ok(());
    }
    Err(Rejection::discard(format!(
        "{} = {value} cannot be told: it must be finite; an input or a parameter is too large or too small for double precision.",
        name()
    )))
}

/// A bound in its shortest form: 0, 100, 1e-9.
fn shortest(bound: f64) -> String {
    let (plain, scientific) = (format!("{bound}"), format!("{bound:e}"));
    if scientific.len() < plain.len() { scientific } else { plain }
}
