//! Observers → computed variables: each output and local variable is defined once, generic over its value, its directional
//! derivative and its time derivatives.

use crate::estimator;
use crate::mechanism;
use crate::observers::{self, Estimated, Observed, Point, SingularityKind as Kind};
use crate::scalar::Scalar;
use crate::variables::{
    Assembly, EnumerationComputed, EstimatorStatus, IntegerComputed, RealComputed, SingularityKind, Value, Variable, VariableId,
    WorkingMode,
};

/// Links of the left and the right leg.
const PROXIMAL_LINKS: [usize; 2] = [0, 3];
const DISTAL_LINKS: [usize; 2] = [1, 2];

/// Standard deviation reported for a quantity that is not observable, in the variable's unit.
const UNOBSERVABLE: f64 = 1e30;

/// The value of a computed variable; `None` for any other.
pub(super) fn read(of: &Observed<'_, f64>, variable: &Variable) -> Option<Value> {
    match variable.id {
        VariableId::RealComputed(computed) => real(of, computed, 0).map(Value::Real),
        VariableId::IntegerComputed(computed) => Some(Value::Integer(integer(of, computed))),
        VariableId::EnumerationComputed(computed) => Some(Value::Integer(enumeration(of, computed))),
        VariableId::RealParameter(_)
        | VariableId::RealInput(_)
        | VariableId::RealSample(_)
        | VariableId::IntegerParameter(_)
        | VariableId::BooleanParameter(_)
        | VariableId::EnumerationParameter(_) => None,
    }
}

/// Value of a variable (order 0) or its derivative of an order with respect to time; `None` where the derivative is not available.
/// Only outputs have derivatives with respect to time.
pub(super) fn real<T: Scalar>(of: &Observed<'_, T>, computed: RealComputed, order: usize) -> Option<T> {
    use RealComputed as V;
    // Positions, velocities and accelerations are orders 0, 1 and 2 of a motion; higher orders are not available.
    let order_of = |own: usize| Some(own + order).filter(|order| *order <= 2);
    Some(match computed {
        V::TipX => of.point(Point::Tip, order_of(0)?)[0],
        V::TipY => of.point(Point::Tip, order_of(0)?)[1],
        V::TipVx => of.point(Point::Tip, order_of(1)?)[0],
        V::TipVy => of.point(Point::Tip, order_of(1)?)[1],
        V::Theta(i) => of.angle(PROXIMAL_LINKS[i], order_of(0)?),
        V::Omega(i) => of.angle(PROXIMAL_LINKS[i], order_of(1)?),
        _ if order > 0 => return None,
        V::ServoTorque(i) => of.servo_torques()[i],
        V::ContactFx => of.contact_force()[0],
        V::ContactFy => of.contact_force()[1],
        V::Alpha(i) => of.angle(PROXIMAL_LINKS[i], 2),
        V::PassiveTheta(i) => of.angle(DISTAL_LINKS[i], 0),
        V::PassiveOmega(i) => of.angle(DISTAL_LINKS[i], 1),
        V::TipAx => of.point(Point::Tip, 2)[0],
        V::TipAy => of.point(Point::Tip, 2)[1],
        V::ElbowX(i) => of.point(Point::Elbow(i), 0)[0],
        V::ElbowY(i) => of.point(Point::Elbow(i), 0)[1],
        V::ReactionFx(i) => of.reaction(i)[0],
        V::ReactionFy(i) => of.reaction(i)[1],
        V::EnergyKinetic => of.kinetic_energy(),
        V::EnergyPotential => of.potential_energy(),
        V::EnergyError => of.energy_error(),
        V::EnergyInput => of.constant(of.observation().state().core.work.input),
        V::EnergyDissipated => of.constant(of.observation().state().core.work.dissipated),
        V::SingularDetJx => of.jacobians().det_jx,
        V::SingularDetJq => of.jacobians().det_jq,
        V::SingularSigmaJx => of.jacobians().sigma_jx,
        V::SingularSigmaJq => of.jacobians().sigma_jq,
        V::SingularSigmaPhi => of.sigma_phi(),
        V::SolverPositionError => of.constant(observers::constraint_norms(of.model(), of.observation().state()).position),
        V::SolverVelocityError => of.constant(observers::constraint_norms(of.model(), of.observation().state()).velocity),
        V::SolverErrorEstimate => of.constant(of.observation().state().core.error_estimate),
        V::EstimatedTau(_)
        | V::EstimatedNis
        | V::EstimatedAlarm
        | V::EstimatedThetaSigma(_)
        | V::EstimatedOmegaSigma(_)
        | V::EstimatedTipCov(_)
        | V::EstimatedTauSigma(_)
        | V::EstimatedTauValid
        | V::EstimatedInnovation(_)
        | V::EstimatedSingularProbability => of.constant(of.estimated().map_or(0.0, |of| estimated(&of, computed))),
    })
}

/// Value of an estimated variable, which changes with samples and time only.
fn estimated(of: &Estimated<'_>, computed: RealComputed) -> f64 {
    use RealComputed as V;
    let following = of.following;
    let torques = || following.motor_torques();
    match computed {
        V::EstimatedTau(i) => torques().map_or(0.0, |(tau, _)| tau[i]),
        V::EstimatedTauSigma(i) => torques().map_or(UNOBSERVABLE, |(_, sigma)| sigma[i]),
        V::EstimatedTauValid => f64::from(u8::from(torques().is_some())),
        V::EstimatedNis => following.estimator().nis(),
        V::EstimatedAlarm => f64::from(u8::from(following.estimator().alarm())),
        V::EstimatedThetaSigma(i) => following.sigmas()[0][PROXIMAL_LINKS[i]],
        V::EstimatedOmegaSigma(i) => following.sigmas()[1][PROXIMAL_LINKS[i]],
        V::EstimatedTipCov(i) => following.tip_covariance()[i],
        V::EstimatedInnovation(i) => following.estimator().innovation()[i],
        V::EstimatedSingularProbability => of.singularity_probability(),
        _ => unreachable!("{computed:?} is not estimated"),
    }
}

fn status(status: estimator::Status) -> EstimatorStatus {
    use estimator::{Fault, Status};
    match status {
        Status::Following | Status::Faulty(Fault::None) => EstimatorStatus::Following,
        Status::Coasting => EstimatorStatus::Coasting,
        Status::OneEncoder => EstimatorStatus::OneEncoder,
        Status::Holding => EstimatorStatus::Holding,
        Status::TwoBranches => EstimatorStatus::TwoBranches,
        Status::Inconsistent => EstimatorStatus::Inconsistent,
        Status::Faulty(Fault::Rejected) => EstimatorStatus::Rejected,
        Status::Faulty(Fault::Late) => EstimatorStatus::Late,
        Status::Faulty(Fault::Future) => EstimatorStatus::Future,
        Status::Faulty(Fault::Invalid) => EstimatorStatus::Invalid,
        Status::Faulty(Fault::Stuck) => EstimatorStatus::Stuck,
    }
}

fn integer(of: &Observed<'_, f64>, computed: IntegerComputed) -> i32 {
    let counters = of.observation().state().core.counters;
    let count = match computed {
        IntegerComputed::SolverSteps => counters.steps,
        IntegerComputed::SolverSubsteps => counters.substeps,
        IntegerComputed::SolverIterations => counters.iterations,
        IntegerComputed::SolverRejected => counters.rejected,
        IntegerComputed::SolverRescued => counters.rescued,
        IntegerComputed::SolverLastResorts => counters.fallbacks,
        IntegerComputed::SolverRestarts => counters.restarts,
        IntegerComputed::SolverLaunches => counters.launches,
        IntegerComputed::SolverVertexPasses => counters.vertex_passes,
        IntegerComputed::SingularPassesDirect => counters.sign_changes[0],
        IntegerComputed::SingularPassesInverse(i) => counters.sign_changes[1 + i],
    };
    // fmi2Integer has 32 bits: a larger count saturates.
    i32::try_from(count).unwrap_or(i32::MAX)
}

fn enumeration(of: &Observed<'_, f64>, computed: EnumerationComputed) -> i32 {
    let jacobians = of.jacobians();
    match computed {
        EnumerationComputed::SingularType => {
            match of.model().mechanism.geometry.singularity_kind(&jacobians, of.observation().sigma_phi()) {
                Kind::None => SingularityKind::None as i32,
                Kind::Direct => SingularityKind::Direct as i32,
                Kind::Inverse => SingularityKind::Inverse as i32,
                Kind::Combined => SingularityKind::Combined as i32,
                Kind::Constraint => SingularityKind::Constraint as i32,
            }
        }
        EnumerationComputed::EstimatedStatus => {
            of.estimated().map_or(EstimatorStatus::Off, |of| status(of.following.status())) as i32
        }
        EnumerationComputed::ModeAssembly => match jacobians.assembly {
            mechanism::Assembly::Plus => Assembly::Plus as i32,
            mechanism::Assembly::Minus => Assembly::Minus as i32,
        },
        EnumerationComputed::ModeWorking => match jacobians.working {
            [true, true] => WorkingMode::PlusPlus as i32,
            [true, false] => WorkingMode::PlusMinus as i32,
            [false, true] => WorkingMode::MinusPlus as i32,
            [false, false] => WorkingMode::MinusMinus as i32,
        },
    }
}
