//! Pure functions of (model, state); never called by a step.

use nalgebra::Vector2;

use crate::mechanism::Assembly;
use crate::simulation::{Model, State};

/// Angles, rates and accelerations of the links, and the points that a user sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Absolute link angles (left proximal, left distal, right distal, right proximal), rad.
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
    /// kinetic + potential + dissipated − input, minus its value at the start.
    pub error: f64,
}

/// The gravest singularity within reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SingularityKind {
    /// Regular posture.
    None,
    /// Distal links in line.
    Direct,
    /// A leg stretched or folded.
    Inverse,
    /// Both.
    Combined,
    /// The constraint Jacobian loses rank.
    Constraint,
}

/// Distance to the singularities, and the modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Singularity {
    /// det J_x, m².
    pub det_jx: f64,
    /// det J_q, m⁴.
    pub det_jq: f64,
    /// Smallest singular value of J_x, m.
    pub sigma_jx: f64,
    /// Smallest singular value of J_q, m².
    pub sigma_jq: f64,
    /// Smallest singular value of Φ_q.
    pub sigma_phi: f64,
    /// The gravest singularity within reach.
    pub kind: SingularityKind,
    /// Side on which the tip lies now.
    pub assembly: Assembly,
    /// Whether the left and the right leg bend counter-clockwise.
    pub working: [bool; 2],
}

/// Largest constraint violations: position (m) and velocity (m/s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstraintNorms {
    /// max |Φ|, m.
    pub position: f64,
    /// max |Φ_q q̇|, m/s.
    pub velocity: f64,
}

/// Motion of the links.
pub fn motion(_model: &Model, _state: &State) -> Motion {
    todo!()
}
/// Forces of the joints on their first-named links, N.
pub fn reactions(_model: &Model, _state: &State) -> [Vector2<f64>; 5] {
    todo!()
}
/// Energies.
pub fn energies(_model: &Model, _state: &State) -> Energies {
    todo!()
}
/// Singularities.
pub fn singularity(_model: &Model, _state: &State) -> Singularity {
    todo!()
}
/// Constraint norms.
pub fn constraint_norms(_model: &Model, _state: &State) -> ConstraintNorms {
    todo!()
}
