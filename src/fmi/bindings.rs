//! Variables ↔ parameters and inputs: one line per variable, the same for reading and writing.
//!
//! The matches are exhaustive over the enums that `build.rs` makes from the XML, so a variable that is not bound here
//! does not compile. Outputs are bound in `outputs.rs`.

use crate::effects::{self, JOINTS};
use crate::mechanism::{self, Geometry, Link, Start};
use crate::simulation::{self, Inputs, Parameters, Settings};
use crate::variables::{
    self, BooleanParameter, EnumerationParameter, IntegerParameter, RealInput, RealParameter, Slot, VARIABLES, Value, Variable,
};

/// The place of a Real parameter.
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
    }
}

/// The place of an Integer parameter.
fn integer_parameter(p: &mut Parameters, variable: IntegerParameter) -> &mut u32 {
    match variable {
        IntegerParameter::SolverMaxIterations => &mut p.settings.max_iterations,
    }
}

/// The place of a Boolean parameter.
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
    }
}

/// The place of an Enumeration parameter.
fn enumeration_parameter(p: &mut Parameters, variable: EnumerationParameter) -> &mut dyn Choice {
    match variable {
        EnumerationParameter::InitAssembly => &mut p.start.assembly,
        EnumerationParameter::SolverMethod => &mut p.settings.method,
    }
}

/// The place of an input.
pub(super) fn real_input(inputs: &mut Inputs, variable: RealInput) -> &mut f64 {
    match variable {
        RealInput::Tau(i) => &mut inputs.tau[i],
        RealInput::TipFx => &mut inputs.tip_force[0],
        RealInput::TipFy => &mut inputs.tip_force[1],
        RealInput::ServoTheta(i) => &mut inputs.servo_theta[i],
        RealInput::ServoOmega(i) => &mut inputs.servo_omega[i],
    }
}

/// A choice of the library, as the number of an item of the XML.
trait Choice {
    fn number(&self) -> i32;
    /// False where no item has that number.
    fn choose(&mut self, number: i32) -> bool;
}

/// Ties a type of the library to the enumeration of the XML whose items have the same names.
macro_rules! choice {
    ($ours:ty = $items:ty { $($name:ident),+ }) => {
        impl Choice for $ours {
            fn number(&self) -> i32 {
                match self { $(Self::$name => <$items>::$name as i32),+ }
            }
            fn choose(&mut self, number: i32) -> bool {
                match <$items>::from_number(number) {
                    $(Some(<$items>::$name) => *self = Self::$name,)+
                    None => return false,
                }
                true
            }
        }
    };
}

choice!(simulation::Method = variables::Method { I3alp, I3alpPrinted, Rk4, Dop853 });
choice!(mechanism::Assembly = variables::Assembly { Plus, Minus });

/// The name of a method as in the XML.
pub(super) fn method_name(method: simulation::Method) -> &'static str {
    let mut items = variables::Method::ITEMS.iter();
    items.find(|item| item.value == method.number()).map_or("", |item| item.name)
}

/// The present value of a parameter or input; `None` for an output.
pub(super) fn read(parameters: &mut Parameters, inputs: &mut Inputs, variable: &Variable) -> Option<Value> {
    Some(match variable.slot {
        Slot::RealParameter(v) => Value::Real(*real_parameter(parameters, v)),
        Slot::RealInput(v) => Value::Real(*real_input(inputs, v)),
        Slot::IntegerParameter(v) => {
            // What was written came from an i32, or is the start value, which the table holds as one.
            Value::Integer(i32::try_from(*integer_parameter(parameters, v)).unwrap_or(i32::MAX))
        }
        Slot::BooleanParameter(v) => Value::Boolean(*boolean_parameter(parameters, v)),
        Slot::EnumerationParameter(v) => Value::Integer(enumeration_parameter(parameters, v).number()),
        Slot::RealOutput(_) | Slot::IntegerOutput(_) | Slot::EnumerationOutput(_) => return None,
    })
}

/// Every parameter and input.
pub(super) fn settable() -> impl Iterator<Item = &'static Variable> {
    VARIABLES.iter().filter(|variable| variable.start.is_some())
}

/// Writes a parameter or input; false where the value is not of its type or the variable is an output.
pub fn write(parameters: &mut Parameters, inputs: &mut Inputs, variable: &Variable, value: Value) -> bool {
    match (variable.slot, value) {
        (Slot::RealParameter(v), Value::Real(x)) => *real_parameter(parameters, v) = x,
        (Slot::RealInput(v), Value::Real(x)) => *real_input(inputs, v) = x,
        (Slot::IntegerParameter(v), Value::Integer(n)) => match u32::try_from(n) {
            Ok(n) => *integer_parameter(parameters, v) = n,
            Err(_) => return false,
        },
        (Slot::BooleanParameter(v), Value::Boolean(b)) => *boolean_parameter(parameters, v) = b,
        (Slot::EnumerationParameter(v), Value::Integer(n)) => {
            return enumeration_parameter(parameters, v).choose(n);
        }
        _ => return false,
    }
    true
}

/// The scene that a fresh instance has: the start values of the XML.
pub fn default_parameters() -> Parameters {
    starts().0
}

/// The inputs that a fresh instance has: the start values of the XML.
pub fn default_inputs() -> Inputs {
    starts().1
}

fn starts() -> (Parameters, Inputs) {
    // Every value below is overwritten by the loop: the XML is the one place where starts stand.
    let link = Link { length: f64::NAN, mass: f64::NAN, inertia: f64::NAN, com: f64::NAN };
    let mut parameters = Parameters {
        geometry: Geometry { base_distance: f64::NAN, links: [link; 4] },
        start: Start { theta: [f64::NAN; 2], omega: [f64::NAN; 2], assembly: mechanism::Assembly::Plus },
        settings: Settings {
            method: simulation::Method::I3alp,
            step_size: f64::NAN,
            adaptive: false,
            error_tolerance: f64::NAN,
            tolerance: f64::NAN,
            max_iterations: 0,
            penalty: f64::NAN,
            penalty_scale: f64::NAN,
        },
        effects: effects::Parameters {
            rotor: effects::rotor::Parameters { enabled: false, inertia: [f64::NAN; 2], gear_ratio: [f64::NAN; 2] },
            payload: effects::payload::Parameters { enabled: false, mass: f64::NAN },
            gravity: effects::gravity::Parameters { enabled: false, g: f64::NAN, tilt: f64::NAN, direction: f64::NAN },
            viscous: effects::viscous::Parameters { enabled: false, b: [f64::NAN; JOINTS] },
            friction: effects::friction::Parameters {
                enabled: false,
                coulomb: [f64::NAN; JOINTS],
                breakaway: [f64::NAN; JOINTS],
                breakaway_velocity: f64::NAN,
            },
            spring: effects::spring::Parameters { enabled: false, k: [f64::NAN; 2], theta0: [f64::NAN; 2] },
            stop: effects::stop::Parameters {
                enabled: false,
                lower: [f64::NAN; 2],
                upper: [f64::NAN; 2],
                k: f64::NAN,
                d: f64::NAN,
                width: f64::NAN,
            },
            contact: effects::contact::Parameters {
                enabled: false,
                nx: f64::NAN,
                ny: f64::NAN,
                offset: f64::NAN,
                k: f64::NAN,
                d: f64::NAN,
                width: f64::NAN,
                mu: f64::NAN,
                slip_velocity: f64::NAN,
            },
            servo: effects::servo::Parameters { enabled: false, kp: [f64::NAN; 2], kd: [f64::NAN; 2], limit: [f64::NAN; 2] },
        },
    };
    let nan = [f64::NAN; 2];
    let mut inputs = Inputs { tau: nan, tip_force: nan, servo_theta: nan, servo_omega: nan };
    for variable in VARIABLES {
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
    use crate::variables::Access;

    #[test]
    fn starts_are_those_of_the_xml() {
        let (mut parameters, mut inputs) = starts();
        for variable in VARIABLES {
            assert_eq!(read(&mut parameters, &mut inputs, variable), variable.start, "{}", variable.name);
        }
        assert_eq!(parameters.geometry.base_distance, 0.42);
        assert_eq!(parameters.settings.method, simulation::Method::I3alp);
    }

    #[test]
    fn what_is_written_is_read_and_nothing_else_changes() {
        let (mut parameters, mut inputs) = starts();
        for variable in VARIABLES.iter().filter(|variable| variable.start.is_some()) {
            let value = match (variable.access(), variable.items) {
                (Access::Real, _) => Value::Real(0.125),
                (Access::Integer, []) => Value::Integer(7),
                (Access::Integer, items) => Value::Integer(items[items.len() - 1].value),
                (Access::Boolean, _) => Value::Boolean(variable.start != Some(Value::Boolean(true))),
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
