//! A value of the type of its variable.

use std::fmt::Display;

use anyhow::{Result, bail};
use model_description::{Bounds, Kind, Variable};
use serde_json::Value as Json;

use crate::names::{items, unit};

/// A value as FMI calls pass it: enumerations are integers (FMI 2.0.4, section 2.2.7).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// For fmi2SetReal.
    Real(f64),
    /// For fmi2SetInteger.
    Integer(i32),
    /// For fmi2SetBoolean.
    Boolean(bool),
}

impl Value {
    /// Passes the value to the function of its type.
    pub fn fold<T>(self, real: impl FnOnce(f64) -> T, integer: impl FnOnce(i32) -> T, boolean: impl FnOnce(bool) -> T) -> T {
        match self {
            Self::Real(value) => real(value),
            Self::Integer(value) => integer(value),
            Self::Boolean(value) => boolean(value),
        }
    }

    /// Parses the value of a variable in a file; refuses values of another type, outside the bounds or not among the items.
    pub(crate) fn read(variable: &Variable, given: &Json) -> Result<Self> {
        let (typed, wanted) = match &variable.kind {
            Kind::Real { bounds, .. } => (
                given.as_f64().filter(|&value| within(bounds, value)).map(Self::Real),
                format!("a number in {}{}", unit(variable), limits(bounds)),
            ),
            Kind::Integer { bounds, .. } => {
                let whole = given.as_i64().and_then(|value| i32::try_from(value).ok());
                // If no bound is given, FMI's integers set the bound.
                let bounds = Bounds { min: bounds.min.or(Some(i32::MIN)), max: bounds.max.or(Some(i32::MAX)) };
                (whole.filter(|&value| within(&bounds, value)).map(Self::Integer), format!("a whole number{}", limits(&bounds)))
            }
            Kind::Boolean { .. } => (given.as_bool().map(Self::Boolean), "true or false".into()),
            Kind::Enumeration { .. } => {
                let items = items(variable)?;
                let item = items.iter().find(|item| given.as_str() == Some(&item.name));
                let names: Vec<&str> = items.iter().map(|item| item.name.as_str()).collect();
                (item.map(|item| Self::Integer(item.value)), format!("one of {}", names.join(", ")))
            }
        };
        match typed {
            Some(value) => Ok(value),
            None => bail!("'{}' must be {wanted}, not {given}", variable.name.full),
        }
    }
}

fn within<T: PartialOrd>(bounds: &Bounds<T>, value: T) -> bool {
    bounds.min.as_ref().is_none_or(|min| *min <= value) && bounds.max.as_ref().is_none_or(|max| value <= *max)
}

fn limits<T: Display>(bounds: &Bounds<T>) -> String {
    match bounds {
        Bounds { min: Some(min), max: Some(max) } => format!(" from {min} to {max}"),
        Bounds { min: Some(min), max: None } => format!(" of at least {min}"),
        Bounds { min: None, max: Some(max) } => format!(" of at most {max}"),
        Bounds { min: None, max: None } => String::new(),
    }
}
