//! What of the estimator is constant in a scene.

use super::linkage::{Frame, Linkage, Pair};
use super::{Parameters, track};
use crate::mechanism::Geometry;

/// In units of the torque scale: what the unknown force may be at the start.
const UNKNOWN_FORCE: f64 = 0.3;

/// What is constant.
#[derive(Clone, Debug, PartialEq)]
pub struct Constants {
    pub(super) geometry: Geometry,
    /// The mechanism in its link angles.
    pub linkage: Linkage,
    /// The parameters in force.
    pub parameters: Parameters,
}

impl Constants {
    /// Of a geometry with all masses.
    pub fn new(geometry: &Geometry, parameters: &Parameters) -> Self {
        Self { geometry: *geometry, linkage: Linkage::new(geometry), parameters: parameters.clone() }
    }

    /// The torque in which the unknown force is measured, N·m.
    pub fn torque_scale(&self) -> f64 {
        if self.parameters.torque_scale > 0.0 { self.parameters.torque_scale } else { self.linkage.weight_torque }
    }

    /// Variances of angles, rates and the unknown force at the start.
    pub(super) fn start_variances(&self) -> [f64; 3] {
        let Parameters { sigma0_theta, sigma0_omega, .. } = self.parameters;
        [sigma0_theta, sigma0_omega, UNKNOWN_FORCE * self.torque_scale()].map(|sigma| sigma * sigma)
    }

    /// The inputs by which a unit of each force on the tangent basis acts.
    pub fn by_inputs(&self, at: &Frame) -> [Pair; 4] {
        track::by_inputs(&self.linkage, at)
    }
}
