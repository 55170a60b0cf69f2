//! Servo: a position controller with limited torque on each motor axis.
//!
//! ```text
//! T = limit · tanh((kp (θ_ref − θ) + kd (ω_ref − ω))/limit)
//! ```
//!
//! The references `servo.theta` and `servo.omega` are inputs, and act `servo.delay` after they have been set. The law is PD control with a smooth saturation (Siciliano et al., Robotics,
//! 2009, section 8.5). K = kp sech² and C = kd sech² belong to the implicit step, so high gains stay stable. The work of the servo counts
//! as input. θ counts whole turns. Defaults: kp 2 N·m/rad, kd 0.02 N·m·s/rad, a desk-top device's; limit 1 N·m; delay 0 s.
//! Limits: continuous in time (no sampling, no quantisation), no integral action; motor dynamics are not modelled.

use super::Inputs;
use super::force_law::{ForceLaw, PowerFlow, Properties};
use super::wrench::{JOINTS, JointMotion, MOTOR_ANGLES};
use crate::mechanism::exponential::tanh;
use crate::mechanism::{Mechanism, SceneError};

/// Saturation angle limit/kp, rad, below which the nonlinearity of a servo counts as sharp. A servo with a larger angle is nearly linear
/// over a step; if it is also stiff, a search for the nonlinearity would find round-off.
const SHARP_SATURATION: f64 = 0.1;

/// The `servo.*` parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has servos.
    pub enabled: bool,
    /// Position gains of the left and right servo, N·m/rad.
    pub kp: [f64; 2],
    /// Rate gains, N·m·s/rad.
    pub kd: [f64; 2],
    /// Largest torques, N·m.
    pub limit: [f64; 2],
    /// Time from a new reference to its effect, s. The law itself reads the references that act (`src/simulation/commands.rs`).
    pub delay: f64,
}

impl Parameters {
    /// Time from a new reference to its effect, s; 0 without servos.
    pub fn command_delay(&self) -> f64 {
        if self.enabled { self.delay } else { 0.0 }
    }
}

/// The law needs only its parameters.
pub use Parameters as Servo;

impl Servo {
    pub(super) fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        Ok(parameters.clone())
    }

    /// Relative torques T/limit of the left and right servo.
    fn relative_torques(&self, joints: &JointMotion) -> [f64; 2] {
        let JointMotion { angles, moved, rates, inputs, .. } = joints;
        let requested = [0, 1].map(|i| {
            // Reference minus angle is computed first. It is exact near the reference, so an increment `moved` below the round-off of the
            // angle still counts.
            let angle = self.kp[i] * ((inputs.servo_theta[i] - angles[i]) - moved[i]);
            let rate = self.kd[i] * (inputs.servo_omega[i] - rates[MOTOR_ANGLES[i]]);
            (angle + rate) / (joints.softening * self.limit[i])
        });
        tanh(requested.into()).to_array()
    }

    /// Derivatives of the left and the right torque with respect to limit times the argument of tanh, 0 to 1.
    fn openness(&self, joints: &JointMotion) -> [f64; 2] {
        self.relative_torques(joints).map(|relative_torque| (1.0 - relative_torque * relative_torque) / joints.softening)
    }

    /// Slopes of the joints from the derivatives of [`Self::openness`].
    fn slopes_at(&self, openness: [f64; 2]) -> [[f64; 2]; JOINTS] {
        let mut slopes = [[0.0; 2]; JOINTS];
        for (i, joint) in MOTOR_ANGLES.into_iter().enumerate() {
            slopes[joint] = [self.kp[i] * openness[i], self.kd[i] * openness[i]];
        }
        slopes
    }
}

impl ForceLaw for Servo {
    fn properties(&self) -> Properties {
        let sharp = (0..2).any(|i| self.limit[i] < SHARP_SATURATION * self.kp[i]);
        Properties { stiff: true, sharp, ..Properties::smooth(PowerFlow::Supplied) }
    }

    fn torques(&self, joints: &JointMotion) -> [f64; JOINTS] {
        let (mut torques, relative_torques) = ([0.0; JOINTS], self.relative_torques(joints));
        for (i, joint) in MOTOR_ANGLES.into_iter().enumerate() {
            torques[joint] = self.limit[i] * relative_torques[i];
        }
        torques
    }

    fn slopes(&self, joints: &JointMotion) -> [[f64; 2]; JOINTS] {
        self.slopes_at(self.openness(joints))
    }

    fn largest_slopes(&self, _softening: f64) -> [[f64; 2]; JOINTS] {
        self.slopes_at([1.0; 2])
    }

    fn torques_by_inputs(&self, joints: &JointMotion, change: &Inputs) -> [f64; JOINTS] {
        let (mut torques, openness) = ([0.0; JOINTS], self.openness(joints));
        for (i, joint) in MOTOR_ANGLES.into_iter().enumerate() {
            torques[joint] = openness[i] * (self.kp[i] * change.servo_theta[i] + self.kd[i] * change.servo_omega[i]);
        }
        torques
    }
}
