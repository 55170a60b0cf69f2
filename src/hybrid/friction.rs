//! Dry friction as a set-valued law: stick and slip as a complementarity problem.
//!
//! A friction place is a direction in which bodies slide on each other: the rotation of a joint, or the tip along the plane. A slipping
//! place has a friction force against its sliding rate w. A sticking place has the force that keeps w = 0, up to the bound b. A method
//! stores the states ([`StickSlips`]).
//!
//! At vanishing sliding rates the accelerations follow from Gauss's principle with friction: they minimise
//! ½ (q̈ − q̈₀)ᵀ M (q̈ − q̈₀) + Σ b |ẇ|, with q̈₀ the accelerations without friction at these places (Moreau, 1988; Glocker, *Set-Valued
//! Force Laws*, 2001). The minimiser is unique. The mechanism has two degrees of freedom, so at most two independent places stick, and then
//! nothing moves.

use arrayvec::ArrayVec;
use nalgebra::{SMatrix, SVector};

use super::mode::{FRICTION_PLACES, SlipDirection, StickSlip, StickSlips, TIP_FRICTION};
use super::{Extremes, derivative_bound};
use crate::integrator::{CROSSING_RESIDUAL, ERROR_RATE, Kkt, Posed, StickingConstraint, System, reaction};
use crate::mechanism::{LINKS, SceneError};
use crate::vector::Vector;

/// Law of dry friction: the `….law` variables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Law {
    /// Regularised: a smooth function of the sliding rate, with creep under load.
    #[default]
    Smooth,
    /// Set-valued: sticks up to its bound.
    Stick,
}

/// An active friction place at a state.
#[derive(Clone, Copy, Debug)]
pub struct FrictionPlace {
    /// Index of the place in [`StickSlips`].
    pub place: usize,
    /// Sliding rate, rad/s or m/s.
    pub rate: f64,
    /// Largest friction torque or force, N·m or N.
    pub bound: f64,
    /// Largest |∂w/∂θ̇| of the sliding rate with respect to the rate of each link, 1 or m/rad.
    pub arms: [f64; LINKS],
}

/// Friction place as a constraint: friction may keep its sliding rate w = row·q̇ at 0.
#[derive(Clone, Copy, Debug)]
pub struct FrictionConstraint<const N: usize> {
    /// The place with its sliding rate.
    pub at: FrictionPlace,
    /// Generalised force of a friction torque of 1 N·m or a friction force of 1 N. It is also the row of the constraint.
    pub row: Vector<N>,
    /// Part of ẇ that depends only on the rates: ẇ = row·q̈ + drift.
    pub drift: f64,
}

/// Constraints of all active friction places at a state.
pub type FrictionConstraints<const N: usize> = ArrayVec<FrictionConstraint<N>, FRICTION_PLACES>;

/// A mechanical system with dry friction that can stick.
pub trait Frictional<const N: usize, const M: usize>: System<N, M> + Sized {
    /// Current stick-slip states.
    fn stick_slip(&self) -> &StickSlips;
    /// Returns the system with other stick-slip states.
    fn with_stick_slip(&self, stick_slip: StickSlips) -> Self;
    /// Friction constraints at q, its pose and q̇, for the places in states that `wanted` accepts.
    fn friction_constraints(&self, at: Posed<'_, Self::Pose, N>, wanted: impl Fn(StickSlip) -> bool) -> FrictionConstraints<N>;
    /// Regularisation e of the saddle-point systems, 1/kg.
    fn regularization(&self) -> f64;
    /// Sliding rate below which a friction place counts as at rest, rad/s or m/s.
    fn stick_velocity(&self) -> f64;

    /// Stick-slip states that follow from a state without history.
    fn resolved(&self, q: &Vector<N>, v: &Vector<N>) -> StickSlips {
        let constraints = self.friction_constraints(Posed { q, pose: &self.pose(q), v }, all);
        if v.max_norm() <= REST_RATE * self.stick_velocity() {
            let at_rest = FrictionProblem::new(self, q, &Vector::ZERO, &|_| true);
            if at_rest.can_rest() {
                return self.stick_slip().resting(at_rest.places.into_iter());
            }
        }
        let mut stick_slip = slipping(self.stick_slip(), &constraints);
        let rests = |constraint: &FrictionConstraint<N>| constraint.at.rate.abs() <= STICKING_RATE * self.stick_velocity();
        if constraints.iter().any(rests) {
            FrictionProblem::new(self, q, v, &rests).resolve_motion(&mut stick_slip);
        }
        stick_slip
    }

    /// Constraint or reaction due to sticking friction.
    fn sticking(&self, q: &Vector<N>, pose: &Self::Pose, v: &Vector<N>) -> StickingConstraint<N> {
        if self.stick_slip().at_rest() {
            let (constraints, holding) = (self.friction_constraints(Posed { q, pose, v }, all), self.holding(Posed { q, pose, v }));
            let force =
                constraints.iter().fold(Vector::ZERO, |sum, constraint| sum + holding[constraint.at.place] * constraint.row);
            return StickingConstraint::All { force };
        }
        let constraints = self.friction_constraints(Posed { q, pose, v }, StickSlip::sticks);
        sticking_direction(self.stick_slip(), &constraints)
    }

    /// Friction reactions of sticking places: torques in the joints, N·m, and force on the tip, N.
    fn holding(&self, Posed { q, pose, v }: Posed<'_, Self::Pose, N>) -> [f64; FRICTION_PLACES] {
        if self.stick_slip().at_rest() {
            return self.holding_at_rest(Posed { q, pose, v });
        }
        let mut holding = [0.0; FRICTION_PLACES];
        let constraints = self.friction_constraints(Posed { q, pose, v }, StickSlip::sticks);
        let StickingConstraint::Direction { row, drift, force } = sticking_direction(self.stick_slip(), &constraints) else {
            return holding;
        };
        let mass = self.factor_mass(pose, self.regularization());
        let (a, _) = mass.solve(&self.forces(q, pose, v).0, &-self.phi_q_dot_times(pose, v));
        let (part, ..) = reaction(&mass, [&row, &force], row.dot(&a) + drift);
        for (constraint, share) in shares(self.stick_slip(), &constraints) {
            holding[constraint.at.place] = part * share;
        }
        holding
    }

    /// Friction reactions that keep the whole mechanism at rest, as [`Frictional::holding`].
    fn holding_at_rest(&self, at: Posed<'_, Self::Pose, N>) -> [f64; FRICTION_PLACES] {
        self.torques_at_rest(at.q, at.v)
    }

    /// Friction reactions at rest by the equations of this system, as [`Frictional::holding`].
    fn torques_at_rest(&self, q: &Vector<N>, v: &Vector<N>) -> [f64; FRICTION_PLACES] {
        let mut holding = [0.0; FRICTION_PLACES];
        let friction_problem = FrictionProblem::new(self, q, v, &|_| true);
        for (place, torque) in friction_problem.places.iter().zip(friction_problem.resting_torques()) {
            holding[*place] = torque;
        }
        holding
    }

    /// Friction guards of the active places at a state, for event location.
    fn friction_guards(&self, places: impl Iterator<Item = FrictionPlace>, at: Posed<'_, Self::Pose, N>) -> FrictionGuards {
        let watched = self.stick_slip().any_sticks() && !self.stick_slip().at_rest();
        let holding = if watched { self.holding(at) } else { [0.0; FRICTION_PLACES] };
        let first = (0..FRICTION_PLACES).find(|place| watched && self.stick_slip().at(*place).sticks());
        let guard = |at: FrictionPlace| {
            let state = self.stick_slip().at(at.place);
            let carried = first.is_some_and(|first| first < at.place) && state.sticks();
            FrictionGuard { at, state, reaction: holding[at.place], carried }
        };
        places.map(guard).collect()
    }

    /// Directional derivative of q̈ and λ with sticking joints, from the derivative without friction: accelerations of sticking places stay
    /// 0. Refused if friction keeps the whole mechanism at rest or the tip sticks.
    fn varied(&self, [q, v]: [&Vector<N>; 2], (a, lambda): (Vector<N>, Vector<M>)) -> Result<(Vector<N>, Vector<M>), SceneError> {
        let stick_slip = self.stick_slip();
        if !stick_slip.any_sticks() {
            return Ok((a, lambda));
        }
        if stick_slip.at_rest() || stick_slip.at(TIP_FRICTION).sticks() {
            return Err(SceneError(
                "the tip sticks or friction locks the machine: derivatives are available only if the tip does not stick \
                 and the machine can move."
                    .into(),
            ));
        }
        let pose = self.pose(q);
        let StickingConstraint::Direction { row, force, .. } = self.sticking(q, &pose, v) else { return Ok((a, lambda)) };
        let (_, da, dlambda) = reaction(&self.factor_mass(&pose, self.regularization()), [&row, &force], row.dot(&a));
        Ok((a + da, lambda + dlambda))
    }

    /// Whether a run can reach this state with its stick-slip states. `just_stopped` allows the residual rates of a stop.
    fn are_possible(&self, q: &Vector<N>, v: &Vector<N>, just_stopped: bool) -> bool {
        /// Largest rate that may contradict a stick-slip state, in stick velocities.
        const LARGEST_CONTRADICTION: f64 = 2.0 * CARRIED_RATE;
        let stick_slip = self.stick_slip();
        if stick_slip.at_rest() {
            let all = FrictionProblem::new(self, q, &Vector::ZERO, &|_| true);
            let slowest = if just_stopped { REST_RATE * self.stick_velocity() } else { 0.0 };
            return v.max_norm() <= slowest && all.can_rest() && *stick_slip == stick_slip.resting(all.places.into_iter());
        }
        let pose = self.pose(q);
        let constraints = self.friction_constraints(Posed { q, pose: &pose, v }, all);
        let guards = self.friction_guards(constraints.into_iter().map(|constraint| constraint.at), Posed { q, pose: &pose, v });
        let far = LARGEST_CONTRADICTION * self.stick_velocity();
        let there = |place: usize| guards.iter().any(|guard| guard.at.place == place);
        (0..FRICTION_PLACES).all(|place| there(place) || matches!(stick_slip.at(place), StickSlip::Inactive | StickSlip::Still))
            && guards.iter().all(|FrictionGuard { at, state, reaction, .. }| match state {
                StickSlip::Inactive => false,
                StickSlip::Still => at.rate.abs() <= far,
                StickSlip::Slips(way) => way.sign() * at.rate >= -far,
                StickSlip::Sticks(_) => at.rate.abs() <= far && reaction.abs() <= (1.0 + 1e-3) * at.bound.abs() + 1e-9,
            })
    }
}

/// Largest rate from which friction can bring the mechanism to rest, in stick velocities: residual motion below it is within tolerances.
const REST_RATE: f64 = 1e3;

/// Largest rate at which a place can start to stick, in stick velocities. A faster place keeps its direction until it reaches its guard. If
/// it were set to slip the other way, it would be past its new guard at once, and so on without end.
const STICKING_RATE: f64 = CROSSING_RESIDUAL;

/// Rate at which a place that sticks only through the constraint of another place begins to slip, in stick velocities: smaller rates may be
/// errors of the steps.
const CARRIED_RATE: f64 = 50.0;

/// Accepts every state.
fn all(_: StickSlip) -> bool {
    true
}

/// States in which all places slip, except those that the closure branch locks.
fn slipping<const N: usize>(stick_slip: &StickSlips, constraints: &FrictionConstraints<N>) -> StickSlips {
    let mut slipping = stick_slip.opened();
    for FrictionConstraint { at, .. } in constraints.iter().filter(|constraint| !stick_slip.is_still(constraint.at.place)) {
        slipping.set(at.place, StickSlip::Slips(SlipDirection::of(at.rate)));
    }
    slipping
}

/// Whether a place can stick: its bound is positive and the closure branch lets it move.
fn is_able<const N: usize>(stick_slip: &StickSlips, constraint: &FrictionConstraint<N>) -> bool {
    constraint.at.bound > 0.0 && !stick_slip.is_still(constraint.at.place)
}

/// Accelerations r per unit of friction at a place with the given row, and M r, the part of the row that acts on motions allowed by the
/// closure. `None` if the closure keeps the place from moving, for example an elbow at its turning point.
///
/// Because of the regularisation e of the saddle-point system, r has a part of order e that violates the closure. The row responds to this
/// part as if the place could move; the response of M r is only of order e². A place can move if M r keeps nearly all of its mobility.
fn admissible_direction<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    (pose, mass): (&S::Pose, &S::Mass),
    row: &Vector<N>,
) -> Option<[Vector<N>; 2]> {
    /// Smallest part of a mobility that the closure must allow. Directions of rows are then accurate to a tenth of √e, relative to 1 over
    /// masses.
    const LEAST_PART: f64 = 0.99;
    let (response, _) = mass.solve(row, &Vector::ZERO);
    let admissible_row = system.mass_times(pose, &response);
    let is_mobile = admissible_row.dot(&response) > LEAST_PART * row.dot(&response).abs();
    is_mobile.then_some([response, admissible_row])
}

/// The constraint on the motion if all sticking places constrain the same direction.
fn sticking_direction<const N: usize>(stick_slip: &StickSlips, constraints: &FrictionConstraints<N>) -> StickingConstraint<N> {
    let Some(first) = constraints.first() else { return StickingConstraint::Nothing };
    let force = shares(stick_slip, constraints).fold(Vector::ZERO, |sum, (constraint, share)| sum + share * constraint.row);
    StickingConstraint::Direction { row: first.row, drift: first.drift, force }
}

/// The places of these constraints, which all constrain the same motion, with their torque per unit of the first place's torque: all use an
/// equal fraction of their bounds.
fn shares<'a, const N: usize>(
    stick_slip: &'a StickSlips,
    constraints: &'a FrictionConstraints<N>,
) -> impl Iterator<Item = (&'a FrictionConstraint<N>, f64)> {
    let first = constraints.first();
    constraints.iter().filter_map(move |constraint| {
        let StickSlip::Sticks(way) = stick_slip.at(constraint.at.place) else { return None };
        let leader = first?;
        let share = if constraint.at.place == leader.at.place { 1.0 } else { way.sign() * constraint.at.bound / leader.at.bound };
        Some((constraint, share))
    })
}

/// A friction place at a state, and its distance from the next transition between stick and slip.
#[derive(Clone, Copy, Debug)]
pub struct FrictionGuard {
    /// The place with its sliding rate.
    pub at: FrictionPlace,
    /// State of the place.
    pub state: StickSlip,
    /// Friction torque or force while sticking, N·m or N; 0 while slipping.
    pub reaction: f64,
    /// Whether the place sticks only through the constraint of another place. The two constraints then act on the same motion, until the
    /// mechanism leaves a singularity.
    pub carried: bool,
}

/// Guards of all active friction places at a state.
pub type FrictionGuards = ArrayVec<FrictionGuard, FRICTION_PLACES>;

/// Sliding rate below which a friction place counts as at rest, rad/s or m/s, for an angular tolerance, rad.
pub fn stick_velocity(tolerance: f64) -> f64 {
    (ERROR_RATE * tolerance).clamp(1e-11, 1e-6)
}

impl FrictionGuard {
    /// Guard value in units of the event tolerance, positive past the guard. It is the reversed rate while slipping, and the load above the
    /// bound while sticking.
    pub fn guard_residual(&self, tolerance: f64) -> f64 {
        let FrictionPlace { rate, bound, .. } = self.at;
        match self.state {
            StickSlip::Inactive | StickSlip::Still => f64::NEG_INFINITY,
            StickSlip::Slips(direction) => -direction.sign() * rate / stick_velocity(tolerance),
            StickSlip::Sticks(_) => (self.reaction.abs() - bound) / (1e-7 * bound.abs() + 1e-12),
        }
    }

    /// Sliding rate of a place that sticks through another's constraint, less the largest rate that errors explain, in units of the event
    /// tolerance.
    pub fn carried_residual(&self, tolerance: f64) -> f64 {
        if self.carried { self.at.rate.abs() / stick_velocity(tolerance) - CARRIED_RATE } else { f64::NEG_INFINITY }
    }

    /// Bounds on the first two derivatives of the sliding rate. The rate of a joint is a difference of link rates; the arms of the tip turn
    /// with the links.
    fn rate_bounds(&self, extremes: &Extremes) -> [f64; 2] {
        let FrictionPlace { place, arms, .. } = self.at;
        [(2, &extremes.accelerations), (3, &extremes.jerks)].map(|(order, fixed)| match place {
            TIP_FRICTION => derivative_bound(&arms, order, extremes),
            _ => (0..LINKS).map(|link| arms[link] * fixed[link]).sum(),
        })
    }

    /// Whether the sliding rate provably keeps its sign for `duration` seconds from this state, whatever the end state is.
    pub fn is_out_of_reach(&self, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let StickSlip::Slips(direction) = self.state else { return true };
        let [steepest, _] = self.rate_bounds(extremes);
        direction.sign() * self.at.rate - steepest * duration >= stick_velocity(tolerance)
    }

    /// Whether the sliding rate provably keeps its sign between this state and another state `duration` seconds later. The proof uses a
    /// bound on the rate's derivative, or on its distance from the chord.
    pub fn stays(&self, to: &Self, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let StickSlip::Slips(direction) = self.state else { return true };
        let [from, to] = [self.at.rate, to.at.rate].map(|rate| direction.sign() * rate);
        let [steepest, curvature] = self.rate_bounds(extremes);
        if from + to - steepest * duration >= -2.0 * stick_velocity(tolerance) {
            return true;
        }
        from.min(to) - curvature * duration * duration / 8.0 >= -stick_velocity(tolerance)
    }
}

/// Complementarity problem of the friction places with sliding rate 0: ẇ = G T + c with |T| ≤ b, and T = −b sign ẇ if ẇ ≠ 0.
#[derive(Clone, Debug, Default)]
pub struct FrictionProblem {
    /// Indices of the places in [`StickSlips`].
    pub places: ArrayVec<usize, FRICTION_PLACES>,
    /// Matrix G: sliding accelerations per unit of friction torque or force at each place.
    pub mobility: [[f64; FRICTION_PLACES]; FRICTION_PLACES],
    /// Vector c: sliding accelerations without friction at these places, rad/s² or m/s².
    pub change: [f64; FRICTION_PLACES],
    /// Bounds b, N·m or N, all positive.
    pub bounds: [f64; FRICTION_PLACES],
}

/// Tolerance of the inequalities relative to the bounds: far above round-off, far below any physical load.
const TOLERANCE: f64 = 1e-9;

/// Ridge (Tikhonov) parameter of the torques at rest, relative to the trace. The ridge makes torques unique that equilibrium leaves
/// undetermined.
const RIDGE: f64 = 1e-12;

/// A candidate solution of a [`FrictionProblem`]: the stick-slip state of each of its places.
type Candidate = [StickSlip; FRICTION_PLACES];

impl FrictionProblem {
    /// Problem of a system at q and q̇ for the places that may stick, can move and satisfy `rests`; the others slip.
    ///
    /// The rows act only on motions that the closure allows. With coaxial motors the inner joints share one motion; the regularisation
    /// would leave a small difference between their rows, which could prevent the rigid rotation.
    fn new<const N: usize, const M: usize>(
        system: &impl Frictional<N, M>,
        q: &Vector<N>,
        v: &Vector<N>,
        rests: &dyn Fn(&FrictionConstraint<N>) -> bool,
    ) -> Self {
        let pose = system.pose(q);
        let mass = system.factor_mass(&pose, system.regularization());
        let constraints = system.friction_constraints(Posed { q, pose: &pose, v }, all);
        let mut stick_slip = slipping(system.stick_slip(), &constraints);
        let mut resting = ArrayVec::<_, FRICTION_PLACES>::new();
        for constraint in constraints.iter().filter(|constraint| is_able(system.stick_slip(), constraint) && rests(constraint)) {
            if let Some(direction) = admissible_direction(system, (&pose, &mass), &constraint.row) {
                stick_slip.set(constraint.at.place, StickSlip::Sticks(SlipDirection::Forward));
                resting.push((constraint, direction));
            }
        }
        let forces = system.with_stick_slip(stick_slip).forces(q, &pose, v).0;
        let (by_forces, _) = mass.solve(&forces, &Vector::ZERO);
        // The regularisation leaves an error of order e in the accelerations from the closure. With a second correction it is of order e².
        let by_closure = -system.phi_q_dot_times(&pose, v);
        let once = mass.correction(&by_closure);
        let by_rates = once + mass.correction(&(by_closure - system.phi_q_times(&pose, &once)));
        let mut friction_problem = Self::default();
        for (i, (constraint, [_, row])) in resting.iter().enumerate() {
            friction_problem.places.push(constraint.at.place);
            friction_problem.bounds[i] = constraint.at.bound;
            friction_problem.change[i] = row.dot(&by_forces) + constraint.row.dot(&by_rates) + constraint.drift;
            for (j, (_, [response, _])) in resting.iter().enumerate() {
                friction_problem.mobility[i][j] = row.dot(response);
            }
        }
        friction_problem
    }

    fn len(&self) -> usize {
        self.places.len()
    }

    /// Largest acceleration that friction at place `i` alone can cause, rad/s² or m/s².
    fn scale(&self, i: usize) -> f64 {
        self.mobility[i][i] * self.bounds[i]
    }

    /// Whether friction can keep all places at rest and thereby stop the whole mechanism.
    pub fn can_rest(&self) -> bool {
        let n = self.len();
        let all = (0..n).any(|i| (0..i).any(|j| !self.are_parallel(i, j)));
        all && (self.least_squares_torques().is_some()
            || self.least_violating(2..=2).is_some_and(|(violation, _)| violation <= TOLERANCE))
    }

    /// Whether two places constrain the same motion: their rows are parallel.
    fn are_parallel(&self, i: usize, j: usize) -> bool {
        let g = &self.mobility;
        g[i][j] * g[i][j] >= (1.0 - TOLERANCE) * g[i][i] * g[j][j]
    }

    /// Torques or forces with which all places stick, N·m or N: the least sum of squares relative to the bounds. If these exceed the
    /// bounds, all places but two are at their bounds.
    pub fn resting_torques(&self) -> [f64; FRICTION_PLACES] {
        self.least_squares_torques().unwrap_or_else(|| {
            self.least_violating(2..=2).map_or([0.0; FRICTION_PLACES], |(_, candidate)| self.torques(&candidate))
        })
    }

    /// Least-squares torques T = D x with the bounds D, from (D G D + ε tr) x = −D c by Cholesky's method. `None` if a bound is exceeded or
    /// an acceleration remains.
    fn least_squares_torques(&self) -> Option<[f64; FRICTION_PLACES]> {
        let n = self.len();
        let trace: f64 = (0..n).map(|i| self.bounds[i] * self.scale(i)).sum();
        if trace <= 0.0 {
            return None;
        }
        let bounds = SVector::from(self.bounds);
        let matrix = SMatrix::<f64, FRICTION_PLACES, FRICTION_PLACES>::from_fn(|i, k| {
            let entry = if i < n && k < n { bounds[i] * self.mobility[i][k] * bounds[k] } else { 0.0 };
            if i == k { entry + RIDGE * trace } else { entry }
        });
        let x = matrix.cholesky()?.solve(&-bounds.component_mul(&SVector::from(self.change)));
        let torques = bounds.component_mul(&x).into();
        // If no torques keep all places at rest, the least-squares torques leave accelerations.
        let left = self.accelerations(&torques);
        let holds = (0..n).all(|i| x[i].abs() <= 1.0 && left[i].abs() <= 1e3 * TOLERANCE * self.scale(i));
        holds.then_some(torques)
    }

    /// Sliding accelerations ẇ = G T + c, rad/s² or m/s².
    fn accelerations(&self, torques: &[f64; FRICTION_PLACES]) -> [f64; FRICTION_PLACES] {
        std::array::from_fn(|i| self.change[i] + (0..self.len()).map(|k| self.mobility[i][k] * torques[k]).sum::<f64>())
    }

    /// Torques or forces of a candidate, N·m or N: the bound at a slipping place, the solution of ẇ = 0 at up to two sticking places.
    fn torques(&self, candidate: &Candidate) -> [f64; FRICTION_PLACES] {
        let mut torques: [f64; FRICTION_PLACES] = std::array::from_fn(|i| match candidate[i] {
            StickSlip::Slips(slip_direction) => -slip_direction.sign() * self.bounds[i],
            StickSlip::Sticks(_) | StickSlip::Inactive | StickSlip::Still => 0.0,
        });
        let left = self.accelerations(&torques);
        let mut held = (0..self.len()).filter(|i| candidate[*i].sticks());
        match (held.next(), held.next()) {
            (Some(i), None) => torques[i] = quotient(-left[i], self.mobility[i][i]),
            (Some(i), Some(j)) => {
                let [[a, b], [c, d]] = [[i, i], [j, j]].map(|[row, _]| [self.mobility[row][i], self.mobility[row][j]]);
                let determinant = a * d - b * c;
                torques[i] = quotient(b * left[j] - d * left[i], determinant);
                torques[j] = quotient(c * left[i] - a * left[j], determinant);
            }
            _ => {}
        }
        torques
    }

    /// The candidate with the smallest violation, relative to the bounds, among candidates with a number of sticking places in the range
    /// `holds`.
    fn least_violating(&self, holds: std::ops::RangeInclusive<usize>) -> Option<(f64, Candidate)> {
        let n = self.len();
        let mut least_violating: Option<(f64, Candidate)> = None;
        for mut code in 0..3_usize.pow(n as u32) {
            let mut candidate = [StickSlip::Inactive; FRICTION_PLACES];
            for state in &mut candidate[..n] {
                *state = [
                    StickSlip::Sticks(SlipDirection::Forward),
                    StickSlip::Slips(SlipDirection::Forward),
                    StickSlip::Slips(SlipDirection::Backward),
                ][code % 3];
                code /= 3;
            }
            let sticking: ArrayVec<usize, FRICTION_PLACES> = (0..n).filter(|i| candidate[*i].sticks()).collect();
            // Two places that constrain the same motion leave the other motion free.
            if !holds.contains(&sticking.len()) || matches!(sticking[..], [i, j] if self.are_parallel(i, j)) {
                continue;
            }
            let torques = self.torques(&candidate);
            let left = self.accelerations(&torques);
            let violation = (0..n).fold(0.0, |most: f64, i| {
                most.max(match candidate[i] {
                    StickSlip::Sticks(_) => torques[i].abs() / self.bounds[i] - 1.0,
                    StickSlip::Slips(slip_direction) if sticking.len() < 2 => {
                        quotient(-slip_direction.sign() * left[i], self.scale(i))
                    }
                    // Two sticking places stop the mechanism: accelerations of other places are round-off.
                    StickSlip::Slips(_) | StickSlip::Inactive | StickSlip::Still => 0.0,
                })
            });
            if least_violating.is_none_or(|(least, _)| violation < least) {
                least_violating = Some((violation, candidate));
            }
        }
        least_violating
    }

    /// Sets the states for a mechanism that moves or begins to move: at most one place sticks, together with places that constrain the same
    /// motion.
    pub fn resolve_motion(&self, stick_slip: &mut StickSlips) {
        let Some((_, mut candidate)) = self.least_violating(0..=1) else { return };
        let left = self.accelerations(&self.torques(&candidate));
        if let Some(sticking_place) = candidate.iter().position(|state| state.sticks()) {
            // Round-off from strong places accelerates a weak place.
            let greatest = |i: usize| (0..self.len()).map(|k| (self.mobility[i][k] * self.bounds[k]).abs()).sum::<f64>();
            let with =
                |i: usize| i == sticking_place || self.are_parallel(sticking_place, i) && left[i].abs() <= TOLERANCE * greatest(i);
            // Directions are relative to the first of these places, which may differ from `sticking_place`.
            let first = (0..sticking_place).find(|i| with(*i)).unwrap_or(sticking_place);
            for i in (first..self.len()).filter(|i| with(*i)) {
                candidate[i] = StickSlip::Sticks(SlipDirection::of(self.mobility[first][i]));
            }
        }
        for (place, state) in self.places.iter().zip(candidate) {
            stick_slip.set(*place, state);
        }
    }
}

/// The quotient x/y. If y is (nearly) 0, it is so large that it violates any bound.
fn quotient(x: f64, y: f64) -> f64 {
    /// Largest magnitude of the quotient: above any bound, while its square is still finite.
    const LARGEST_QUOTIENT: f64 = 1e100;
    if x == 0.0 {
        0.0
    } else if x.abs() < LARGEST_QUOTIENT * y.abs() {
        x / y
    } else {
        LARGEST_QUOTIENT * x.signum()
    }
}
