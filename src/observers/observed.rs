//! Formulas of the outputs, generic over plain numbers (values) and dual numbers (directional derivatives).

use std::marker::PhantomData;

use num_dual::Dual64;

use super::{Estimated, Observation};
use crate::effects::{Effect, MOTOR_ANGLES, Motion, Wrench};
use crate::hybrid::{self, FrictionGuards, GuardValues};
use crate::mechanism::coordinates::{E_X, E_Y, G_X, G_Y, THETA, TIP_X, TIP_Y, X, Y};
use crate::mechanism::singularity::{Jacobians, rank_indicator};
use crate::mechanism::{SceneError, SingularValue, closure};
use crate::scalar::Scalar;
use crate::simulation::{Following, Model, Variation, wrench_change};

/// An observation in plain numbers, or in dual numbers with derivatives along a direction.
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a, T> {
    model: &'a Model,
    observation: &'a Observation,
    along: Option<&'a Variation>,
    following: Option<&'a Following>,
    scalar: PhantomData<T>,
}

/// Number of [`Observed::indicators`].
pub const INDICATORS: usize = 6 + hybrid::INDICATORS;

/// A point of the mechanism that has its own outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// Joint of the distal links.
    Tip,
    /// Elbow of the left (0) or right (1) leg.
    Elbow(usize),
}

impl<'a> Observed<'a, f64> {
    /// Observer of values.
    pub fn new(model: &'a Model, observation: &'a Observation) -> Self {
        Self { model, observation, along: None, following: None, scalar: PhantomData }
    }

    /// Adds the estimates about a measured machine.
    pub fn with_estimates(self, following: Option<&'a Following>) -> Self {
        Self { following, ..self }
    }
}

impl Observed<'_, f64> {
    /// Refuses a direct singularity: there the proximal angles and rates are no coordinates of the state.
    pub fn check_direct_singularity(&self) -> Result<(), SceneError> {
        let [tip, ..] = self.observation.pose.configuration_indicators();
        closure::check_direct_singularity(tip)
    }

    /// Event indicators. They change sign when a configuration sign, the kind of singularity or the mode of a force law changes. Six belong
    /// to the mechanism (signs; nearness of direct, inverse and constraint singularities), the others to the effects.
    pub fn indicators(&self) -> [f64; INDICATORS] {
        let of_configuration = self.observation.pose.configuration_indicators();
        let [.., direct, inverse] = of_configuration;
        // σ_Φ is the most expensive output. The constraints lose rank only if a direct and an inverse singularity are both near.
        let rank = if direct < 0.0 && inverse < 0.0 { rank_indicator(self.observation.sigma_phi()) } else { 1.0 };
        let at = self.motion();
        let of_kinks = GuardValues::new(at.joints.mode, self.model.kinks(&at), FrictionGuards::new()).indicators();
        let mut indicators = [rank; INDICATORS];
        indicators[..5].copy_from_slice(&of_configuration);
        indicators[6..].copy_from_slice(&of_kinks);
        indicators
    }
}

impl<'a> Observed<'a, Dual64> {
    /// Observer of values and their derivatives along a direction.
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

    /// The estimates, if a machine is tracked.
    pub fn estimated(&self) -> Option<Estimated<'_>> {
        self.following.map(|following| Estimated { following, observation: self.observation })
    }

    /// A value with its derivative along the direction.
    fn varying(&self, value: f64, change: impl FnOnce(&Variation) -> f64) -> T {
        T::with(value, || self.along.map_or(0.0, change))
    }

    /// A value with derivative 0: counters, enumerations and integrals along the trajectory.
    pub fn constant(&self, value: f64) -> T {
        T::with(value, || 0.0)
    }

    /// A coordinate or its first or second time derivative.
    fn coordinate(&self, place: usize, order: usize) -> T {
        let core = &self.observation.state.core;
        match order {
            0 => self.varying(core.q[place], |along| along.q[place]),
            1 => self.varying(core.v[place], |along| along.v[place]),
            _ => self.varying(core.a[place], |along| along.a[place]),
        }
    }

    /// Absolute angle of a link from 0 to 3, rad, not wrapped, or its first or second time derivative.
    pub fn angle(&self, link: usize, order: usize) -> T {
        match order {
            0 => self.varying(self.observation.state.angles()[link], |along| along.q[THETA[link]]),
            _ => self.coordinate(THETA[link], order),
        }
    }

    /// Direction û of a link.
    fn direction(&self, link: usize) -> [T; 2] {
        let [x, y] = self.observation.pose.directions()[link];
        let turned = |along: &Variation| along.q[THETA[link]];
        [self.varying(x, |along| -y * turned(along)), self.varying(y, |along| x * turned(along))]
    }

    /// Position of a point, m, or its first or second time derivative.
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
    /// M q̈ = Q − Φ_qᵀλ: each constraint acts with −λ on the link that enters it with a plus sign.
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
        self.varying(kinetic, |along| self.model.mechanism.mass_times(v).dot(&along.v))
    }

    /// Potential energy, J.
    pub fn potential_energy(&self) -> T {
        let [_, potential] = self.observation.energies(self.model);
        self.varying(potential, |along| self.model.potential_change(&along.q, &self.motion(), &along.motion))
    }

    /// Residual of the energy balance, J.
    pub fn energy_error(&self) -> T {
        let (state, work) = (&self.observation.state, self.observation.state.core.work);
        self.kinetic_energy() + self.potential_energy() + self.constant(work.dissipated)
            - self.constant(work.input)
            - self.constant(state.energy_at_start)
    }

    /// Torques of the left and right servo on their proximal links, N·m; 0 without servos.
    pub fn servo_torques(&self) -> [T; 2] {
        let of_motors = |wrench: Wrench| MOTOR_ANGLES.map(|joint| wrench.torques[joint]);
        let servo = |effect: &Effect, at: &Motion| {
            let Effect::Servo(_) = effect else { return None };
            let mut wrench = Wrench::default();
            effect.act(at, &mut wrench);
            Some(of_motors(wrench))
        };
        self.answer_of(servo, of_motors)
    }

    /// Force of the contact plane on the tip, N; 0 without contact.
    pub fn contact_force(&self) -> [T; 2] {
        let holding = self.observation.state.holding(self.model);
        let contact = |effect: &Effect, at: &Motion| match effect {
            Effect::Contact(contact) => Some(contact.force(at, &holding)),
            _ => None,
        };
        self.answer_of(contact, |wrench| wrench.force)
    }

    /// Force or torques of the first effect for which `answer` returns them; the derivative is the same `part` of the change of its wrench.
    /// 0 if no effect returns any.
    fn answer_of(&self, answer: impl Fn(&Effect, &Motion) -> Option<[f64; 2]>, part: impl Fn(Wrench) -> [f64; 2]) -> [T; 2] {
        let at = self.motion();
        let found = self.model.effects.iter().find_map(|effect| Some((effect, answer(effect, &at)?)));
        let Some((effect, force)) = found else { return [self.constant(0.0); 2] };
        [0, 1].map(|i| self.varying(force[i], |along| part(wrench_change(effect, &at, &along.motion, &along.inputs))[i]))
    }

    /// Motion of joints and tip in the observed state.
    fn motion(&self) -> Motion<'_> {
        self.observation.state.motion(self.model)
    }

    /// Determinants, smallest singular values and modes.
    pub fn jacobians(&self) -> Jacobians<T> {
        self.model.mechanism.geometry.jacobians([0, 1, 2, 3].map(|link| self.direction(link)))
    }

    /// Smallest singular value σ of Φ_q (rows in m, columns in m and rad). Its derivative is uᵀ δΦ_q v with the singular vectors u and v.
    pub fn sigma_phi(&self) -> T {
        self.varying(self.observation.sigma_phi(), |along| {
            let pose = &self.observation.pose;
            let changes =
                |SingularValue { value, left, right }| Dual64::new(value, pose.phi_q_varied_times(&along.q, &right).dot(&left));
            Dual64::smallest(pose.singular_values().map(changes)).eps
        })
    }
}
