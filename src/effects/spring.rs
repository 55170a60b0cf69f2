//! Spring: a linear torsion spring on each motor axis, T = −k (θ − θ₀).
//!
//! K = k, C = 0; potential k (θ − θ₀)²/2; conservative. θ counts whole turns. Defaults: 0.05 N·m/rad, about the weight torque of the
//! paper's links, relaxed upright (θ₀ = π/2). Limits: linear, massless, without hysteresis.

use super::force_law::{ForceLaw, PowerFlow, Properties};
use super::wrench::{JOINTS, JointMotion, MOTOR_ANGLES, Motion};
use crate::mechanism::{Mechanism, SceneError};

/// The `spring.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has springs.
    pub enabled: bool,
    /// Stiffness of the left and right spring, N·m/rad.
    pub k: [f64; 2],
    /// Relaxed angles of the left and right spring, rad.
    pub theta0: [f64; 2],
}

/// The law needs only its parameters.
pub use Parameters as Spring;

impl Spring {
    pub(super) fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        Ok(parameters.clone())
    }
}

impl ForceLaw for Spring {
    fn properties(&self) -> Properties {
        Properties::smooth(PowerFlow::Stored)
    }

    fn torques(&self, joints: &JointMotion) -> [f64; JOINTS] {
        let mut torques = [0.0; JOINTS];
        for (i, joint) in MOTOR_ANGLES.into_iter().enumerate() {
            torques[joint] = -self.k[i] * ((joints.angles[i] - self.theta0[i]) + joints.moved[i]);
        }
        torques
    }

    fn slopes(&self, _joints: &JointMotion) -> [[f64; 2]; JOINTS] {
        let mut slopes = [[0.0; 2]; JOINTS];
        for (i, joint) in MOTOR_ANGLES.into_iter().enumerate() {
            slopes[joint][0] = self.k[i];
        }
        slopes
    }

    fn potential(&self, at: &Motion) -> f64 {
        let stretch = |i: usize| at.joints.angles[i] - self.theta0[i];
        (0..2).map(|i| self.k[i] / 2.0 * stretch(i) * stretch(i)).sum()
    }
}
