//! Variables ↔ parameters and inputs: one match arm per variable for reading and writing.
//!
//! The matches are exhaustive over the enums that `build.rs` makes from the XML, so a variable that is not bound here
//! does not compile. Computed variables are bound in `computed.rs`.

use crate::effects::{self, payload};
use crate::estimator::{self, Measured};
use crate::mechanism;
use crate::simulation::{self, Inputs, Parameters};
use crate::variables::{
    self, BooleanParameter, EnumerationParameter, IntegerParameter, RealInput, RealParameter, RealSample, VARIABLES, Value,
    Variable, VariableId,
};

/// Field of a Real parameter.
fn real_parameter(p: &mut Parameters, variable: RealParameter) -> &mut f64 {
    use RealParameter as V;
    let effects = &mut p.effects;
    match variable {
        V::BaseDistance => &mut p.geometry.base_distance,
        V::LinkLength(i) => &mut p.geometry.links[i].length,
        V::LinkMass(i) => &mut p.geometry.links[i].mass,
        V::LinkInertia(i) => &mut p.geometry.links[i].inertia,
        V::LinkCom(i) => &mut p.geometry.links[i].com,
        V::InitTheta(i) => &mut p.start.theta[i],
        V::InitOmega(i) => &mut p.start.omega[i],
        V::SolverStepSize => &mut p.settings.step_size,
        V::SolverErrorTolerance => &mut p.settings.error_tolerance,
        V::SolverTolerance => &mut p.settings.tolerance,
        V::SolverPenalty => &mut p.settings.penalty,
        V::SolverPenaltyScale => &mut p.settings.penalty_scale,
        V::GravityG => &mut effects.gravity.g,
        V::GravityTilt => &mut effects.gravity.tilt,
        V::GravityDirection => &mut effects.gravity.direction,
        V::RotorInertia(i) => &mut effects.rotor.inertia[i],
        V::RotorGearRatio(i) => &mut effects.rotor.gear_ratio[i],
        V::PayloadMass => &mut effects.payload.mass,
        V::ViscousB(i) => &mut effects.viscous.b[i],
        V::FrictionCoulomb(i) => &mut effects.friction.coulomb[i],
        V::FrictionBreakaway(i) => &mut effects.friction.breakaway[i],
        V::FrictionBreakawayVelocity => &mut effects.friction.breakaway_velocity,
        V::SpringK(i) => &mut effects.spring.k[i],
        V::SpringTheta0(i) => &mut effects.spring.theta0[i],
        V::StopLower(i) => &mut effects.stop.lower[i],
        V::StopUpper(i) => &mut effects.stop.upper[i],
        V::StopK => &mut effects.stop.k,
        V::StopD => &mut effects.stop.d,
        V::StopWidth => &mut effects.stop.width,
        V::ContactNx => &mut effects.contact.nx,
        V::ContactNy => &mut effects.contact.ny,
        V::ContactOffset => &mut effects.contact.offset,
        V::ContactK => &mut effects.contact.k,
        V::ContactD => &mut effects.contact.d,
        V::ContactWidth => &mut effects.contact.width,
        V::ContactMu => &mut effects.contact.mu,
        V::ContactSlipVelocity => &mut effects.contact.slip_velocity,
        V::ServoKp(i) => &mut effects.servo.kp[i],
        V::ServoKd(i) => &mut effects.servo.kd[i],
        V::ServoLimit(i) => &mut effects.servo.limit[i],
        V::EstimatorSigma(i) => &mut p.estimator.sigma[i],
        V::EstimatorQuantum(i) => &mut p.estimator.quantum[i],
        V::EstimatorMaxDelay => &mut p.estimator.max_delay,
        V::EstimatorSigma0Theta => &mut p.estimator.sigma0_theta,
        V::EstimatorSigma0Omega => &mut p.estimator.sigma0_omega,
        V::EstimatorSigma0Length => &mut p.estimator.sigma0_length,
        V::EstimatorTorqueScale => &mut p.estimator.torque_scale,
        V::EstimatorSwitchTime => &mut p.estimator.switch_time,
        V::EstimatorHorizon => &mut p.estimator.horizon,
    }
}

/// Field of an Integer parameter.
fn integer_parameter(p: &mut Parameters, variable: IntegerParameter) -> &mut u32 {
    match variable {
        IntegerParameter::SolverMaxIterations => &mut p.settings.max_iterations,
        IntegerParameter::SolverMaxWork => &mut p.settings.max_work,
    }
}

/// Field of a Boolean parameter.
fn boolean_parameter(p: &mut Parameters, variable: BooleanParameter) -> &mut bool {
    match variable {
        BooleanParameter::SolverAdaptive => &mut p.settings.adaptive,
        BooleanParameter::GravityEnabled => &mut p.effects.gravity.enabled,
        BooleanParameter::RotorEnabled => &mut p.effects.rotor.enabled,
        BooleanParameter::PayloadEnabled => &mut p.effects.payload.enabled,
        BooleanParameter::ViscousEnabled => &mut p.effects.viscous.enabled,
        BooleanParameter::FrictionEnabled => &mut p.effects.friction.enabled,
        BooleanParameter::SpringEnabled => &mut p.effects.spring.enabled,
        BooleanParameter::StopEnabled => &mut p.effects.stop.enabled,
        BooleanParameter::ContactEnabled => &mut p.effects.contact.enabled,
        BooleanParameter::ServoEnabled => &mut p.effects.servo.enabled,
        BooleanParameter::EstimatorEnabled => &mut p.estimator.enabled,
    }
}

/// Field of an Enumeration parameter.
fn enumeration_parameter(p: &mut Parameters, variable: EnumerationParameter) -> &mut dyn XmlEnumeration {
    match variable {
        EnumerationParameter::InitAssembly => &mut p.start.assembly,
        EnumerationParameter::SolverMethod => &mut p.settings.method,
        EnumerationParameter::PayloadJoin => &mut p.effects.payload.join,
        EnumerationParameter::FrictionLaw => &mut p.effects.friction.law,
        EnumerationParameter::ContactLaw => &mut p.effects.contact.law,
        EnumerationParameter::EstimatorForecast => &mut p.estimator.forecast,
    }
}

/// Field of an input.
pub(super) fn real_input(inputs: &mut Inputs, variable: RealInput) -> &mut f64 {
    match variable {
        RealInput::Tau(i) => &mut inputs.tau[i],
        RealInput::TipFx => &mut inputs.tip_force[0],
        RealInput::TipFy => &mut inputs.tip_force[1],
        RealInput::ServoTheta(i) => &mut inputs.servo_theta[i],
        RealInput::ServoOmega(i) => &mut inputs.servo_omega[i],
    }
}

/// Field of a sample.
pub(super) fn real_sample(measured: &mut Measured, variable: RealSample) -> &mut f64 {
    match variable {
        RealSample::MeasuredTheta(i) => &mut measured.theta[i],
        RealSample::MeasuredTime(i) => &mut measured.time[i],
    }
}

/// An enumeration of the library whose items have numbers in the XML.
trait XmlEnumeration {
    fn number(&self) -> i32;
    /// False where no item has that number.
    fn set_number(&mut self, number: i32) -> bool;
}

/// Ties a type of the library to the enumeration of the XML whose items have the same names.
macro_rules! xml_enumeration {
    ($ours:ty = $items:ty { $($name:ident),+ }) => {
        impl XmlEnumeration for $ours {
            fn number(&self) -> i32 {
                match self { $(Self::$name => <$items>::$name as i32),+ }
            }
            fn set_number(&mut self, number: i32) -> bool {
                match <$items>::from_number(number) {
                    $(Some(<$items>::$name) => *self = Self::$name,)+
                    None => return false,
                }
                true
            }
        }
    };
}

xml_enumeration!(simulation::Method = variables::Method { I3alp, I3alpPrinted, Rk4, Dop853, I3alpConserving, Automatic });
xml_enumeration!(payload::Join = variables::Join { AtRest, WithTip });
xml_enumeration!(estimator::Bands = variables::Bands { Linear, SigmaPoints });
xml_enumeration!(mechanism::Assembly = variables::Assembly { Plus, Minus });
xml_enumeration!(effects::Law = variables::Law { Smooth, Stick });

/// The name of a method as in the XML.
pub(super) fn method_name(method: simulation::Method) -> &'static str {
    let mut items = variables::Method::ITEMS.iter();
    items.find(|item| item.value == method.number()).map_or("", |item| item.name)
}

/// The present value of a parameter; `None` for any other variable.
pub(super) fn read_parameter(parameters: &mut Parameters, variable: &Variable) -> Option<Value> {
    Some(match variable.id {
        VariableId::RealParameter(v) => Value::Real(*real_parameter(parameters, v)),
        VariableId::IntegerParameter(v) => {
            // A value was written from an i32 or is the start value, which the table holds as one.
            Value::Integer(i32::try_from(*integer_parameter(parameters, v)).unwrap_or(i32::MAX))
        }
        VariableId::BooleanParameter(v) => Value::Boolean(*boolean_parameter(parameters, v)),
        VariableId::EnumerationParameter(v) => Value::Integer(enumeration_parameter(parameters, v).number()),
        VariableId::RealInput(_)
        | VariableId::RealSample(_)
        | VariableId::RealComputed(_)
        | VariableId::IntegerComputed(_)
        | VariableId::EnumerationComputed(_) => {
            return None;
        }
    })
}

/// Writes a parameter; false where the value is not of its type or the variable is none.
pub(super) fn write_parameter(parameters: &mut Parameters, variable: &Variable, value: Value) -> bool {
    match (variable.id, value) {
        (VariableId::RealParameter(v), Value::Real(x)) => *real_parameter(parameters, v) = x,
        (VariableId::IntegerParameter(v), Value::Integer(n)) => match u32::try_from(n) {
            Ok(n) => *integer_parameter(parameters, v) = n,
            Err(_) => return false,
        },
        (VariableId::BooleanParameter(v), Value::Boolean(b)) => *boolean_parameter(parameters, v) = b,
        (VariableId::EnumerationParameter(v), Value::Integer(n)) => return enumeration_parameter(parameters, v).set_number(n),
        _ => return false,
    }
    true
}

/// Writes a parameter or input; false where the value is not of its type or the variable is computed.
pub fn write(parameters: &mut Parameters, inputs: &mut Inputs, variable: &Variable, value: Value) -> bool {
    if let (VariableId::RealInput(input), Value::Real(x)) = (variable.id, value) {
        *real_input(inputs, input) = x;
        return true;
    }
    write_parameter(parameters, variable, value)
}

/// Every parameter.
pub(super) fn parameters() -> impl Iterator<Item = &'static Variable> {
    let set_by_master = |id| matches!(id, VariableId::RealInput(_) | VariableId::RealSample(_));
    VARIABLES.iter().filter(move |variable| variable.start.is_some() && !set_by_master(variable.id))
}

/// Every input.
pub(super) fn inputs() -> impl Iterator<Item = (&'static Variable, RealInput)> {
    VARIABLES.iter().filter_map(|variable| match variable.id {
        VariableId::RealInput(input) => Some((variable, input)),
        _ => None,
    })
}

/// The scene that a fresh instance has: the start values of the XML.
pub fn default_parameters() -> Parameters {
    start_values().0
}

/// The inputs that a fresh instance has: the start values of the XML.
pub fn default_inputs() -> Inputs {
    start_values().1
}

fn start_values() -> (Parameters, Inputs) {
    let (mut parameters, mut inputs) = Default::default();
    for variable in VARIABLES {
        // Nothing has been measured: `Measured::default`.
        if matches!(variable.id, VariableId::RealSample(_)) {
            continue;
        }
        if let Some(start) = variable.start {
            let written = write(&mut parameters, &mut inputs, variable, start);
            debug_assert!(written, "{}: start {start}", variable.name);
        }
    }
    (parameters, inputs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variables::FmiType;

    fn read(parameters: &mut Parameters, inputs: &mut Inputs, variable: &Variable) -> Option<Value> {
        match variable.id {
            VariableId::RealInput(input) => Some(Value::Real(*real_input(inputs, input))),
            VariableId::RealSample(sample) => Some(Value::Real(*real_sample(&mut Measured::default(), sample))),
            _ => read_parameter(parameters, variable),
        }
    }

    #[test]
    fn starts_are_those_of_the_xml() {
        let (mut parameters, mut inputs) = start_values();
        for variable in VARIABLES {
            assert_eq!(read(&mut parameters, &mut inputs, variable), variable.start, "{}", variable.name);
        }
        assert_eq!(parameters.geometry.base_distance, 0.42);
        assert_eq!(parameters.settings.method, simulation::Method::I3alp);
    }

    #[test]
    fn what_is_written_is_read_and_nothing_else_changes() {
        let (mut parameters, mut inputs) = start_values();
        let set_one_by_one = |v: &&Variable| v.start.is_some() && !matches!(v.id, VariableId::RealSample(_));
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
                let expected =
                    if other == variable { Some(value) } else { read(&mut before.0.clone(), &mut before.1.clone(), other) };
                assert_eq!(read(&mut parameters, &mut inputs, other), expected, "{} <- {}", other.name, variable.name);
            }
        }
    }
}
