//! Consistency of a model description (FMI 2.0.4, section 2.2, and rules 6 to 19 of this project).

use std::collections::HashSet;
use std::fmt::Display;

use crate::Error;
use crate::data::{
    Bounds, Causality, Enumeration, Initial, Kind, ModelDescription, SimpleType, TypeKind, Unknown, Variability, Variable,
};

/// Checks all rules; returns the first violation.
pub(crate) fn check(description: &ModelDescription) -> Result<(), Error> {
    unique("unit", description.units.iter().map(|unit| &unit.name))?;
    unique("type", description.types.iter().map(|t| &t.name))?;
    unique("log category", description.categories.iter().map(|category| &category.name))?;
    unique("variable", description.variables.iter().map(|variable| &variable.name.full))?;
    for simple_type in &description.types {
        check_type(description, simple_type)?;
    }
    for variable in &description.variables {
        check_variable(description, variable).map_err(|error| Error(format!("variable {}: {error}", variable.name.full)))?;
    }
    check_families(&description.variables)?;
    check_structure(description)
}

fn unique<'a>(what: &str, names: impl Iterator<Item = &'a String>) -> Result<(), Error> {
    let mut seen = HashSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(Error(format!("{what} {name} is defined twice")));
        }
    }
    Ok(())
}

fn check_type(description: &ModelDescription, simple_type: &SimpleType) -> Result<(), Error> {
    let name = &simple_type.name;
    if description.variables.iter().any(|variable| variable.name.full == *name) {
        return Err(Error(format!("type {name} has the name of a variable")));
    }
    match &simple_type.kind {
        TypeKind::Real { unit, display_unit } => {
            let unit = unit.as_ref().ok_or_else(|| Error(format!("type {name} has no unit")))?;
            let definition = description
                .units
                .iter()
                .find(|definition| definition.name == *unit)
                .ok_or_else(|| Error(format!("type {name}: unit {unit} is not defined")))?;
            match display_unit {
                Some(shown) if !definition.display_units.contains(shown) => {
                    Err(Error(format!("type {name}: {shown} is not a display unit of {unit}")))
                }
                _ => Ok(()),
            }
        }
        TypeKind::Enumeration(Enumeration { items }) => {
            unique(&format!("type {name}: item"), items.iter().map(|item| &item.name))?;
            let values: HashSet<i32> = items.iter().map(|item| item.value).collect();
            if items.is_empty() || values.len() < items.len() {
                return Err(Error(format!("type {name} must have items, each with its own value")));
            }
            Ok(())
        }
        TypeKind::Integer | TypeKind::Boolean => Ok(()),
    }
}

fn check_variable(description: &ModelDescription, variable: &Variable) -> Result<(), Error> {
    if variable.description.is_empty() {
        return Err(Error("the description is empty".to_owned()));
    }
    check_role(variable)?;
    check_declared_type(description, variable)?;
    match (&variable.kind, variable.initial) {
        (kind, Some(Initial::Calculated)) if kind.has_start() => {
            return Err(Error("a calculated variable must not have a start value".to_owned()));
        }
        (kind, None | Some(Initial::Exact)) if !kind.has_start() => {
            return Err(Error("a start value is required".to_owned()));
        }
        (Kind::Real { start, bounds }, _) => {
            let numbers = [*start, bounds.min, bounds.max];
            if !numbers.into_iter().flatten().all(f64::is_finite) {
                return Err(Error("start, min and max must be finite".to_owned()));
            }
            within(*start, *bounds)?;
        }
        (Kind::Integer { start, bounds }, _) => within(*start, *bounds)?,
        (Kind::Boolean { .. } | Kind::Enumeration { .. }, _) => {}
    }
    match &variable.derivative_of {
        Some(state) => check_alias(description, variable, state),
        None => check_reference(description, variable),
    }
}

/// The combinations of FMI 2.0.4, section 2.2.7, that this project uses.
fn check_role(variable: &Variable) -> Result<(), Error> {
    let legal = match (variable.causality, variable.initial) {
        (Causality::Parameter, Some(Initial::Exact)) => matches!(variable.variability, Variability::Fixed | Variability::Tunable),
        (Causality::Input, None) | (Causality::Output | Causality::Local, Some(Initial::Calculated)) => {
            matches!(variable.variability, Variability::Discrete | Variability::Continuous)
        }
        _ => false,
    };
    if !legal {
        return Err(Error(format!(
            "causality {:?}, variability {:?} and initial {:?} do not go together",
            variable.causality, variable.variability, variable.initial
        )));
    }
    if variable.variability == Variability::Continuous && !matches!(variable.kind, Kind::Real { .. }) {
        return Err(Error("only a Real can be continuous".to_owned()));
    }
    // Beyond the standard, outputs must be Real, since some masters read and plot every output as a Real.
    if variable.causality == Causality::Output && !matches!(variable.kind, Kind::Real { .. }) {
        return Err(Error("an output must be a Real; what else is computed is local".to_owned()));
    }
    if variable.is_alias() && variable.causality != Causality::Local {
        return Err(Error("a derivative must be local: it shares the value of another variable".to_owned()));
    }
    Ok(())
}

fn check_declared_type(description: &ModelDescription, variable: &Variable) -> Result<(), Error> {
    let declared = match &variable.declared_type {
        Some(name) => Some(
            description
                .types
                .iter()
                .find(|t| t.name == *name)
                .ok_or_else(|| Error(format!("declaredType {name} is not defined")))?,
        ),
        None => None,
    };
    match (&variable.kind, declared.map(|t| &t.kind)) {
        (Kind::Real { .. }, Some(TypeKind::Real { .. }))
        | (Kind::Integer { .. }, Some(TypeKind::Integer) | None)
        | (Kind::Boolean { .. }, Some(TypeKind::Boolean) | None) => Ok(()),
        (Kind::Enumeration { start }, Some(TypeKind::Enumeration(Enumeration { items }))) => match start {
            Some(value) if items.iter().all(|item| item.value != *value) => {
                Err(Error(format!("start {value} is not an item of its type")))
            }
            _ => Ok(()),
        },
        (kind, None) => Err(Error(format!("a {} needs a declaredType", kind.label()))),
        (kind, Some(_)) => Err(Error(format!("its declaredType is not a type of {}", kind.label()))),
    }
}

fn within<T: PartialOrd + Display + Copy>(start: Option<T>, bounds: Bounds<T>) -> Result<(), Error> {
    if let (Some(min), Some(max)) = (bounds.min, bounds.max)
        && min > max
    {
        return Err(Error(format!("min {min} is larger than max {max}")));
    }
    match start {
        Some(start) if bounds.min.is_some_and(|min| start < min) => Err(Error(format!("start {start} is below its min"))),
        Some(start) if bounds.max.is_some_and(|max| start > max) => Err(Error(format!("start {start} is above its max"))),
        _ => Ok(()),
    }
}

/// Requires that a derivative has the reference and type of another computed variable, and the name of its state.
fn check_alias(description: &ModelDescription, variable: &Variable, state: &str) -> Result<(), Error> {
    if variable.name.full != format!("der({state})") {
        return Err(Error(format!("the derivative of {state} must be named der({state})")));
    }
    let is_state = |v: &Variable| v.name.full == state && v.is_computed() && v.variability == Variability::Continuous;
    if !description.variables.iter().any(is_state) {
        return Err(Error(format!("{state} is not computed and continuous")));
    }
    let original = description.variables.iter().find(|v| !v.is_alias() && v.reference == variable.reference);
    match original {
        Some(original) if !original.is_computed() => {
            Err(Error(format!("reference {} belongs to {}, which is not computed", variable.reference, original.name.full)))
        }
        Some(original) if original.declared_type != variable.declared_type => {
            Err(Error(format!("{} has the same reference and another declaredType", original.name.full)))
        }
        Some(_) => Ok(()),
        None => Err(Error(format!("no other variable has its reference {}", variable.reference))),
    }
}

fn check_reference(description: &ModelDescription, variable: &Variable) -> Result<(), Error> {
    let other =
        description.variables.iter().find(|v| !v.is_alias() && v.reference == variable.reference && v.name != variable.name);
    match other {
        Some(other) => Err(Error(format!("reference {} is also that of {}", variable.reference, other.name.full))),
        None => Ok(()),
    }
}

/// Requires that each family can be one variant of a Rust enum: indices from 1 without a gap, one type, one role.
fn check_families(variables: &[Variable]) -> Result<(), Error> {
    for variable in variables {
        let family = &variable.name.family;
        let members: Vec<&Variable> = variables.iter().filter(|v| v.name.family == *family).collect();
        let mut indices: Vec<Option<usize>> = members.iter().map(|v| v.name.index).collect();
        indices.sort_unstable();
        let counted = indices.iter().enumerate().all(|(position, index)| *index == Some(position));
        if indices != [None] && !counted {
            return Err(Error(format!("variable {}: the indices of {family} must count from 1", variable.name.full)));
        }
        let alike = |v: &&Variable| {
            v.kind.label() == variable.kind.label()
                && v.declared_type == variable.declared_type
                && v.causality == variable.causality
                && v.variability == variable.variability
        };
        if !members.iter().all(alike) {
            return Err(Error(format!(
                "variable {}: all of {family} must have the same type, causality and variability",
                variable.name.full
            )));
        }
    }
    Ok(())
}

fn check_structure(description: &ModelDescription) -> Result<(), Error> {
    let names = |wanted: &dyn Fn(&Variable) -> bool| -> Vec<&str> {
        description.variables.iter().filter(|v| wanted(v)).map(|v| v.name.full.as_str()).collect()
    };
    let structure = &description.structure;
    same("Outputs", &structure.outputs, &names(&|v| v.causality == Causality::Output))?;
    same("Derivatives", &structure.derivatives, &names(&Variable::is_alias))?;
    // FMI 2.0.4, section 2.2.8: outputs, continuous states and their derivatives. There are no calculated parameters.
    let states = description.states();
    let exposed = |v: &Variable| v.causality == Causality::Output || v.is_alias() || states.contains(&v.name.full.as_str());
    same("InitialUnknowns", &structure.initial_unknowns, &names(&exposed))?;
    for unknown in structure.outputs.iter().chain(&structure.derivatives).chain(&structure.initial_unknowns) {
        unique(&format!("variable {}: dependency", unknown.name), unknown.dependencies.iter())?;
    }
    Ok(())
}

/// Requires that a list of the model structure names exactly the expected variables, in the order of the file.
fn same(list: &str, unknowns: &[Unknown], expected: &[&str]) -> Result<(), Error> {
    for position in 0..unknowns.len().max(expected.len()) {
        match (unknowns.get(position).map(|unknown| unknown.name.as_str()), expected.get(position)) {
            (Some(found), Some(wanted)) if found == *wanted => {}
            (found, wanted) => {
                return Err(Error(format!(
                    "ModelStructure {list}, entry {}: variable {}, expected {}",
                    position + 1,
                    found.unwrap_or("(none)"),
                    wanted.unwrap_or(&"(none)")
                )));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
