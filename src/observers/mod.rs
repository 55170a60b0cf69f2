//! What a user looks at: pure functions of (model, state). Never called by a step.

mod variation;

use nalgebra::Vector2;

use crate::effects::Effect;
use crate::mechanism::constraints::largest;
use crate::mechanism::coordinates::{E_X, E_Y, G_X, G_Y, THETA, TIP_X, TIP_Y, X, Y};
use crate::mechanism::{Coordinates, Link, Multipliers};
use crate::simulation::{Model, State};

pub use crate::mechanism::singularity::{Jacobians, Singularity, SingularityKind};
pub use variation::{OutputChanges, SingularityChanges, output_changes, sigma_phi_change};

/// Angles, rates and accelerations of the links, and the points that a user sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Absolute angles of links 1 to 4 (left proximal, left distal, right distal, right proximal), rad, not wrapped.
    pub theta: [f64; 4],
    /// Their rates, rad/s.
    pub omega: [f64; 4],
    /// Their accelerations, rad/s².
    pub alpha: [f64; 4],
    /// Position of the tip, m.
    pub tip: Vector2<f64>,
    /// Velocity of the tip, m/s.
    pub tip_velocity: Vector2<f64>,
    /// Acceleration of the tip, m/s².
    pub tip_acceleration: Vector2<f64>,
    /// Positions of the left and right elbow, m.
    pub elbows: [Vector2<f64>; 2],
    /// Their velocities, m/s.
    pub elbow_velocities: [Vector2<f64>; 2],
    /// Their accelerations, m/s².
    pub elbow_accelerations: [Vector2<f64>; 2],
}

/// Energies, J.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energies {
    /// Kinetic energy.
    pub kinetic: f64,
    /// Potential energy.
    pub potential: f64,
    /// Work of the inputs since the start.
    pub input: f64,
    /// Energy dissipated since the start.
    pub dissipated: f64,
    /// Balance residual: kinetic + potential + dissipated − input, minus its value at the start.
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

/// Position, velocity and acceleration of a point on a link, `arm` m beyond its centre of mass.
fn point(state: &State, link: usize, arm: f64) -> [Vector2<f64>; 3] {
    let core = &state.core;
    let centre = |x: &Coordinates| Vector2::new(x[X[link]], x[Y[link]]);
    let (sin, cos) = libm::sincos(core.q[THETA[link]]);
    let (radial, across) = (Vector2::new(cos, sin) * arm, Vector2::new(-sin, cos) * arm);
    let (omega, alpha) = (core.v[THETA[link]], core.a[THETA[link]]);
    [centre(&core.q) + radial, centre(&core.v) + across * omega, centre(&core.a) + across * alpha - radial * (omega * omega)]
}

/// Motion of the links.
pub fn motion(model: &Model, state: &State) -> Motion {
    let core = &state.core;
    let end = |link: usize| {
        let Link { length, com, .. } = model.mechanism.geometry.links[link];
        point(state, link, length - com)
    };
    let [tip, tip_velocity, tip_acceleration] = end(1);
    let [left, right] = [end(0), end(3)];
    Motion {
        theta: state.angles(),
        omega: THETA.map(|i| core.v[i]),
        alpha: THETA.map(|i| core.a[i]),
        tip,
        tip_velocity,
        tip_acceleration,
        elbows: [left[0], right[0]],
        elbow_velocities: [left[1], right[1]],
        elbow_accelerations: [left[2], right[2]],
    }
}

/// Forces of joints 1 to 5 (left base, left elbow, tip, right elbow, right base) on their first-named links (1, 2, 2, 3, 4), N.
///
/// M q̈ = Q − Φ_qᵀλ: each constraint pulls with −λ on the link that enters it with a plus.
pub fn reactions(state: &State) -> [Vector2<f64>; 5] {
    reactions_of(&state.core.lambda)
}

fn reactions_of(lambda: &Multipliers) -> [Vector2<f64>; 5] {
    let pull = |x: usize, y: usize| -Vector2::new(lambda[x], lambda[y]);
    let (left, right) = (0, 1);
    let (ground, elbow) = (|leg| pull(2 * G_X + leg, 2 * G_Y + leg), |leg| pull(2 * E_X + leg, 2 * E_Y + leg));
    [ground(left), elbow(left), pull(TIP_X, TIP_Y), elbow(right), ground(right)]
}

/// Energies and their balance.
pub fn energies(model: &Model, state: &State) -> Energies {
    let core = &state.core;
    let (kinetic, potential) = (state.kinetic_energy(model), state.potential_energy(model));
    let (input, dissipated) = (core.work.input, core.work.dissipated);
    Energies { kinetic, potential, input, dissipated, error: kinetic + potential + dissipated - input - state.energy_at_start }
}

/// Torques of the left and right servo on their proximal links, N·m; 0 without servos.
pub fn servo_torques(model: &Model, state: &State) -> [f64; 2] {
    let torques =
        |effect: &Effect| if let Effect::Servo(servo) = effect { Some(state.at(model, |at| servo.torques(at))) } else { None };
    model.effects.iter().find_map(torques).unwrap_or_default()
}

/// Force of the contact plane on the tip, N; 0 without contact.
pub fn contact_force(model: &Model, state: &State) -> Vector2<f64> {
    let force =
        |effect: &Effect| if let Effect::Contact(contact) = effect { Some(state.at(model, |at| contact.force(at))) } else { None };
    model.effects.iter().find_map(force).unwrap_or_default().into()
}

/// Determinants and modes.
pub fn jacobians(model: &Model, state: &State) -> Jacobians {
    model.mechanism.jacobians(&model.mechanism.pose(&state.core.q))
}

/// Distance to the singularities, and the modes.
pub fn singularity(model: &Model, state: &State) -> Singularity {
    model.mechanism.singularity(&model.mechanism.pose(&state.core.q))
}

/// Constraint violations.
pub fn constraint_norms(model: &Model, state: &State) -> ConstraintNorms {
    let core = &state.core;
    let pose = model.mechanism.pose(&core.q);
    let (acceleration, centripetal) = (pose.phi_q_times(&core.a), pose.phi_q_dot_times(&core.v));
    ConstraintNorms {
        position: largest(&model.mechanism.phi(&core.q, &pose)),
        velocity: largest(&pose.phi_q_times(&core.v)),
        acceleration: largest(&std::array::from_fn(|i| acceleration[i] + centripetal[i])),
    }
}
