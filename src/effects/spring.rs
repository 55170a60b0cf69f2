//! Spring: a linear torsion spring on each motor axis, T = −k (θ − θ₀).
//!
//! K = k, C = 0; potential k (θ − θ₀)²/2; conservative. θ counts whole turns. Defaults: 0.05 N·m/rad, about the weight torque of the
//! paper's links, relaxed upright (θ₀ = π/2). Limits: linear, massless, without hysteresis.

use super::force_context::{ForceContext, MOTOR_ANGLES};
use super::{Force, MeanForce, StepContext, Tangents};
use crate::mechanism::{Coordinates, Mechanism, SceneError, finite, not_negative};

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

/// The springs, made ready from their parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Spring {
    k: [f64; 2],
    theta0: [f64; 2],
}

impl Force for Spring {
    type Parameters = Parameters;

    fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        let Parameters { k, theta0, .. } = *parameters;
        for i in 0..2 {
            not_negative(format_args!("spring.k[{}]", i + 1), k[i], "N.m/rad")?;
            finite(format_args!("spring.theta0[{}]", i + 1), theta0[i], "rad")?;
        }
        Ok(Self { k, theta0 })
    }

    #[inline(never)]
    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            forces[motor] -= self.k[i] * (at.motor_angle(i) - self.theta0[i]);
        }
    }

    #[inline(never)]
    fn add_tangents(&self, _at: &ForceContext, tangents: &mut impl Tangents) {
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            tangents.stiffness(motor, motor, self.k[i]);
        }
    }

    fn potential(&self, at: &ForceContext) -> f64 {
        let stretch = |i: usize| at.motor_angle(i) - self.theta0[i];
        (0..2).map(|i| self.k[i] / 2.0 * stretch(i) * stretch(i)).sum()
    }
}

impl MeanForce for Spring {
    /// Adds the force at the mean angle, which is the mean of a linear force.
    #[inline(never)]
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            let [angle, change] = over.motor_angle(i);
            forces[motor] -= self.k[i] * ((angle - self.theta0[i]) + 0.5 * change);
        }
    }

    #[inline(never)]
    fn add_mean_tangents(&self, _over: &StepContext, tangents: &mut impl Tangents) {
        for (i, motor) in MOTOR_ANGLES.into_iter().enumerate() {
            tangents.stiffness(motor, motor, 0.5 * self.k[i]);
        }
    }
}
