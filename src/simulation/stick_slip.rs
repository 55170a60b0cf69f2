//! Set-valued dry friction in a state: which contacts stick, and their reactions. Evaluated in the twelve coordinates and mapped to the
//! link angles. The friction problem itself is solved in `effects/stick_slip.rs`.

use arrayvec::ArrayVec;

use super::angles::{AngleSystem, Angles, angles, legs};
use super::five_bar::FiveBar;
use crate::effects::stick_slip::{
    FRICTION_PLACES, FrictionConstraint, FrictionConstraints, FrictionProblem, SlipDirection, StickSlip, StickSlips,
};
use crate::effects::{FrictionGuard, FrictionGuards, Motion, Wrench, cubic_minimum, stick_velocity};
use crate::integrator::{Kkt, StickingConstraint, System};
use crate::mechanism::{COORDINATES, Coordinates, Multipliers, Pose, SceneError};
use crate::vector::Vector;

impl FiveBar<'_> {
    /// Friction constraints of all active contacts.
    fn constraints(&self, at: &Motion) -> FrictionConstraints {
        let mut constraints = FrictionConstraints::new();
        for effect in &self.model.effects {
            effect.add_friction_constraints(at, &mut constraints);
        }
        constraints
    }

    /// Friction constraints of all active contacts at coordinates and velocities.
    fn constraints_at(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> FrictionConstraints {
        self.constraints(&self.motion(q, pose, v))
    }

    fn stick_velocity(&self) -> f64 {
        stick_velocity(self.model.error_tolerance)
    }
}

/// Largest rate of a mechanism that friction can bring to rest, in stick velocities: residual motion below that is within tolerances.
const REST_RATE: f64 = 1e3;

/// Largest rate at which a contact may start to stick, in stick velocities: a step ends past the guard by a fraction of one.
const STICKING_RATE: f64 = 2.0;

/// Stick-slip states that follow from a state without history.
#[cold]
#[inline(never)]
pub(super) fn resolved(system: &FiveBar<'_>, q: &Coordinates, v: &Coordinates) -> StickSlips {
    let pose = system.pose(q);
    let constraints = system.constraints_at(q, &pose, v);
    let stick_velocity = system.stick_velocity();
    if v.max_norm() <= REST_RATE * stick_velocity {
        let at_rest = friction_problem(system, q, &Coordinates::ZERO, &|_| true);
        if at_rest.can_rest() {
            return system.mode.stick_slip.resting(at_rest.places.into_iter());
        }
    }
    let mut stick_slip = resolve_motion(system, &constraints);
    let rests = |constraint: &FrictionConstraint| constraint.rate.abs() <= STICKING_RATE * stick_velocity;
    if constraints.iter().any(rests) {
        friction_problem(system, q, v, &rests).resolve_motion(&mut stick_slip);
    }
    stick_slip
}

/// Whether a slipping contact reverses twice between two states, by the cubic through the rates and accelerations at both.
#[cold]
#[inline(never)]
pub(super) fn reverses_between(system: &FiveBar<'_>, ends: [[&Coordinates; 3]; 2], duration: f64, stick_velocity: f64) -> bool {
    let constraints = |[q, v, _]: [&Coordinates; 3]| system.constraints_at(q, &system.pose(q), v);
    let (from, to) = (constraints(ends[0]), constraints(ends[1]));
    let pairs = from.iter().zip(&to).filter(|(from, to)| from.place == to.place);
    pairs.into_iter().any(|(from, to)| {
        let StickSlip::Slips(way) = system.mode.stick_slip.at(from.place) else { return false };
        let change = |constraint: &FrictionConstraint, [q, v, a]: [&Coordinates; 3]| {
            let (pose, wrench) = (system.pose(q), &constraint.wrench);
            way.sign() * duration * (wrench.in_coordinates(&pose).dot(a) + wrench.drift_in_coordinates(&pose, v))
        };
        let rates = [from, to].map(|constraint| way.sign() * constraint.rate);
        let changes = [change(from, ends[0]), change(to, ends[1])];
        // Upper bound of the dip of a cubic below both its ends, relative to the descending slopes: max of s(1 − s)² is 4/27.
        const LARGEST_DIP: f64 = 4.0 / 27.0;
        let dip = LARGEST_DIP * ((-changes[0]).max(0.0) + changes[1].max(0.0));
        rates[0].min(rates[1]) - dip < -stick_velocity && cubic_minimum(rates, changes) < -stick_velocity
    })
}

/// All contacts slip but those that the closure branch keeps still.
#[cold]
#[inline(never)]
fn resolve_motion(system: &FiveBar<'_>, constraints: &FrictionConstraints) -> StickSlips {
    let mut stick_slip = system.mode.stick_slip.opened();
    for constraint in constraints.iter().filter(|constraint| !system.mode.stick_slip.is_still(constraint.place)) {
        stick_slip.set(constraint.place, StickSlip::Slips(SlipDirection::of(constraint.rate)));
    }
    stick_slip
}

/// Whether a friction place can stick: its bound is positive and the closure branch lets it move.
fn is_able(system: &FiveBar<'_>, constraint: &FrictionConstraint) -> bool {
    constraint.bound > 0.0 && !system.mode.stick_slip.is_still(constraint.place)
}

/// Friction problem of the contacts that may stick, while the others slip.
#[cold]
#[inline(never)]
fn friction_problem(
    system: &FiveBar<'_>,
    q: &Coordinates,
    v: &Coordinates,
    rests: &dyn Fn(&FrictionConstraint) -> bool,
) -> FrictionProblem {
    let pose = system.pose(q);
    let constraints = system.constraints_at(q, &pose, v);
    let resting: ArrayVec<FrictionConstraint, FRICTION_PLACES> =
        constraints.iter().filter(|constraint| is_able(system, constraint) && rests(constraint)).copied().collect();
    let mut stick_slip = resolve_motion(system, &constraints);
    for constraint in &resting {
        stick_slip.set(constraint.place, StickSlip::Sticks(SlipDirection::Forward));
    }
    let mass = system.factor_mass(&pose, system.model.regularization);
    let forces = system.on(system.mode.with_stick_slip(stick_slip)).forces(q, &pose, v);
    let (a, _) = mass.solve(&forces, &-system.phi_q_dot_times(&pose, v));
    let rows: ArrayVec<Coordinates, FRICTION_PLACES> =
        resting.iter().map(|constraint| constraint.wrench.in_coordinates(&pose)).collect();
    let mut friction_problem = FrictionProblem::default();
    for (i, constraint) in resting.iter().enumerate() {
        let (by_torque, _) = mass.solve(&rows[i], &Vector::ZERO);
        friction_problem.places.push(constraint.place);
        friction_problem.bounds[i] = constraint.bound;
        friction_problem.change[i] = rows[i].dot(&a) + constraint.wrench.drift_in_coordinates(&pose, v);
        for (j, row) in rows.iter().enumerate() {
            friction_problem.mobility[j][i] = row.dot(&by_torque);
        }
    }
    friction_problem
}

/// Constraint or reaction by which friction holds the system, in the twelve coordinates.
#[cold]
#[inline(never)]
pub(super) fn held(system: &FiveBar<'_>, q: &Coordinates, pose: &Pose, v: &Coordinates) -> StickingConstraint<COORDINATES> {
    let at_rest = || friction_problem(system, q, v, &|_| true);
    let carried = |wrench: &Wrench| wrench.in_coordinates(pose);
    sticking_constraint(system, &system.motion(q, pose, v), at_rest, carried, |wrench| wrench.drift_in_coordinates(pose, v))
}

/// Sticking constraint at a motion, with its wrenches carried to generalised forces and their drifts, in any coordinates.
fn sticking_constraint<const N: usize>(
    system: &FiveBar<'_>,
    at: &Motion,
    at_rest: impl FnOnce() -> FrictionProblem,
    carried: impl Fn(&Wrench) -> Vector<N>,
    drift: impl Fn(&Wrench) -> f64,
) -> StickingConstraint<N> {
    let constraints = system.constraints(at);
    if system.mode.stick_slip.at_rest() {
        let able = constraints.iter().filter(|constraint| is_able(system, constraint));
        let parts = able.zip(at_rest().resting_torques());
        let wrench = parts.fold(Wrench::default(), |sum, (constraint, torque)| sum.plus(torque, &constraint.wrench));
        return StickingConstraint::All { force: carried(&wrench) };
    }
    let Some(first) = first(&system.mode.stick_slip, &constraints) else { return StickingConstraint::Nothing };
    let wrench = shares(&system.mode.stick_slip, &constraints)
        .fold(Wrench::default(), |sum, (constraint, share)| sum.plus(share, &constraint.wrench));
    StickingConstraint::Direction { row: carried(&first.wrench), drift: drift(&first.wrench), force: carried(&wrench) }
}

/// First sticking contact.
fn first<'a>(stick_slip: &StickSlips, constraints: &'a FrictionConstraints) -> Option<&'a FrictionConstraint> {
    constraints.iter().find(|constraint| matches!(stick_slip.at(constraint.place), StickSlip::Sticks(_)))
}

/// Sticking contacts of one motion with their torque per unit of the first: all use an equal fraction of their bounds.
fn shares<'a>(
    stick_slip: &'a StickSlips,
    constraints: &'a FrictionConstraints,
) -> impl Iterator<Item = (&'a FrictionConstraint, f64)> {
    let first = first(stick_slip, constraints);
    constraints.iter().filter_map(move |constraint| {
        let StickSlip::Sticks(way) = stick_slip.at(constraint.place) else { return None };
        let leader = first?;
        let share = if constraint.place == leader.place { 1.0 } else { way.sign() * constraint.bound / leader.bound };
        Some((constraint, share))
    })
}

/// Friction reactions of sticking contacts: torques in the joints, N·m, and force on the tip, N.
#[cold]
#[inline(never)]
pub(super) fn holding(system: &FiveBar<'_>, q: &Coordinates, v: &Coordinates) -> [f64; FRICTION_PLACES] {
    let pose = system.pose(q);
    let constraints = system.constraints_at(q, &pose, v);
    let mut holding = [0.0; FRICTION_PLACES];
    if system.mode.stick_slip.at_rest() {
        let friction_problem = friction_problem(system, q, v, &|_| true);
        for (place, torque) in friction_problem.places.iter().zip(friction_problem.resting_torques()) {
            holding[*place] = torque;
        }
        return holding;
    }
    let StickingConstraint::Direction { row, drift, force } = held(system, q, &pose, v) else { return holding };
    let mass = system.factor_mass(&pose, system.model.regularization);
    let (a, _) = mass.solve(&system.forces(q, &pose, v), &-system.phi_q_dot_times(&pose, v));
    let mobility = row.dot(&mass.solve(&force, &Vector::ZERO).0);
    let part = if mobility > 0.0 { -(row.dot(&a) + drift) / mobility } else { 0.0 };
    for (constraint, share) in shares(&system.mode.stick_slip, &constraints) {
        holding[constraint.place] = part * share;
    }
    holding
}

/// q̈ and λ with the friction reactions, from those without, in any coordinates; `regularization` is e of the saddle-point systems.
#[cold]
#[inline(never)]
pub(super) fn with_friction_reaction<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    [q, v]: [Vector<N>; 2],
    (a, lambda): (Vector<N>, Vector<M>),
    regularization: f64,
) -> (Vector<N>, Vector<M>) {
    let pose = system.pose(&q);
    let mass = system.factor_mass(&pose, regularization);
    match system.sticking_constraint(&q, &pose, &v) {
        StickingConstraint::Nothing => (a, lambda),
        StickingConstraint::Direction { row, drift, force } => {
            let (by_force, by_force_lambda) = mass.solve(&force, &Vector::ZERO);
            let mobility = row.dot(&by_force);
            let part = if mobility > 0.0 { -(row.dot(&a) + drift) / mobility } else { 0.0 };
            (a + part * by_force, lambda + part * by_force_lambda)
        }
        StickingConstraint::All { force } => {
            let (_, lambda) = mass.solve(&(system.forces(&q, &pose, &v) + force), &Vector::ZERO);
            (Vector::ZERO, lambda)
        }
    }
}

impl AngleSystem<'_> {
    /// Friction constraint or reaction in the link angles.
    #[cold]
    #[inline(never)]
    pub(super) fn friction_reaction_in_angles(
        &self,
        q: &Angles,
        pose: &Pose,
        v: &Angles,
    ) -> StickingConstraint<{ super::angles::ANGLES }> {
        let at_rest = || {
            let (x, rates) = self.coordinates(pose, q, v);
            friction_problem(self.five_bar(), &x, &rates, &|_| true)
        };
        let carried = |wrench: &Wrench| angles(wrench.torques_in_angles(pose));
        sticking_constraint(self.five_bar(), &self.motion(pose, q, v), at_rest, carried, |wrench| {
            wrench.drift_in_angles(pose, legs(v))
        })
    }
}

/// Velocity without its component along the sticking direction: the projection that is smallest in the mass metric.
#[cold]
#[inline(never)]
pub(super) fn project_sticking(system: &FiveBar<'_>, q: Coordinates, v: Coordinates) -> Coordinates {
    if system.mode.stick_slip.at_rest() {
        return Coordinates::ZERO;
    }
    let pose = system.pose(&q);
    let StickingConstraint::Direction { row, force, .. } = held(system, &q, &pose, &v) else { return v };
    let (by_force, _) = system.factor_mass(&pose, system.model.regularization).solve(&force, &Vector::ZERO);
    let mobility = row.dot(&by_force);
    if mobility > 0.0 { v - row.dot(&v) / mobility * by_force } else { v }
}

/// Friction guards at a state, for event detection.
#[cold]
#[inline(never)]
pub(super) fn friction_guards(system: &FiveBar<'_>, q: &Coordinates, pose: &Pose, v: &Coordinates) -> FrictionGuards {
    let constraints = system.constraints_at(q, pose, v);
    let watched = system.mode.stick_slip.any_sticks() && !system.mode.stick_slip.at_rest();
    let holding = if watched { holding(system, q, v) } else { [0.0; FRICTION_PLACES] };
    let friction_guard = |constraint: &FrictionConstraint| FrictionGuard {
        place: constraint.place,
        rate: constraint.rate,
        load: [holding[constraint.place], constraint.bound],
        arms: constraint.wrench.lever_arms(&system.model.mechanism.geometry),
    };
    constraints.iter().map(friction_guard).collect()
}

/// Directional derivative of q̈ and λ with sticking joints, from those without friction: accelerations of sticking contacts stay 0. Refused
/// where friction holds the whole mechanism or the tip.
pub(super) fn varied(
    system: &FiveBar<'_>,
    [q, v]: [&Coordinates; 2],
    (a, lambda): (Coordinates, Multipliers),
) -> Result<(Coordinates, Multipliers), SceneError> {
    let stick_slip = system.mode.stick_slip;
    if !stick_slip.any_sticks() {
        return Ok((a, lambda));
    }
    if stick_slip.at_rest() || matches!(stick_slip.at(FRICTION_PLACES - 1), StickSlip::Sticks(_)) {
        return Err(SceneError(
            "the tip sticks or friction locks the machine: derivatives are available only where joints alone stick and the machine \
             can move."
                .into(),
        ));
    }
    let pose = system.pose(q);
    let StickingConstraint::Direction { row, force, .. } = held(system, q, &pose, v) else { return Ok((a, lambda)) };
    let (by_force, by_force_lambda) = system.factor_mass(&pose, system.model.regularization).solve(&force, &Vector::ZERO);
    let mobility = row.dot(&by_force);
    let part = if mobility > 0.0 { -row.dot(&a) / mobility } else { 0.0 };
    Ok((a + part * by_force, lambda + part * by_force_lambda))
}

/// Whether a run can have reached a state with its stick-slip states; `just_stopped` allows the residual rates of a stop.
#[cold]
#[inline(never)]
pub(super) fn are_possible(system: &FiveBar<'_>, q: &Coordinates, v: &Coordinates, just_stopped: bool) -> bool {
    /// Largest rate by which a stick-slip state may contradict the motion, in stick velocities: a hundredfold of the event tolerance.
    const LARGEST_CONTRADICTION: f64 = 100.0;
    let stick_slip = &system.mode.stick_slip;
    if stick_slip.at_rest() {
        let all = friction_problem(system, q, &Coordinates::ZERO, &|_| true);
        let slowest = if just_stopped { REST_RATE * system.stick_velocity() } else { 0.0 };
        return v.max_norm() <= slowest && all.can_rest() && *stick_slip == stick_slip.resting(all.places.into_iter());
    }
    let friction_guards = friction_guards(system, q, &system.pose(q), v);
    let far = LARGEST_CONTRADICTION * system.stick_velocity();
    let there = |place: usize| friction_guards.iter().any(|friction_guard| friction_guard.place == place);
    let held = |constraint: &FrictionConstraint| matches!(stick_slip.at(constraint.place), StickSlip::Sticks(_));
    friction_problem(system, q, v, &held).is_single_motion()
        && (0..FRICTION_PLACES).all(|place| there(place) || matches!(stick_slip.at(place), StickSlip::Inactive | StickSlip::Still))
        && friction_guards.iter().all(|friction_guard| match stick_slip.at(friction_guard.place) {
            StickSlip::Inactive => false,
            StickSlip::Still => friction_guard.rate.abs() <= far,
            StickSlip::Slips(way) => way.sign() * friction_guard.rate >= -far,
            StickSlip::Sticks(_) => {
                friction_guard.rate.abs() <= far
                    && friction_guard.load[0].abs() <= (1.0 + 1e-3) * friction_guard.load[1].abs() + 1e-9
            }
        })
}
