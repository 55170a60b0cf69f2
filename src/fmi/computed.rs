//! Computed variables from observers. Each output and local variable is defined once, generic over its value, its directional derivative
//! and its time derivatives.

use crate::estimator;
use crate::estimator::error_state::{DRY, LENGTHS, MASSES, OFFSETS, PAYLOAD, VISCOUS};
use crate::observers::{self, Estimated, Observed, Point};
use crate::scalar::Scalar;
use crate::simulation::bindings::{self, Field};
use crate::variables::{
    EnumerationComputed, EstimatorStatus, IntegerComputed, RealComputed, Value, Variable, VariableId, WorkingMode,
};

/// Indices of the proximal links, left and right.
const PROXIMAL_LINKS: [usize; 2] = [0, 3];
const DISTAL_LINKS: [usize; 2] = [1, 2];

/// Standard deviation reported for a quantity that is not observable, in the variable's unit.
const UNOBSERVABLE: f64 = 1e30;

/// Value of a computed variable; `None` for parameters, inputs and samples.
pub(super) fn read(of: &Observed<'_, f64>, variable: &Variable) -> Option<Value> {
    match variable.id {
        VariableId::RealComputed(computed) => real(of, computed, 0).map(Value::Real),
        VariableId::IntegerComputed(computed) => Some(Value::Integer(integer(of, computed))),
        VariableId::EnumerationComputed(computed) => Some(enumeration(of, computed)),
        VariableId::Parameter(_) | VariableId::Input(_) | VariableId::Sample(_) => None,
    }
}

/// Value of a variable (order 0) or its time derivative of this order; `None` if the derivative is not available. Only outputs have time
/// derivatives.
pub(super) fn real<T: Scalar>(of: &Observed<'_, T>, computed: RealComputed, order: usize) -> Option<T> {
    use RealComputed as V;
    // Positions, velocities and accelerations are orders 0, 1 and 2 of a motion; higher orders are not available.
    let order_of = |own: usize| Some(own + order).filter(|order| *order <= 2);
    // Estimates depend on samples and time only: their directional derivatives are 0.
    let estimated = |value: &dyn Fn(&Estimated<'_>) -> f64| of.constant(of.estimated().map_or(0.0, |of| value(&of)));
    let torques = |of: &Estimated<'_>| of.following.motor_torques();
    let learned = |i: usize| estimated(&|of| of.following.learned()[0][i]);
    let learned_sigma = |i: usize| estimated(&|of| of.following.learned()[1][i]);
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
        V::EstimatedTau(i) => estimated(&|of| torques(of).map_or(0.0, |(tau, _)| tau[i])),
        V::EstimatedTauSigma(i) => estimated(&|of| torques(of).map_or(UNOBSERVABLE, |(_, sigma)| sigma[i])),
        V::EstimatedTauValid => estimated(&|of| f64::from(torques(of).is_some())),
        V::EstimatedNis => estimated(&|of| of.following.estimator().nis()),
        V::EstimatedAlarm => estimated(&|of| f64::from(of.following.estimator().alarm())),
        V::EstimatedCause => estimated(&|of| of.following.cause().0.number() as f64),
        V::EstimatedCauseProbability => estimated(&|of| of.following.cause().1),
        V::EstimatedThetaSigma(i) => estimated(&|of| of.following.sigmas()[0][PROXIMAL_LINKS[i]]),
        V::EstimatedOmegaSigma(i) => estimated(&|of| of.following.sigmas()[1][PROXIMAL_LINKS[i]]),
        V::EstimatedTipCov(i) => estimated(&|of| of.following.tip_covariance()[i]),
        V::EstimatedForecastRadius95 => estimated(&|of| of.following.tip_radius()),
        V::EstimatedMass(i) => learned(MASSES.start + i),
        V::EstimatedMassSigma(i) => learned_sigma(MASSES.start + i),
        V::EstimatedPayload => learned(PAYLOAD),
        V::EstimatedPayloadSigma => learned_sigma(PAYLOAD),
        V::EstimatedViscous(i) => learned(VISCOUS.start + i),
        V::EstimatedViscousSigma(i) => learned_sigma(VISCOUS.start + i),
        V::EstimatedFriction => learned(DRY),
        V::EstimatedFrictionSigma => learned_sigma(DRY),
        V::EstimatedLength(i) => learned(LENGTHS.start + i),
        V::EstimatedLengthSigma(i) => learned_sigma(LENGTHS.start + i),
        V::EstimatedOffset(i) => learned(OFFSETS.start + i),
        V::EstimatedOffsetSigma(i) => learned_sigma(OFFSETS.start + i),
        V::EstimatedInnovation(i) => estimated(&|of| of.following.estimator().innovation()[i]),
        V::EstimatedSingularProbability => estimated(&|of| of.singularity_probability()),
    })
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
    // fmi2Integer has 32 bits: a larger count saturates.
    i32::try_from(*bindings::counter(&of.observation().state().core.counters, computed)).unwrap_or(i32::MAX)
}

fn enumeration(of: &Observed<'_, f64>, computed: EnumerationComputed) -> Value {
    let jacobians = of.jacobians();
    match computed {
        EnumerationComputed::SingularType => {
            of.model().mechanism.geometry.singularity_kind(&jacobians, of.observation().sigma_phi()).value()
        }
        EnumerationComputed::EstimatedStatus => {
            Value::Integer(of.estimated().map_or(EstimatorStatus::Off, |of| status(of.following.status())) as i32)
        }
        EnumerationComputed::ModeAssembly => jacobians.assembly.value(),
        EnumerationComputed::ModeWorking => Value::Integer(match jacobians.working {
            [true, true] => WorkingMode::PlusPlus,
            [true, false] => WorkingMode::PlusMinus,
            [false, true] => WorkingMode::MinusPlus,
            [false, false] => WorkingMode::MinusMinus,
        } as i32),
    }
}
