//! Servo: a position controller with limited torque on each motor axis.
//!
//! ```text
//! T = limit · tanh((kp (θ_ref − θ) + kd (ω_ref − ω))/limit)
//! ```
//!
//! with the references `servo.theta`, `servo.omega` as inputs; PD control with the saturation made smooth (Siciliano et al., Robotics,
//! 2009, section 8.5). K = kp sech², C = kd sech²: inside the implicit step, so that high gains stay stable. The work of the servo
//! counts as input. θ counts whole turns. Defaults: kp 2 N·m/rad, kd 0.02 N·m·s/rad, a desk-top device's; limit 1 N·m.
//! Limits: continuous in time (no sampling, no delay, no quantisation), no integral action; motor dynamics are not modelled.

use super::force_context::{MOTOR_ANGLES, ForceContext};
use super::step_context::end_weight;
use super::{Force, Inputs, MeanForce, StepContext, Tangents};
use crate::mechanism::exponential::tanh;
use crate::mechanism::{Coordinates, Mechanism, SceneError, not_negative, positive};

/// Largest angle to saturation, limit/kp, rad, of a servo with a sharp nonlinearity. A servo that saturates at a larger angle is nearly
/// linear over a step; where it is stiff as well, a search for the nonlinearity would find round-off.
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
}

/// The servos, made ready from their parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Servo {
    kp: [f64; 2],
    kd: [f64; 2],
    limit: [f64; 2],
}

impl Servo {
    /// Relative torques T/limit of the left and right servo.
    fn relative_torques(&self, at: &ForceContext) -> [f64; 2] {
        let requested = [0, 1].map(|i| {
            let angle = self.kp[i] * (at.inputs.servo_theta[i] - at.motor_angle(i));
            let rate = self.kd[i] * (at.inputs.servo_omega[i] - at.motor_rate(i));
            (angle + rate) / self.limit[i]
        });
        tanh(requested.into()).to_array()
    }

    /// Torques of the left and right servo, N·m.
    pub fn torques(&self, at: &ForceContext) -> [f64; 2] {
        let relative_torques = self.relative_torques(at);
        [0, 1].map(|i| self.limit[i] * relative_torques[i])
    }
}

impl Force for Servo {
    type Parameters = Parameters;

    const HAS_STIFF_FORCES: bool = true;

    fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        let Parameters { kp, kd, limit, .. } = *parameters;
        for i in 0..2 {
            not_negative(format_args!("servo.kp[{}]", i + 1), kp[i], "N.m/rad")?;
            not_negative(format_args!("servo.kd[{}]", i + 1), kd[i], "N.m.s/rad")?;
            positive(format_args!("servo.limit[{}]", i + 1), limit[i], "N.m")?;
        }
        Ok(Self { kp, kd, limit })
    }

    fn conservative(&self) -> bool {
        false
    }

    #[cold]
    fn has_sharp_nonlinearity(&self) -> bool {
        (0..2).any(|i| self.limit[i] < SHARP_SATURATION * self.kp[i])
    }

    #[inline(never)]
    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
        for (motor, torque) in MOTOR_ANGLES.into_iter().zip(self.torques(at)) {
            forces[motor] += torque;
        }
    }

    #[inline(never)]
    fn add_tangents(&self, at: &ForceContext, tangents: &mut impl Tangents) {
        let relative_torques = self.relative_torques(at);
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            let saturation_slope = 1.0 - relative_torques[i] * relative_torques[i];
            tangents.stiffness(motor, motor, self.kp[i] * saturation_slope);
            tangents.damping(motor, motor, self.kd[i] * saturation_slope);
        }
    }

    fn add_input_change(&self, at: &ForceContext, change: &Inputs, forces: &mut Coordinates) {
        let relative_torques = self.relative_torques(at);
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            let pull = self.kp[i] * change.servo_theta[i] + self.kd[i] * change.servo_omega[i];
            forces[motor] += (1.0 - relative_torques[i] * relative_torques[i]) * pull;
        }
    }

    #[inline(never)]
    fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> [f64; 2] {
        let mut external_work = 0.0;
        for (i, torque) in self.torques(at).into_iter().enumerate() {
            forces[MOTOR_ANGLES[i]] += torque;
            external_work += torque * at.motor_rate(i);
        }
        [external_work, 0.0]
    }

    fn input_power(&self, at: &ForceContext) -> f64 {
        let torques = self.torques(at);
        torques[0] * at.motor_rate(0) + torques[1] * at.motor_rate(1)
    }
}

impl MeanForce for Servo {
    #[inline(never)]
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            forces[motor] += self.limit[i] * self.mean_relative_torque(over, i)[0];
        }
    }

    #[inline(never)]
    fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents) {
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            let [relative_torque, weight] = self.mean_relative_torque(over, i);
            let saturation_slope = (1.0 - relative_torque * relative_torque) / over.softening;
            let by_change = 0.5 * (1.0 + weight) * self.kp[i] + (1.0 - weight) * self.kd[i] / over.h;
            tangents.stiffness(motor, motor, by_change * saturation_slope);
            tangents.damping(motor, motor, weight * self.kd[i] * saturation_slope);
        }
    }

    fn input_over(&self, over: &StepContext) -> f64 {
        (0..2).map(|i| self.limit[i] * self.mean_relative_torque(over, i)[0] * over.motor_angle(i)[1]).sum()
    }
}

impl Servo {
    /// Mean relative torque T/limit of a servo over a step, and the weight γ of the step's end in its angle and rate.
    fn mean_relative_torque(&self, over: &StepContext, i: usize) -> [f64; 2] {
        let ([begin, change], end) = (over.motor_angle(i), over.motor_rate(i));
        let mean = change / over.h;
        let weight = end_weight(over.decay(0.5 * over.h * self.kp[i] + self.kd[i]));
        // The difference comes first: close to the reference it is exact, and finer than the round-off of the angle.
        let angle = self.kp[i] * ((over.inputs.servo_theta[i] - begin) - 0.5 * (1.0 + weight) * change);
        let rate = self.kd[i] * (over.inputs.servo_omega[i] - (mean + weight * (end - mean)));
        [libm::tanh((angle + rate) / (over.softening * self.limit[i])), weight]
    }
}
