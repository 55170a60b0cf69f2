//! Variables ↔ fields of parameters, inputs, samples and counters; bounds of the parameters.
//!
//! For each struct `build.rs` makes a function from a variable to the field with its name: a variable without a field does not compile.
//! `src/fmi/computed.rs` has the other computed variables.

use super::{Inputs, Parameters};
use crate::estimator::Measured;
use crate::integrator::Counters;
use crate::mechanism::SceneError;
use crate::variables::{Input, IntegerComputed, Parameter, Sample, VARIABLES, Value, Variable, VariableId};

include!(concat!(env!("OUT_DIR"), "/bindings.rs"));

/// A field that holds the value of a variable.
pub(crate) trait Field {
    /// Value as FMI calls pass it.
    fn value(&self) -> Value;
    /// Takes a value; returns false if its type is not the field's, or if the enumeration has no such item.
    fn set(&mut self, value: Value) -> bool;
}

impl Field for f64 {
    fn value(&self) -> Value {
        Value::Real(*self)
    }

    fn set(&mut self, value: Value) -> bool {
        let Value::Real(value) = value else { return false };
        *self = value;
        true
    }
}

impl Field for bool {
    fn value(&self) -> Value {
        Value::Boolean(*self)
    }

    fn set(&mut self, value: Value) -> bool {
        let Value::Boolean(value) = value else { return false };
        *self = value;
        true
    }
}

impl Field for u32 {
    fn value(&self) -> Value {
        // The value comes from an i32, or is a start value, which the table stores as an i32.
        Value::Integer(i32::try_from(*self).unwrap_or(i32::MAX))
    }

    fn set(&mut self, value: Value) -> bool {
        let Value::Integer(value) = value else { return false };
        u32::try_from(value).map(|value| *self = value).is_ok()
    }
}

/// Writes a parameter or input; returns false if the value has another type or the variable is neither.
pub fn write(parameters: &mut Parameters, inputs: &mut Inputs, variable: &Variable, value: Value) -> bool {
    match variable.id {
        VariableId::Parameter(id) => parameter_mut(parameters, id).set(value),
        VariableId::Input(id) => input_mut(inputs, id).set(value),
        _ => false,
    }
}

/// Refuses a value that the variable of a parameter does not allow.
fn check(variable: &Variable, field: &impl Field) -> Result<(), SceneError> {
    variable.check(field.value()).map_err(SceneError)
}

/// Every parameter.
pub(crate) fn parameters() -> impl Iterator<Item = (&'static Variable, Parameter)> {
    VARIABLES.iter().filter_map(|variable| match variable.id {
        VariableId::Parameter(id) => Some((variable, id)),
        _ => None,
    })
}

/// Every input.
pub(crate) fn inputs() -> impl Iterator<Item = (&'static Variable, Input)> {
    VARIABLES.iter().filter_map(|variable| match variable.id {
        VariableId::Input(id) => Some((variable, id)),
        _ => None,
    })
}

/// Parameters of a new instance: the start values of the XML.
pub fn default_parameters() -> Parameters {
    let mut all = Parameters::default();
    parameters().for_each(|(variable, id)| start(parameter_mut(&mut all, id), variable));
    all
}

/// Inputs of a new instance: the start values of the XML.
pub fn default_inputs() -> Inputs {
    let mut all = Inputs::default();
    inputs().for_each(|(variable, id)| start(input_mut(&mut all, id), variable));
    all
}

/// Sets a field to the start value of its variable.
fn start(field: &mut dyn Field, variable: &Variable) {
    let written = variable.start.is_some_and(|start| field.set(start));
    debug_assert!(written, "{}: start {:?}", variable.name, variable.start);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variables::{FmiType, Method};

    fn read(parameters: &Parameters, inputs: &Inputs, variable: &Variable) -> Option<Value> {
        match variable.id {
            VariableId::Parameter(id) => Some(parameter(parameters, id).value()),
            VariableId::Input(id) => Some(input(inputs, id).value()),
            VariableId::Sample(id) => Some(sample(&Measured::default(), id).value()),
            _ => None,
        }
    }

    #[test]
    fn starts_are_those_of_the_xml() {
        let (parameters, inputs) = (default_parameters(), default_inputs());
        for variable in VARIABLES {
            assert_eq!(read(&parameters, &inputs, variable), variable.start, "{}", variable.name);
        }
        assert_eq!(parameters.geometry.base_distance, 0.42);
        assert_eq!(parameters.settings.method, Method::I3alp);
    }

    #[test]
    fn what_is_written_is_read_and_nothing_else_changes() {
        let (mut parameters, mut inputs) = (default_parameters(), default_inputs());
        let set_one_by_one = |v: &&Variable| v.start.is_some() && !matches!(v.id, VariableId::Sample(_));
        for variable in VARIABLES.iter().filter(set_one_by_one) {
            let value = match (variable.fmi_type(), variable.items()) {
                (FmiType::Real, _) => Value::Real(0.125),
                (FmiType::Integer, []) => Value::Integer(7),
                (FmiType::Integer, items) => Value::Integer(items[items.len() - 1].value),
                (FmiType::Boolean, _) => Value::Boolean(variable.start != Some(Value::Boolean(true))),
            };
            let before = (parameters.clone(), inputs);
            assert!(write(&mut parameters, &mut inputs, variable, value), "{}", variable.name);
            for other in VARIABLES {
                let expected = if other == variable { Some(value) } else { read(&before.0, &before.1, other) };
                assert_eq!(read(&parameters, &inputs, other), expected, "{} <- {}", other.name, variable.name);
            }
        }
    }

    #[test]
    fn a_number_that_its_variable_does_not_allow_is_refused_in_the_sentence_of_the_variable() {
        let mut all_on = default_parameters();
        let switches = parameters().filter(|(variable, _)| variable.name.ends_with(".enabled"));
        switches.for_each(|(_, id)| assert!(parameter_mut(&mut all_on, id).set(Value::Boolean(true))));
        assert_eq!(check_bounds(&all_on), Ok(()));
        let numbers = parameters().filter(|(variable, _)| variable.items().is_empty() && variable.fmi_type() != FmiType::Boolean);
        for (variable, id) in numbers {
            let is_real = variable.fmi_type() == FmiType::Real;
            let below = variable.min.map(|min| if is_real { Value::Real(min.next_down()) } else { Value::Integer(min as i32 - 1) });
            let above = variable.max.map(|max| if is_real { Value::Real(max.next_up()) } else { Value::Integer(max as i32 + 1) });
            let not_a_number = is_real.then_some(Value::Real(f64::NAN));
            for value in [below, above, not_a_number].into_iter().flatten() {
                let mut changed = all_on.clone();
                // An unsigned count has no values below 0.
                if parameter_mut(&mut changed, id).set(value) {
                    assert_eq!(check_bounds(&changed).map_err(|refusal| refusal.0), variable.check(value), "{}", variable.name);
                    assert!(
                        variable.check(value).is_err_and(|text| text.starts_with(variable.name)),
                        "{} = {value}",
                        variable.name
                    );
                }
            }
        }
    }
}
