//! Data of the estimator that stay constant between changes of parameters.

use super::linkage::{Frame, Linkage, Pair};
use super::{Parameters, track};
use crate::mechanism::Geometry;

/// Standard deviation of the unknown force at the start, in torque scales.
const UNKNOWN_FORCE: f64 = 0.3;

/// Data of the estimator that stay constant between changes of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Constants {
    pub(super) geometry: Geometry,
    /// The mechanism in its link angles.
    pub linkage: Linkage,
    /// The parameters in force.
    pub parameters: Parameters,
}

impl Constants {
    /// Constant data for a geometry that includes all masses.
    pub fn new(geometry: &Geometry, parameters: &Parameters) -> Self {
        Self { geometry: *geometry, linkage: Linkage::new(geometry), parameters: parameters.clone() }
    }

    /// Torque scale of the unknown force, N·m.
    pub fn torque_scale(&self) -> f64 {
        if self.parameters.torque_scale > 0.0 { self.parameters.torque_scale } else { self.linkage.weight_torque }
    }

    /// Initial variances of angles, rad², rates, rad²/s², and unknown force, (N·m)².
    pub(super) fn start_variances(&self) -> [f64; 3] {
        let Parameters { sigma0_theta, sigma0_omega, .. } = self.parameters;
        [sigma0_theta, sigma0_omega, UNKNOWN_FORCE * self.torque_scale()].map(|sigma| sigma * sigma)
    }

    /// Inputs that exert a unit of each force on the tangent basis.
    pub fn by_inputs(&self, at: &Frame) -> [Pair; 4] {
        track::by_inputs(&self.linkage, at)
    }
}
