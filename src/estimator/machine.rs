//! Parameters of the estimator (encoders, initial uncertainty, unknown force, forecast), and the estimator's model of the machine.

use nalgebra::SVector;

use super::error_state::{GEOMETRY, LENGTHS, Learned, OFFSETS};
use super::geometry::LENGTH_COUNT;
use super::history::REMEMBERED;
use super::tangent::{Linkage, Links, MEASURED};
use super::tuning::{ANYWHERE, LARGEST_RATE_VARIANCE, UNKNOWN_FORCE};
use crate::copies::clone_by_fields;
use crate::mechanism::{Geometry, SceneError};

/// Method of the covariance in a forecast without samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bands {
    /// Linear propagation of the covariance.
    #[default]
    Linear,
    /// Sigma points: motions simulated around the estimate.
    SigmaPoints,
}

/// The `estimator.*` parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the estimator is active.
    pub enabled: bool,
    /// Standard deviation of the white noise of each encoder, rad.
    pub sigma: [f64; 2],
    /// Quantisation interval of each encoder, rad; 0: none.
    pub quantum: [f64; 2],
    /// Largest age of a sample that is used, s.
    pub max_delay: f64,
    /// Standard deviation of the link angles at the start, rad.
    pub sigma0_theta: f64,
    /// Standard deviation of the link rates at the start, rad/s.
    pub sigma0_omega: f64,
    /// Standard deviation of the constant lengths of links and base, m.
    pub sigma0_length: f64,
    /// Standard deviation of the constant mounting angle of each encoder, rad.
    pub sigma0_offset: f64,
    /// Standard deviation of other errors of each encoder that persist but are not constant, rad.
    pub sigma0_eccentricity: f64,
    /// Relative standard deviation of the scale of each encoder.
    pub sigma0_scale: f64,
    /// Whether masses, friction, lengths and mounting angles are learned.
    pub learn_enabled: bool,
    /// Relative standard deviation of the mass of each link at the start; 0: known.
    pub learn_mass: f64,
    /// Standard deviation of the payload's mass at the start, kg; 0: known.
    pub learn_payload: f64,
    /// Standard deviation of the coefficient of viscous friction of each joint at the start, N·m·s/rad; 0: known.
    pub learn_viscous: f64,
    /// Relative standard deviation of dry friction at the start; 0: known.
    pub learn_friction: f64,
    /// Method of the covariance in a forecast.
    pub forecast: Bands,
    /// Torque scale of the unknown force, N·m; 0: the torque that carries the machine's weight.
    pub torque_scale: f64,
    /// Standard deviation of the change of each commanded motor torque within 0.1 s, N·m; 0: constant.
    pub command_scale_tau: [f64; 2],
    /// Standard deviation of the change of each servo reference within 0.1 s, rad; 0: constant.
    pub command_scale_theta: [f64; 2],
    /// Mean time before a model of the bank is replaced, s.
    pub switch_time: f64,
    /// Horizon of the singularity forecast, s.
    pub horizon: f64,
}

impl Parameters {
    /// Configures lengths and encoders as exact.
    pub fn take_geometry_as_exact(&mut self) {
        (self.sigma0_length, self.sigma0_offset) = (0.0, 0.0);
        (self.sigma0_eccentricity, self.sigma0_scale) = (0.0, 0.0);
    }

    /// Whether lengths and encoders are configured as exact.
    pub(super) fn has_exact_geometry(&self) -> bool {
        [self.sigma0_length, self.sigma0_offset, self.sigma0_eccentricity, self.sigma0_scale] == [0.0; 4]
    }

    /// Variances of both readings due to errors of the encoders' discs and scales, rad². These errors are never learned. A scale error is
    /// proportional to the angle.
    pub(super) fn variances_of_encoders(&self, theta: &Links) -> [f64; 2] {
        MEASURED.map(|link| {
            let by_scale = self.sigma0_scale * theta[link];
            self.sigma0_eccentricity * self.sigma0_eccentricity + by_scale * by_scale
        })
    }

    /// Refuses delays that are too long for the history, and any delay with learning. `step_size` is the macro step, s.
    pub fn check(&self, step_size: f64) -> Result<(), SceneError> {
        if self.learn_enabled && self.max_delay > 0.0 {
            return Err(SceneError(format!(
                "estimator.maxDelay = {:?} s is not allowed with estimator.learn.enabled = true, which learns from samples without delay: it must \
                 be 0.",
                self.max_delay
            )));
        }
        // With this limit, two entries of the history are at most one and a half macro steps apart, so interpolation is exact enough.
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

/// Learned parameters before any sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Values.
    pub values: Learned,
    /// Standard deviations; 0: known.
    pub sigma: Learned,
}

/// The estimator's model of the machine: the parameters, with the learned lengths.
#[derive(Debug, PartialEq)]
pub struct Machine {
    /// Geometry with the learned lengths.
    pub(super) geometry: Geometry,
    /// Lengths of links and base by the parameters, m.
    pub(super) nominal: [f64; LENGTH_COUNT],
    /// The closed loop with the learned lengths.
    pub linkage: Linkage,
    /// The parameters in force.
    pub parameters: Parameters,
    /// Standard deviations of lengths, m, and of mounting angles, rad; 0 if they are learned.
    pub(super) unlearned: [f64; 2],
    /// Torque scale of the unknown force, N·m.
    torque_scale: f64,
    /// Values and standard deviations of the learned parameters before any sample; boxed, so that it costs no space if nothing is learned.
    pub(super) prior: Option<Box<Prior>>,
}

clone_by_fields!(Machine { geometry, nominal, linkage, parameters, unlearned, torque_scale, prior });

impl Machine {
    /// Machine before anything is learned; `geometry` includes all masses.
    pub fn new(geometry: &Geometry, parameters: &Parameters, prior: Option<Prior>) -> Self {
        // Mean over the legs of the torque that carries their weight, (m_P a_P + m_D l_P)·9.81 m/s².
        let weight = |p: usize, d: usize| {
            let [proximal, distal] = [p, d].map(|i| geometry.links[i]);
            9.81 * (proximal.mass * proximal.com.abs() + distal.mass * proximal.length)
        };
        let weight_torque = (weight(0, 1) + weight(3, 2)) / 2.0;
        let torque_scale = if parameters.torque_scale > 0.0 { parameters.torque_scale } else { weight_torque };
        let is_learned = |i: usize| prior.is_some_and(|prior| prior.sigma[i] > 0.0);
        let unlearned = |sigma: f64, i: usize| if is_learned(i) { 0.0 } else { sigma };
        let unlearned = [unlearned(parameters.sigma0_length, LENGTHS.start), unlearned(parameters.sigma0_offset, OFFSETS.start)];
        let prior = prior.map(Box::new);
        let nominal = std::array::from_fn(|i| geometry.links.get(i).map_or(geometry.base_distance, |link| link.length));
        let (geometry, linkage, parameters) = (*geometry, Linkage::new(geometry), parameters.clone());
        Self { geometry, nominal, linkage, parameters, unlearned, torque_scale, prior }
    }

    /// Standard deviations of lengths, m, and mounting angles, rad; 0 if they are learned.
    pub(super) fn unlearned_geometry(&self) -> SVector<f64, GEOMETRY> {
        SVector::from_fn(|i, _| self.unlearned[usize::from(i >= LENGTH_COUNT)])
    }

    /// Length of link i or of the base by the parameters, m.
    pub fn length(&self, i: usize) -> f64 {
        self.nominal[i]
    }

    /// Applies the learned lengths; returns whether they have changed.
    pub fn learn(&mut self, learned: &Learned) -> bool {
        let before = self.geometry;
        set_lengths(&mut self.geometry, |i, _| self.nominal[i] + learned[LENGTHS.start + i]);
        let changed = self.geometry != before;
        if changed {
            self.linkage = Linkage::new(&self.geometry);
        }
        changed
    }

    /// Torque scale of the unknown force, N·m.
    pub fn torque_scale(&self) -> f64 {
        self.torque_scale
    }

    /// Initial variances of angles, rad², rates, rad²/s², and unknown force, (N·m)².
    pub(super) fn start_variances(&self) -> [f64; 3] {
        let Parameters { sigma0_theta, sigma0_omega, .. } = self.parameters;
        [sigma0_theta, sigma0_omega, UNKNOWN_FORCE * self.torque_scale].map(|sigma| sigma * sigma)
    }

    /// Variances of angles, rad², rates, rad²/s², and unknown force, (N·m)², of a machine that may be anywhere.
    pub(super) fn variances_anywhere(&self) -> [f64; 3] {
        [ANYWHERE, LARGEST_RATE_VARIANCE, self.torque_scale * self.torque_scale]
    }
}

/// Sets the lengths of links and base, m. `length` maps an index (links 0 to 3, base 4) and the present length to the new one.
pub fn set_lengths(geometry: &mut Geometry, mut length: impl FnMut(usize, f64) -> f64) {
    let lengths = geometry.links.iter_mut().map(|link| &mut link.length).chain([&mut geometry.base_distance]);
    lengths.enumerate().for_each(|(i, of)| *of = length(i, *of));
}
