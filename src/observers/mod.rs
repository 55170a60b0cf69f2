//! Outputs that are not states, as pure functions of model and state. Steps never call them.
//!
//! [`Observed`] has one formula for the value of an output and its directional derivative. [`Observation`] caches expensive results for a
//! state until the instance changes.

mod observed;

use std::cell::OnceCell;

use nalgebra::Vector2;

use crate::effects::Inputs;
use crate::mechanism::Pose;
use crate::simulation::{Following, Model, State};

pub use crate::mechanism::singularity::{Jacobians, Singularity, SingularityKind};
pub use observed::{INDICATORS, Observed, Point};

/// A state with its accelerations for the current inputs, and a cache of expensive results.
#[derive(Debug)]
pub struct Observation {
    state: State,
    pose: Pose,
    /// Inputs that the master has set.
    inputs: Inputs,
    /// Kinetic and potential energy, J.
    energies: OnceCell<[f64; 2]>,
    /// Smallest singular value of Φ_q, the most expensive output.
    sigma_phi: OnceCell<f64>,
    /// Probability of a direct singularity within the horizon; its forecast takes about a thousand steps.
    singularity_probability: OnceCell<f64>,
}

/// Access to the estimates about a measured machine.
#[derive(Clone, Copy, Debug)]
pub struct Estimated<'a> {
    /// The simulation with its estimator.
    pub following: &'a Following,
    observation: &'a Observation,
}

impl Estimated<'_> {
    /// Probability of a direct singularity within the horizon if the current inputs stay constant.
    pub fn singularity_probability(&self) -> f64 {
        let Observation { singularity_probability, inputs, .. } = self.observation;
        *singularity_probability.get_or_init(|| self.following.singularity_probability(inputs))
    }
}

impl Observation {
    /// Creates the observation of a state, with an empty cache. `inputs` are those that the master has set; the inputs of the state act.
    pub fn new(model: &Model, state: State, inputs: &Inputs) -> Self {
        let pose = model.mechanism.pose(&state.core.q);
        let (energies, sigma_phi, singularity_probability) = Default::default();
        Self { state, pose, inputs: *inputs, energies, sigma_phi, singularity_probability }
    }

    /// The observed state.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Kinetic and potential energy, J.
    pub fn energies(&self, model: &Model) -> [f64; 2] {
        *self.energies.get_or_init(|| [self.state.kinetic_energy(model), self.state.potential_energy(model)])
    }

    /// Smallest singular value of Φ_q (rows in m, columns in m and rad).
    pub fn sigma_phi(&self) -> f64 {
        *self.sigma_phi.get_or_init(|| self.pose.smallest_singular_value())
    }
}

/// Angles, rates and accelerations of the links; positions, velocities and accelerations of tip and elbows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Absolute angles of links 1 to 4 (left proximal, left distal, right distal, right proximal), rad, not wrapped.
    pub theta: [f64; 4],
    /// Rates of the links, rad/s.
    pub omega: [f64; 4],
    /// Accelerations of the links, rad/s².
    pub alpha: [f64; 4],
    /// Position of the tip, m.
    pub tip: Vector2<f64>,
    /// Velocity of the tip, m/s.
    pub tip_velocity: Vector2<f64>,
    /// Acceleration of the tip, m/s².
    pub tip_acceleration: Vector2<f64>,
    /// Positions of the left and right elbow, m.
    pub elbows: [Vector2<f64>; 2],
}

/// Energies, J.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energies {
    /// Kinetic energy, J.
    pub kinetic: f64,
    /// Potential energy, J.
    pub potential: f64,
    /// Work of the inputs since the start, J.
    pub input: f64,
    /// Energy dissipated since the start, J.
    pub dissipated: f64,
    /// Residual of the balance, J: kinetic + potential + dissipated − input, minus its value at the start.
    pub error: f64,
}

/// Largest constraint violations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstraintNorms {
    /// max |Φ|, m.
    pub position: f64,
    /// max |Φ_q q̇|, m/s.
    pub velocity: f64,
    /// max |Φ_q q̈ + Φ̇_q q̇|, m/s².
    pub acceleration: f64,
}

/// Evaluates an observer at a state without a cache.
fn at<T>(model: &Model, state: &State, observe: impl FnOnce(Observed<'_, f64>) -> T) -> T {
    observe(Observed::new(model, &Observation::new(model, *state, &state.inputs)))
}

/// Angles, points and their time derivatives.
pub fn motion(model: &Model, state: &State) -> Motion {
    at(model, state, |of| {
        let point = |point, order| Vector2::from(of.point(point, order));
        Motion {
            theta: std::array::from_fn(|link| of.angle(link, 0)),
            omega: std::array::from_fn(|link| of.angle(link, 1)),
            alpha: std::array::from_fn(|link| of.angle(link, 2)),
            tip: point(Point::Tip, 0),
            tip_velocity: point(Point::Tip, 1),
            tip_acceleration: point(Point::Tip, 2),
            elbows: [0, 1].map(|leg| point(Point::Elbow(leg), 0)),
        }
    })
}

/// Forces of joints 1 to 5 on their first-named links, N; see [`Observed::reaction`].
pub fn reactions(model: &Model, state: &State) -> [Vector2<f64>; 5] {
    at(model, state, |of| std::array::from_fn(|joint| of.reaction(joint).into()))
}

/// Energies and their balance.
pub fn energies(model: &Model, state: &State) -> Energies {
    let (kinetic, potential) = (state.kinetic_energy(model), state.potential_energy(model));
    let (input, dissipated) = (state.core.work.input, state.core.work.dissipated);
    Energies { kinetic, potential, input, dissipated, error: state.energy_error(model) }
}

/// Torques of the left and right servo on their proximal links, N·m; 0 without servos.
pub fn servo_torques(model: &Model, state: &State) -> [f64; 2] {
    at(model, state, |of| of.servo_torques())
}

/// Force of the contact plane on the tip, N; 0 without contact.
pub fn contact_force(model: &Model, state: &State) -> Vector2<f64> {
    at(model, state, |of| of.contact_force().into())
}

/// Determinants, smallest singular values and signs of the configuration.
pub fn singularity(model: &Model, state: &State) -> Singularity {
    at(model, state, |of| {
        let (jacobians, sigma_phi) = (of.jacobians(), of.sigma_phi());
        let kind = model.mechanism.geometry.singularity_kind(&jacobians, sigma_phi);
        Singularity { jacobians, sigma_phi, kind }
    })
}

/// Constraint violations.
pub fn constraint_norms(model: &Model, state: &State) -> ConstraintNorms {
    let core = &state.core;
    let pose = model.mechanism.pose(&core.q);
    ConstraintNorms {
        position: model.mechanism.phi(&core.q, &pose).max_norm(),
        velocity: pose.phi_q_times(&core.v).max_norm(),
        acceleration: (pose.phi_q_times(&core.a) + pose.phi_q_dot_times(&core.v)).max_norm(),
    }
}
