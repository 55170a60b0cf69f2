//! Derivatives of inputs and outputs with respect to time (FMI 2.0.4, section 4.2.1), and of outputs with respect to inputs and
//! continuous states (section 2.1.9).
//!
//! Input derivatives apply from the beginning of a communication step to its end. After it the input keeps the value reached and its
//! derivatives are 0, so a master sets the derivatives of a ramp at each communication point. The standard defines only the beginning. A
//! discarded step leaves input derivatives unchanged.

use num_dual::Dual64;

use super::computed::real;
use super::values::{check_computed, check_finite, find, lookup};
use super::{CallError, Instance};
use crate::observers::Observed;
use crate::simulation::{Direction, Inputs, ORDERS, Signal, bindings};
use crate::variables::{FmiType, Variable, VariableId};

impl Instance {
    /// fmi2SetRealInputDerivatives: sets (reference, order, value), all or none. Refuses variables that are not Real inputs, orders other
    /// than 1 and 2, and values that are not finite.
    pub fn set_input_derivatives(&mut self, triples: impl Iterator<Item = (u32, i32, f64)>) -> Result<(), CallError> {
        let signal = self.now.signal;
        let mut derivatives = signal.derivatives();
        for (reference, order, value) in triples {
            let variable = lookup(reference, FmiType::Real)?;
            let VariableId::Input(input) = variable.id else {
                return Err(CallError::error(format!(
                    "{} is not a continuous input: only continuous inputs have input derivatives.",
                    variable.name
                )));
            };
            if !(1..=ORDERS as i32).contains(&order) {
                return Err(CallError::error(format!(
                    "order of a derivative of {} is {order}, must be 1 to {ORDERS}; fmi2SetReal sets the input itself.",
                    variable.name
                )));
            }
            let unit = variable.unit().unwrap_or_default();
            check_finite(value, || format!("derivative {order} of {} is {value} {unit}/s^{order}", variable.name))?;
            *bindings::input_mut(&mut derivatives[order as usize - 1], input) = value;
        }
        self.change().signal = Signal::new(signal.value, derivatives);
        Ok(())
    }

    /// fmi2GetRealOutputDerivatives: refused unless every reference is an output with a derivative of this order, and every value is
    /// finite.
    pub fn output_derivatives(&mut self, references: &[u32], orders: &[i32]) -> Result<Vec<f64>, CallError> {
        let observed = self.observe()?;
        let value = |(&reference, &order): (&u32, &i32)| {
            let variable = lookup(reference, FmiType::Real)?;
            let value = time_derivative(&observed, variable, order)?;
            check_computed(|| format!("derivative {order} of {}", variable.name), value)?;
            Ok(value)
        };
        references.iter().zip(orders).map(value).collect()
    }

    /// fmi2GetDirectionalDerivative: changes of the unknowns at the present communication point for changes of the knowns. Unknowns are
    /// outputs and the derivatives of continuous states, which share the references of omega and alpha. Knowns are inputs and continuous
    /// states, passed as (reference, change). Refused unless every reference is right and every value is finite.
    ///
    /// During a run with `servo.delay`, servo references have no immediate effect, so the derivatives with respect to them are 0.
    ///
    /// Beyond the standard, local variables may be unknowns as well. Enumerations, counters, work and `solver.*` have derivative 0.
    pub fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: impl Iterator<Item = (u32, f64)>,
    ) -> Result<Vec<f64>, CallError> {
        let mut direction = Direction::default();
        for (reference, change) in knowns {
            add_known(&mut direction, find(reference)?, change)?;
        }
        for &unknown in unknowns {
            let variable = find(unknown)?;
            if variable.start.is_some() {
                return Err(CallError::error(format!("{} is not an unknown: unknowns are computed variables.", variable.name)));
            }
        }
        let is_running = self.now.scene.is_some();
        let observed = self.observe()?;
        let (model, observation) = (observed.model(), observed.observation());
        if is_running && model.command_delay > 0.0 {
            // After the start, a new reference acts only after the delay.
            direction.inputs = direction.inputs.with_references(&Inputs::default());
        }
        let along = observation.state().varied(model, &direction)?;
        let varied = Observed::<Dual64>::along(model, observation, &along);
        let change = |&unknown: &u32| {
            let variable = find(unknown)?;
            let VariableId::RealComputed(computed) = variable.id else { return Ok(0.0) };
            let change = real(&varied, computed, 0).map_or(0.0, |value| value.eps);
            check_computed(|| format!("change of {}", variable.name), change)?;
            Ok(change)
        };
        unknowns.iter().map(change).collect()
    }
}

/// Refuses input derivatives if they make an input infinite within `size` s.
pub(super) fn check_reach(signal: &Signal, size: f64) -> Result<(), CallError> {
    if signal.is_held() {
        return Ok(());
    }
    let reached = signal.at(size);
    for (variable, input) in bindings::inputs() {
        let (value, unit) = (*bindings::input(&reached, input), variable.unit().unwrap_or_default());
        check_finite(value, || format!("{}, by its derivatives {value} {unit} within {size:?} s", variable.name))?;
    }
    Ok(())
}

/// Adds the change of a known to the direction; refuses variables that are not knowns and changes that are not finite.
fn add_known(direction: &mut Direction, variable: &Variable, change: f64) -> Result<(), CallError> {
    check_finite(change, || format!("change of {} is {change}", variable.name))?;
    let place = match (variable.id, variable.state()) {
        (VariableId::Input(input), _) => bindings::input_mut(&mut direction.inputs, input),
        (_, Some(state)) => &mut direction.proximal.get_or_insert_default().as_flattened_mut()[state],
        _ => {
            return Err(CallError::error(format!(
                "{} is not a known: knowns are inputs and the continuous states theta[i], omega[i].",
                variable.name
            )));
        }
    };
    *place += change;
    Ok(())
}

/// Time derivative of an output; refuses other variables and orders that are not available.
fn time_derivative(observed: &Observed<'_, f64>, variable: &Variable, order: i32) -> Result<f64, CallError> {
    let output = match variable.id {
        VariableId::RealComputed(output) if variable.output => output,
        _ => return Err(CallError::error(format!("{} is not an output: only outputs have output derivatives.", variable.name))),
    };
    let positive = usize::try_from(order).ok().filter(|order| *order > 0);
    positive.and_then(|order| real(observed, output, order)).ok_or_else(|| {
        CallError::error(match (1..=ORDERS).take_while(|order| real(observed, output, *order).is_some()).count() {
            0 => format!("the unit gives no time derivatives of {}, only of positions, angles and their rates.", variable.name),
            1 => format!("order of the derivative of {} is {order}, must be 1.", variable.name),
            most => format!("order of the derivative of {} is {order}, must be 1 to {most}.", variable.name),
        })
    })
}
