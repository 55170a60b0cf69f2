//! The variables, generated from `modelDescription/modelDescription.xml`: only data.
//!
//! `build.rs` writes the constants, the enumerations and the table [`VARIABLES`]; this file defines their types.

use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

include!(concat!(env!("OUT_DIR"), "/variables.rs"));

/// One variable as FMI calls see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variable {
    /// Name.
    pub name: &'static str,
    /// Value reference.
    pub reference: u32,
    /// Role and group of the variable; the bindings match on it.
    pub id: VariableId,
    /// The pair of functions that reads and writes the variable.
    fmi_type: FmiType,
    /// Index of its unit.
    unit: Option<u8>,
    /// Start value, in the variable's unit; computed variables have none.
    pub start: Option<Value>,
    /// Smallest allowed value, in the variable's unit.
    pub min: Option<f64>,
    /// Largest allowed value, in the variable's unit.
    pub max: Option<f64>,
    /// Index of its enumeration.
    enumeration: Option<u8>,
    /// For parameters: whether the value may change during a run.
    pub tunable: bool,
    /// Whether the causality is output rather than local.
    pub output: bool,
}

impl Variable {
    /// Unit of the value and its bounds, for Real variables.
    pub fn unit(&self) -> Option<&'static str> {
        self.unit.map(|place| UNITS[usize::from(place)])
    }

    /// Items of the variable's enumeration; empty for other types.
    pub fn items(&self) -> &'static [Item] {
        self.enumeration.map_or(&[], |place| ENUMERATIONS[usize::from(place)])
    }
}

/// An item of an enumeration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Item {
    /// Name.
    pub name: &'static str,
    /// Number that stands for the item in calls.
    pub value: i32,
}

/// A value in a call; enumerations are passed as integers (FMI 2.0.4, section 2.2.7).
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub enum Value {
    /// fmi2Real.
    Real(f64),
    /// fmi2Integer.
    Integer(i32),
    /// fmi2Boolean.
    Boolean(bool),
}

impl Value {
    /// The type of the value.
    pub fn fmi_type(self) -> FmiType {
        match self {
            Self::Real(_) => FmiType::Real,
            Self::Integer(_) => FmiType::Integer,
            Self::Boolean(_) => FmiType::Boolean,
        }
    }

    /// Whether both values have the same type and bits.
    pub fn same(self, other: Self) -> bool {
        match (self, other) {
            (Self::Real(one), Self::Real(other)) => one.to_bits() == other.to_bits(),
            _ => self == other,
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Real(value) => write!(f, "{value:?}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Boolean(value) => write!(f, "{value}"),
        }
    }
}

/// The pair of functions that reads and writes a variable: fmi2GetReal and fmi2SetReal, and so on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FmiType {
    /// fmi2GetReal, fmi2SetReal.
    Real,
    /// fmi2GetInteger, fmi2SetInteger: integers and enumerations.
    Integer,
    /// fmi2GetBoolean, fmi2SetBoolean.
    Boolean,
}

impl fmt::Display for FmiType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

impl Variable {
    /// Finds the variable with a value reference.
    pub fn find(reference: u32) -> Option<&'static Self> {
        let position = VARIABLES.binary_search_by_key(&reference, |variable| variable.reference).ok()?;
        Some(&VARIABLES[position])
    }

    /// Finds the variable with a name.
    pub fn named(name: &str) -> Option<&'static Self> {
        VARIABLES.iter().find(|variable| variable.name == name)
    }

    /// The pair of functions that reads and writes the variable.
    pub fn fmi_type(&self) -> FmiType {
        self.fmi_type
    }

    /// Index among the continuous states, if the variable is one.
    pub fn state(&self) -> Option<usize> {
        CONTINUOUS_STATES.iter().position(|(_, state)| VariableId::RealComputed(*state) == self.id)
    }

    /// Refuses a value that the variable's type or bounds do not allow, with one sentence. An allowed value allocates nothing: only a
    /// refusal creates text.
    #[inline(always)]
    pub fn check(&self, value: Value) -> Result<(), String> {
        let number = match value {
            Value::Real(x) => x,
            Value::Integer(n) => f64::from(n),
            Value::Boolean(_) => return Ok(()),
        };
        let is_within = self.min.is_none_or(|min| number >= min) && self.max.is_none_or(|max| number <= max);
        let is_item = self.items().is_empty() || self.items().iter().any(|item| Value::Integer(item.value) == value);
        if number.is_finite() && is_within && is_item { Ok(()) } else { Err(self.refusal(value, number)) }
    }

    /// Sentence about a refused value.
    #[cold]
    fn refusal(&self, value: Value, number: f64) -> String {
        let unit = self.unit().filter(|unit| *unit != "1").map(|unit| format!(" {unit}")).unwrap_or_default();
        let items: Vec<String> = self.items().iter().map(|item| format!("{} ({})", item.value, item.name)).collect();
        let allowed = match (self.min, self.max) {
            _ if !number.is_finite() => "finite".to_owned(),
            _ if !items.is_empty() => format!("one of {}", items.join(", ")),
            (Some(min), _) if number < min => format!("at least {}{unit}", shortest(min)),
            (_, max) => format!("at most {}{unit}", shortest(max.unwrap_or(f64::MAX))),
        };
        format!("{} = {value}{unit} is not allowed: it must be {allowed}.", self.name)
    }

    /// Name of the variable's type in the XML.
    pub fn type_name(&self) -> String {
        if self.items().is_empty() { self.fmi_type.to_string() } else { "Enumeration".to_owned() }
    }
}

/// Writes a bound in its shortest form: 0, 100, 1e-9.
fn shortest(bound: f64) -> String {
    let (plain, scientific) = (format!("{bound}"), format!("{bound:e}"));
    if scientific.len() < plain.len() { scientific } else { plain }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sorted_and_found() {
        assert!(VARIABLES.is_sorted_by(|a, b| a.reference < b.reference));
        for variable in VARIABLES {
            assert_eq!(Variable::find(variable.reference), Some(variable));
            assert_eq!(Variable::named(variable.name), Some(variable));
        }
        assert_eq!(Variable::find(0), None);
    }

    #[test]
    fn a_few_entries_are_as_in_the_xml() {
        let tau = Variable::find(101).expect("tau[2]");
        assert_eq!((tau.name, tau.id, tau.unit()), ("tau[2]", VariableId::Input(Input::Tau(1)), Some("N.m")));
        let method = Variable::named("solver.method").expect("solver.method");
        assert_eq!(method.items()[2], Item { name: "rk4", value: 3 });
    }
}
