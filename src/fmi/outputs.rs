//! Variables ← observers: what each output is, once for its value, its changes and its derivatives with respect to time.

use crate::mechanism;
use crate::observers::{self, Observed, Point, SingularityKind as Kind};
use crate::scalar::Scalar;
use crate::variables::{
    Assembly, EnumerationOutput, IntegerOutput, RealOutput, SingularityKind, Value, Variable, VariableId, WorkingMode,
};

/// Links of the left and the right leg.
const PROXIMAL_LINKS: [usize; 2] = [0, 3];
const DISTAL_LINKS: [usize; 2] = [1, 2];

/// The value of an output; `None` for any other variable.
pub(super) fn read(of: &Observed<'_, f64>, variable: &Variable) -> Option<Value> {
    match variable.id {
        VariableId::RealOutput(output) => real(of, output, 0).map(Value::Real),
        VariableId::IntegerOutput(output) => Some(Value::Integer(integer(of, output))),
        VariableId::EnumerationOutput(output) => Some(Value::Integer(enumeration(of, output))),
        VariableId::RealParameter(_)
        | VariableId::RealInput(_)
        | VariableId::IntegerParameter(_)
        | VariableId::BooleanParameter(_)
        | VariableId::EnumerationParameter(_) => None,
    }
}

/// An output, or its derivative of an order with respect to time; `None` where that is not known. The value, order 0, always is.
pub(super) fn real<T: Scalar>(of: &Observed<'_, T>, output: RealOutput, order: usize) -> Option<T> {
    use RealOutput as V;
    // Positions, velocities and accelerations are known: orders 0, 1 and 2 of a motion.
    let order_of = |own: usize| Some(own + order).filter(|order| *order <= 2);
    Some(match output {
        V::Theta(i) => of.angle(PROXIMAL_LINKS[i], order_of(0)?),
        V::Omega(i) => of.angle(PROXIMAL_LINKS[i], order_of(1)?),
        V::Alpha(i) => of.angle(PROXIMAL_LINKS[i], order_of(2)?),
        V::PassiveTheta(i) => of.angle(DISTAL_LINKS[i], order_of(0)?),
        V::PassiveOmega(i) => of.angle(DISTAL_LINKS[i], order_of(1)?),
        V::TipX => of.point(Point::Tip, order_of(0)?)[0],
        V::TipY => of.point(Point::Tip, order_of(0)?)[1],
        V::TipVx => of.point(Point::Tip, order_of(1)?)[0],
        V::TipVy => of.point(Point::Tip, order_of(1)?)[1],
        V::TipAx => of.point(Point::Tip, order_of(2)?)[0],
        V::TipAy => of.point(Point::Tip, order_of(2)?)[1],
        V::ElbowX(i) => of.point(Point::Elbow(i), order_of(0)?)[0],
        V::ElbowY(i) => of.point(Point::Elbow(i), order_of(0)?)[1],
        _ if order > 0 => return None,
        V::ReactionFx(i) => of.reaction(i)[0],
        V::ReactionFy(i) => of.reaction(i)[1],
        V::EnergyKinetic => of.kinetic_energy(),
        V::EnergyPotential => of.potential_energy(),
        V::EnergyError => of.energy_error(),
        V::EnergyInput => of.constant(of.observation().state().core.work.input),
        V::EnergyDissipated => of.constant(of.observation().state().core.work.dissipated),
        V::ServoTorque(i) => of.servo_torques()[i],
        V::ContactFx => of.contact_force()[0],
        V::ContactFy => of.contact_force()[1],
        V::SingularDetJx => of.jacobians().det_jx,
        V::SingularDetJq => of.jacobians().det_jq,
        V::SingularSigmaJx => of.jacobians().sigma_jx,
        V::SingularSigmaJq => of.jacobians().sigma_jq,
        V::SingularSigmaPhi => of.sigma_phi(),
        V::SolverPositionError => of.constant(observers::constraint_norms(of.model(), of.observation().state()).position),
        V::SolverVelocityError => of.constant(observers::constraint_norms(of.model(), of.observation().state()).velocity),
        V::SolverErrorEstimate => of.constant(of.observation().state().core.error_estimate),
    })
}

fn integer(of: &Observed<'_, f64>, output: IntegerOutput) -> i32 {
    let counters = of.observation().state().core.counters;
    let count = match output {
        IntegerOutput::SolverSteps => counters.steps,
        IntegerOutput::SolverSubsteps => counters.substeps,
        IntegerOutput::SolverIterations => counters.iterations,
        IntegerOutput::SolverRejected => counters.rejected,
        IntegerOutput::SolverRescued => counters.rescued,
        IntegerOutput::SolverLastResorts => counters.last_resorts,
        IntegerOutput::SolverRestarts => counters.restarts,
        IntegerOutput::SolverLaunches => counters.launches,
        IntegerOutput::SolverVertexPasses => counters.vertex_passes,
        IntegerOutput::SingularPassesDirect => counters.mode_changes[0],
        IntegerOutput::SingularPassesInverse(i) => counters.mode_changes[1 + i],
    };
    // fmi2Integer has 32 bits: a counter that has grown past them stays at the largest value.
    i32::try_from(count).unwrap_or(i32::MAX)
}

fn enumeration(of: &Observed<'_, f64>, output: EnumerationOutput) -> i32 {
    let jacobians = of.jacobians();
    match output {
        EnumerationOutput::SingularType => {
            match of.model().mechanism.geometry.singularity_kind(&jacobians, of.observation().sigma_phi()) {
                Kind::None => SingularityKind::None as i32,
                Kind::Direct => SingularityKind::Direct as i32,
                Kind::Inverse => SingularityKind::Inverse as i32,
                Kind::Combined => SingularityKind::Combined as i32,
                Kind::Constraint => SingularityKind::Constraint as i32,
            }
        }
        EnumerationOutput::ModeAssembly => match jacobians.assembly {
            mechanism::Assembly::Plus => Assembly::Plus as i32,
            mechanism::Assembly::Minus => Assembly::Minus as i32,
        },
        EnumerationOutput::ModeWorking => match jacobians.working {
            [true, true] => WorkingMode::PlusPlus as i32,
            [true, false] => WorkingMode::PlusMinus as i32,
            [false, true] => WorkingMode::MinusPlus as i32,
            [false, false] => WorkingMode::MinusMinus as i32,
        },
    }
}
