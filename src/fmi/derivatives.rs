//! Derivatives of inputs and outputs with respect to time (FMI 2.0.4, section 4.2.1), and of outputs with respect to inputs and
//! continuous states (section 2.1.9).
//!
//! Input derivatives hold from the beginning of one communication step to its end, where the input stays at the value that it has
//! reached and its derivatives are 0: a master that goes on with a ramp sets them at each communication point. The standard fixes
//! the beginning and leaves the end open. After a discarded step they are as before it.

use std::cell::OnceCell;

use super::outputs::{DISTAL, PROXIMAL};
use super::values::{check_computed, check_settable, lookup};
use super::{Instance, Rejection, bindings};
use crate::observers::{self, Motion, OutputChanges};
use crate::simulation::{Direction, ORDERS, Signal};
use crate::variables::{Access, RealOutput, Slot, VARIABLES, Value, Variable};

impl Instance {
    /// fmi2SetRealInputDerivatives: (reference, order, value), all or none.
    pub fn set_input_derivatives(&mut self, triples: impl Iterator<Item = (u32, i32, f64)> + Clone) -> Result<(), Rejection> {
        for (reference, order, value) in triples.clone() {
            let variable = lookup(reference, Access::Real)?;
            let Slot::RealInput(_) = variable.slot else {
                return Err(Rejection::error(format!("{} is no input: only inputs have input derivatives.", variable.name)));
            };
            check_settable(variable, self.now.stage)?;
            if !(1..=ORDERS as i32).contains(&order) {
                return Err(Rejection::error(format!(
                    "order of a derivative of {} is {order}, must be 1 to {ORDERS}; its value is set by fmi2SetReal.",
                    variable.name
                )));
            }
            if !value.is_finite() {
                return Err(Rejection::error(format!(
                    "derivative {order} of {} is {value} {}/s^{order}, must be finite.",
                    variable.name,
                    variable.unit.unwrap_or_default()
                )));
            }
        }
        let mut derivatives = self.now.signal.derivatives();
        for (reference, order, value) in triples {
            let derivative = &mut derivatives[order as usize - 1];
            if !bindings::write(&mut self.now.parameters, derivative, lookup(reference, Access::Real)?, Value::Real(value)) {
                unreachable!("derivative {order} of value reference {reference} has been checked");
            }
        }
        self.now.signal = Signal::new(self.now.signal.value, derivatives);
        Ok(())
    }

    /// fmi2GetRealOutputDerivatives: hands each value with its position to `take`; nothing is handed over unless every reference
    /// and order is right and every value finite.
    pub fn output_derivatives(
        &mut self,
        references: &[u32],
        orders: &[i32],
        mut take: impl FnMut(usize, f64),
    ) -> Result<(), Rejection> {
        let outputs = self.outputs()?;
        let value = |(&reference, &order): (&u32, &i32)| {
            let variable = lookup(reference, Access::Real)?;
            let value = time_derivative(outputs.motion(), variable, order)?;
            check_computed(|| format!("derivative {order} of {}", variable.name), value)?;
            Ok(value)
        };
        let values = references.iter().zip(orders).map(value).collect::<Result<Vec<f64>, Rejection>>()?;
        for (position, value) in values.into_iter().enumerate() {
            take(position, value);
        }
        Ok(())
    }

    /// fmi2GetDirectionalDerivative: how unknowns (outputs and derivatives of the continuous states, which share references with outputs)
    /// change with knowns (inputs and continuous states: reference, change) at the present communication point. Hands each change with its
    /// position to `take`; nothing is handed over unless every reference is right and every value finite.
    ///
    /// What is only counted, judged or followed along the path (enumerations, counters, work, `solver.*`) does not change.
    pub fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: impl Iterator<Item = (u32, f64)>,
        mut take: impl FnMut(usize, f64),
    ) -> Result<(), Rejection> {
        let mut direction = Direction::default();
        for (reference, change) in knowns {
            add_known(&mut direction, find(reference)?, change)?;
        }
        for &unknown in unknowns {
            let variable = find(unknown)?;
            if variable.start.is_some() {
                return Err(Rejection::error(format!("{} is no unknown: outputs and derivatives of states are.", variable.name)));
            }
        }
        let outputs = self.outputs()?;
        let (model, state) = (outputs.simulation.model(), outputs.state());
        let along = state.varied(model, &direction)?;
        let changes = observers::output_changes(model, state, &along);
        let sigma_phi = OnceCell::new();
        let change = |&unknown: &u32| {
            let variable = find(unknown)?;
            let Slot::RealOutput(output) = variable.slot else { return Ok(0.0) };
            let sigma_phi_change = || *sigma_phi.get_or_init(|| observers::sigma_phi_change(model, state, &along));
            let change = output_change(&changes, output, sigma_phi_change);
            check_computed(|| format!("change of {}", variable.name), change)?;
            Ok(change)
        };
        let values = unknowns.iter().map(change).collect::<Result<Vec<f64>, Rejection>>()?;
        for (position, change) in values.into_iter().enumerate() {
            take(position, change);
        }
        Ok(())
    }
}

/// Refuses inputs whose derivatives lead to values that are not finite within `size` seconds.
pub(super) fn check_reach(signal: &Signal, size: f64) -> Result<(), Rejection> {
    let mut reached = signal.at(size);
    for variable in VARIABLES {
        let Slot::RealInput(input) = variable.slot else { continue };
        let value = *bindings::real_input(&mut reached, input);
        if !value.is_finite() {
            return Err(Rejection::error(format!(
                "{} would become {value} {} within {size:?} s by its derivatives, must stay finite.",
                variable.name,
                variable.unit.unwrap_or_default()
            )));
        }
    }
    Ok(())
}

fn find(reference: u32) -> Result<&'static Variable, Rejection> {
    Variable::find(reference).ok_or_else(|| Rejection::error(format!("value reference {reference} belongs to no variable.")))
}

/// Adds the change of a known.
fn add_known(direction: &mut Direction, variable: &Variable, change: f64) -> Result<(), Rejection> {
    if !change.is_finite() {
        return Err(Rejection::error(format!("change of {} is {change}, must be finite.", variable.name)));
    }
    let place = match variable.slot {
        Slot::RealInput(input) => bindings::real_input(&mut direction.inputs, input),
        Slot::RealOutput(RealOutput::Theta(i)) => &mut direction.proximal.get_or_insert_default()[0][i],
        Slot::RealOutput(RealOutput::Omega(i)) => &mut direction.proximal.get_or_insert_default()[1][i],
        _ => {
            return Err(Rejection::error(format!(
                "{} is no known: inputs and the continuous states theta[i], omega[i] are.",
                variable.name
            )));
        }
    };
    *place += change;
    Ok(())
}

/// The change of an output.
fn output_change(changes: &OutputChanges, output: RealOutput, sigma_phi: impl FnOnce() -> f64) -> f64 {
    use RealOutput as V;
    let OutputChanges { motion, reactions, singularity, .. } = changes;
    match output {
        V::Theta(i) => motion.theta[PROXIMAL[i]],
        V::Omega(i) => motion.omega[PROXIMAL[i]],
        V::Alpha(i) => motion.alpha[PROXIMAL[i]],
        V::PassiveTheta(i) => motion.theta[DISTAL[i]],
        V::PassiveOmega(i) => motion.omega[DISTAL[i]],
        V::TipX => motion.tip.x,
        V::TipY => motion.tip.y,
        V::TipVx => motion.tip_velocity.x,
        V::TipVy => motion.tip_velocity.y,
        V::TipAx => motion.tip_acceleration.x,
        V::TipAy => motion.tip_acceleration.y,
        V::ElbowX(i) => motion.elbows[i].x,
        V::ElbowY(i) => motion.elbows[i].y,
        V::ReactionFx(i) => reactions[i].x,
        V::ReactionFy(i) => reactions[i].y,
        V::EnergyKinetic => changes.kinetic,
        V::EnergyPotential => changes.potential,
        V::EnergyError => changes.kinetic + changes.potential,
        V::ServoTorque(i) => changes.servo_torques[i],
        V::ContactFx => changes.contact_force.x,
        V::ContactFy => changes.contact_force.y,
        V::SingularDetJx => singularity.det_jx,
        V::SingularDetJq => singularity.det_jq,
        V::SingularSigmaJx => singularity.sigma_jx,
        V::SingularSigmaJq => singularity.sigma_jq,
        V::SingularSigmaPhi => sigma_phi(),
        V::EnergyInput | V::EnergyDissipated | V::SolverPositionError | V::SolverVelocityError | V::SolverErrorEstimate => 0.0,
    }
}

/// The derivatives of an output that velocities and accelerations give, by order from 1.
fn time_derivative(motion: &Motion, variable: &Variable, order: i32) -> Result<f64, Rejection> {
    use RealOutput as V;
    let known: &[f64] = match variable.slot {
        Slot::RealOutput(output) => match output {
            V::Theta(i) => &[motion.omega[PROXIMAL[i]], motion.alpha[PROXIMAL[i]]],
            V::Omega(i) => &[motion.alpha[PROXIMAL[i]]],
            V::PassiveTheta(i) => &[motion.omega[DISTAL[i]], motion.alpha[DISTAL[i]]],
            V::PassiveOmega(i) => &[motion.alpha[DISTAL[i]]],
            V::TipX => &[motion.tip_velocity.x, motion.tip_acceleration.x],
            V::TipY => &[motion.tip_velocity.y, motion.tip_acceleration.y],
            V::TipVx => &[motion.tip_acceleration.x],
            V::TipVy => &[motion.tip_acceleration.y],
            V::ElbowX(i) => &[motion.elbow_velocities[i].x, motion.elbow_accelerations[i].x],
            V::ElbowY(i) => &[motion.elbow_velocities[i].y, motion.elbow_accelerations[i].y],
            _ => &[],
        },
        _ => return Err(Rejection::error(format!("{} is no output: only outputs have output derivatives.", variable.name))),
    };
    let found = usize::try_from(order).ok().and_then(|order| known.get(order.checked_sub(1)?));
    found.copied().ok_or_else(|| {
        Rejection::error(match known.len() {
            0 => format!("{} has no derivatives with respect to time here: positions, angles and their rates do.", variable.name),
            1 => format!("order of the derivative of {} is {order}, must be 1.", variable.name),
            most => format!("order of the derivative of {} is {order}, must be 1 to {most}.", variable.name),
        })
    })
}
