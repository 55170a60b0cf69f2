//! What a scene says of its encoders and of what may act on it unknown.

use super::REMEMBERED;
use crate::mechanism::{SceneError, finite, not_negative, positive};

/// How a forecast without samples gets its bands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bands {
    /// The covariance goes on linearly.
    #[default]
    Linear,
    /// From motions around the estimate that are computed beside it.
    SigmaPoints,
}

/// The `estimator.*` parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene is followed.
    pub enabled: bool,
    /// White noise of the encoders, rad.
    pub sigma: [f64; 2],
    /// Their steps, rad; 0: none.
    pub quantum: [f64; 2],
    /// The oldest sample that is used, s.
    pub max_delay: f64,
    /// Standard deviation of the link angles at the start, rad.
    pub sigma0_theta: f64,
    /// That of the rates, rad/s.
    pub sigma0_omega: f64,
    /// That of the lengths of links and base, which do not change, m.
    pub sigma0_length: f64,
    /// How bands are forecast.
    pub forecast: Bands,
    /// The torque in which the unknown force is measured, N·m; 0: what carries the machine's weight.
    pub torque_scale: f64,
    /// How long the unknown force goes on changing as it does, s.
    pub switch_time: f64,
    /// How far ahead singularities are looked for, s.
    pub horizon: f64,
}

impl Parameters {
    /// Refuses what is no number, with the step length of the scene, s.
    #[cold]
    pub fn check(&self, step_size: f64) -> Result<(), SceneError> {
        for (name, value, unit) in [
            ("estimator.sigma[1]", self.sigma[0], "rad"),
            ("estimator.sigma[2]", self.sigma[1], "rad"),
            ("estimator.quantum[1]", self.quantum[0], "rad"),
            ("estimator.quantum[2]", self.quantum[1], "rad"),
            ("estimator.maxDelay", self.max_delay, "s"),
            ("estimator.sigma0.length", self.sigma0_length, "m"),
            ("estimator.torqueScale", self.torque_scale, "N.m"),
        ] {
            not_negative(name, value, unit)?;
        }
        for (name, value, unit) in [
            ("estimator.sigma0.theta", self.sigma0_theta, "rad"),
            ("estimator.sigma0.omega", self.sigma0_omega, "rad/s"),
            ("estimator.switchTime", self.switch_time, "s"),
        ] {
            positive(name, value, unit)?;
        }
        finite("estimator.horizon", self.horizon, "s")?;
        // A communication step that is no multiple of h is divided into shorter ones, down to half of it.
        let most = (REMEMBERED / 2 - 1) as f64 * step_size;
        if self.max_delay > most {
            return Err(SceneError(format!(
                "estimator.maxDelay = {:?} s is not allowed: it must be at most {} steps of solver.stepSize = {step_size:?} s.",
                self.max_delay,
                REMEMBERED / 2 - 1
            )));
        }
        Ok(())
    }
}
