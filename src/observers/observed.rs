//! The formulas of the outputs, once for their values and for their changes along a direction.

use std::marker::PhantomData;

use num_dual::Dual64;

use super::{Estimated, Observation};
use crate::effects::{self, Effect, ForceContext, FrictionGuards, GuardValues};
use crate::mechanism::coordinates::{E_X, E_Y, G_X, G_Y, THETA, TIP_X, TIP_Y, X, Y};
use crate::mechanism::singularity::{Jacobians, rank_indicator};
use crate::mechanism::{Coordinates, SceneError, SingularValue, closure};
use crate::scalar::Scalar;
use crate::simulation::{Following, Model, Variation};

/// An observation seen in numbers, or in dual numbers that carry the changes along a direction.
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a, T> {
    model: &'a Model,
    observation: &'a Observation,
    along: Option<&'a Variation>,
    following: Option<&'a Following>,
    scalar: PhantomData<T>,
}

/// Number of [`Observed::indicators`].
pub const INDICATORS: usize = 6 + effects::INDICATORS;

/// A point that a user sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// Where the distal links meet.
    Tip,
    /// That of the left (0) or right (1) leg.
    Elbow(usize),
}

impl<'a> Observed<'a, f64> {
    /// The values.
    pub fn new(model: &'a Model, observation: &'a Observation) -> Self {
        Self { model, observation, along: None, following: None, scalar: PhantomData }
    }

    /// The same of a machine that is followed.
    pub fn of_estimate(self, following: &'a Following) -> Self {
        Self { following: Some(following), ..self }
    }
}

impl Observed<'_, f64> {
    /// Refuses a direct singularity, where the proximal angles and rates are no coordinates.
    pub fn check_direct_singularity(&self) -> Result<(), SceneError> {
        let [tip, ..] = self.observation.pose.configuration_indicators();
        closure::check_direct_singularity(tip)
    }

    /// Numbers that change sign where a mode, the kind of singularity or the side of a kink changes: modes, nearness of direct, inverse
    /// and constraint singularities, kinks.
    pub fn indicators(&self) -> [f64; INDICATORS] {
        let [.., direct, inverse] = self.observation.pose.configuration_indicators();
        // The constraints lose rank only where both are near, and to know it costs more than all else.
        let rank = if direct < 0.0 && inverse < 0.0 { rank_indicator(self.observation.sigma_phi()) } else { 1.0 };
        let kinks = self.at(|at| GuardValues::new(&self.model.effects, at, FrictionGuards::new()).indicators());
        let mut indicators = [rank; INDICATORS];
        indicators[..5].copy_from_slice(&self.observation.pose.configuration_indicators());
        indicators[6..].copy_from_slice(&kinks);
        indicators
    }
}

impl<'a> Observed<'a, Dual64> {
    /// The values with their changes along a direction.
    pub fn along(model: &'a Model, observation: &'a Observation, along: &'a Variation) -> Self {
        Self { model, observation, along: Some(along), following: None, scalar: PhantomData }
    }
}

impl<T: Scalar> Observed<'_, T> {
    /// The model.
    pub fn model(&self) -> &Model {
        self.model
    }

    /// The observation.
    pub fn observation(&self) -> &Observation {
        self.observation
    }

    /// What has been estimated, where a machine is followed.
    pub fn estimated(&self) -> Option<Estimated<'_>> {
        self.following.map(|following| Estimated { following, observation: self.observation })
    }

    /// A value with its change.
    fn varying(&self, value: f64, change: impl FnOnce(&Variation) -> f64) -> T {
        T::with(value, || self.along.map_or(0.0, change))
    }

    /// A value that does not change: what is only counted, judged or followed along the path.
    pub fn constant(&self, value: f64) -> T {
        T::with(value, || 0.0)
    }

    /// Derivative of an order up to 2 of a coordinate with respect to time.
    fn coordinate(&self, place: usize, order: usize) -> T {
        let core = &self.observation.state.core;
        match order {
            0 => self.varying(core.q[place], |along| along.change.q[place]),
            1 => self.varying(core.v[place], |along| along.change.v[place]),
            _ => self.varying(core.a[place], |along| along.a[place]),
        }
    }

    /// Absolute angle of a link from 0 to 3, rad, not wrapped, or its derivative of an order up to 2.
    pub fn angle(&self, link: usize, order: usize) -> T {
        match order {
            0 => self.varying(self.observation.state.angles()[link], |along| along.change.q[THETA[link]]),
            _ => self.coordinate(THETA[link], order),
        }
    }

    /// Direction û of a link.
    fn direction(&self, link: usize) -> [T; 2] {
        let [x, y] = self.observation.pose.directions()[link];
        let turned = |along: &Variation| along.change.q[THETA[link]];
        [self.varying(x, |along| -y * turned(along)), self.varying(y, |along| x * turned(along))]
    }

    /// Position of a point, m, or its derivative of an order up to 2.
    pub fn point(&self, point: Point, order: usize) -> [T; 2] {
        let link = match point {
            Point::Tip => 1,
            Point::Elbow(leg) => [0, 3][leg],
        };
        let body = self.model.mechanism.geometry.links[link];
        let [x, y] = self.direction(link).map(|u| u * (body.length - body.com));
        let [centre_x, centre_y] = [X[link], Y[link]].map(|place| self.coordinate(place, order));
        match order {
            0 => [centre_x + x, centre_y + y],
            1 => {
                let omega = self.angle(link, 1);
                [centre_x - y * omega, centre_y + x * omega]
            }
            _ => {
                let (omega, alpha) = (self.angle(link, 1), self.angle(link, 2));
                [centre_x - y * alpha - x * (omega * omega), centre_y + x * alpha - y * (omega * omega)]
            }
        }
    }

    /// Force of a joint from 0 to 4 (left base, left elbow, tip, right elbow, right base) on its first-named link (1, 2, 2, 3, 4), N.
    ///
    /// M q̈ = Q − Φ_qᵀλ: each constraint pulls with −λ on the link that enters it with a plus.
    pub fn reaction(&self, joint: usize) -> [T; 2] {
        let places = match joint {
            0 => [2 * G_X, 2 * G_Y],
            1 => [2 * E_X, 2 * E_Y],
            2 => [TIP_X, TIP_Y],
            3 => [2 * E_X + 1, 2 * E_Y + 1],
            _ => [2 * G_X + 1, 2 * G_Y + 1],
        };
        places.map(|i| self.varying(-self.observation.state.core.lambda[i], |along| -along.lambda[i]))
    }

    /// Kinetic energy, J.
    pub fn kinetic_energy(&self) -> T {
        let [kinetic, _] = self.observation.energies(self.model);
        let v = &self.observation.state.core.v;
        self.varying(kinetic, |along| self.model.mechanism.mass_times(v).dot(&along.change.v))
    }

    /// Potential energy, J.
    pub fn potential_energy(&self) -> T {
        let [_, potential] = self.observation.energies(self.model);
        self.varying(potential, |along| self.at(|at| self.model.potential_change(at, &along.change)))
    }

    /// Balance residual of the energy, J.
    pub fn energy_error(&self) -> T {
        let (state, work) = (&self.observation.state, self.observation.state.core.work);
        self.kinetic_energy() + self.potential_energy() + self.constant(work.dissipated)
            - self.constant(work.input)
            - self.constant(state.energy_at_start)
    }

    /// Torques of the left and right servo on their proximal links, N·m; 0 without servos.
    pub fn servo_torques(&self) -> [T; 2] {
        self.force_of([THETA[0], THETA[3]], |effect, at| match effect {
            Effect::Servo(servo) => Some(servo.torques(at)),
            _ => None,
        })
    }

    /// Force of the contact plane on the tip, N; 0 without contact.
    pub fn contact_force(&self) -> [T; 2] {
        let holding = self.observation.state.holding(self.model);
        // What acts on the tip acts on link 2, with its force in the rows of the centre of mass.
        self.force_of([X[1], Y[1]], |effect, at| match effect {
            Effect::Contact(contact) => Some(contact.force(at, &holding)),
            _ => None,
        })
    }

    /// What the one effect that answers says of its force, whose rows these are; 0 where none does.
    fn force_of(&self, rows: [usize; 2], answer: impl Fn(&Effect, &ForceContext) -> Option<[f64; 2]>) -> [T; 2] {
        let found = self.model.effects.iter().find_map(|effect| Some((effect, self.at(|at| answer(effect, at))?)));
        let Some((effect, force)) = found else { return [self.constant(0.0); 2] };
        [0, 1].map(|i| self.varying(force[i], |along| self.force_change(effect, along)[rows[i]]))
    }

    /// How the generalised force of an effect changes.
    fn force_change(&self, effect: &Effect, along: &Variation) -> Coordinates {
        self.at(|at| effect.force_change(at, &along.change))
    }

    /// What effects answer.
    fn at<R>(&self, answer: impl FnOnce(&ForceContext) -> R) -> R {
        self.observation.state.at(self.model, answer)
    }

    /// Determinants, smallest singular values and modes.
    pub fn jacobians(&self) -> Jacobians<T> {
        self.model.mechanism.geometry.jacobians([0, 1, 2, 3].map(|link| self.direction(link)))
    }

    /// Smallest singular value σ of Φ_q (rows in m, columns in m and rad). Its change is uᵀ δΦ_q v with its singular vectors.
    pub fn sigma_phi(&self) -> T {
        self.varying(self.observation.sigma_phi(), |along| {
            let pose = &self.observation.pose;
            let changes = |SingularValue { value, left, right }| {
                Dual64::new(value, pose.phi_q_varied_times(&along.change.q, &right).dot(&left))
            };
            Dual64::smallest(pose.singular_values().map(changes)).eps
        })
    }
}
