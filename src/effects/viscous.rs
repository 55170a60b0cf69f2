//! Viscous: friction proportional to the joint rate, T_j = −b_j w_j.
//!
//! w_j is the rate of joint j (left base, left elbow, tip, right elbow, right base); +T_j acts on its first link and −T_j on its second.
//! In each joint C = b_j and K = 0; the power b_j w_j² is dissipated. Default: 1e-4 N·m·s/rad, a lubricated miniature bearing with its
//! seal. Limits: linear; no dependence on load or temperature.

use super::force_law::{ForceLaw, PowerFlow, Properties};
use super::wrench::{JOINTS, JointMotion};
use crate::mechanism::{Mechanism, SceneError};

/// The `viscous.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has viscous friction.
    pub enabled: bool,
    /// Coefficients b of joints 1 to 5, N·m·s/rad.
    pub b: [f64; JOINTS],
}

/// The law needs only its parameters.
pub use Parameters as Viscous;

impl Viscous {
    pub(super) fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        Ok(parameters.clone())
    }
}

impl ForceLaw for Viscous {
    fn properties(&self) -> Properties {
        Properties::smooth(PowerFlow::Dissipated)
    }

    fn torques(&self, joints: &JointMotion) -> [f64; JOINTS] {
        std::array::from_fn(|joint| -self.b[joint] * joints.rates[joint])
    }

    fn slopes(&self, _joints: &JointMotion) -> [[f64; 2]; JOINTS] {
        self.b.map(|b| [0.0, b])
    }

    fn largest_slopes(&self, _softening: f64) -> [[f64; 2]; JOINTS] {
        self.b.map(|b| [0.0, b])
    }
}
