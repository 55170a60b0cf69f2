//! The corrector: an error-state Kalman filter on the tangent space of the closed loop, with an unknown force, several process noises
//! side by side, and several motions behind a vertex; `docs/estimator.md` derives it.
//!
//! It knows the mechanism and what a simulation hands it: loads with their tangents, where the motion has come to. The motion itself is
//! the simulation's; the estimator says where it has to go on from, and with which unknown force.
//!
//! Invariant: does no input or output, reads no clock; the same input bits give the same output bits.

#![expect(clippy::needless_range_loop, reason = "matrices are indexed as formulas index them")]

pub mod alarm;
mod assembly;
mod bands;
pub mod bank;
mod branches;
mod constants;
pub mod encoder;
pub mod forecast;
mod history;
pub mod innovation;
mod lengths;
pub mod linkage;
mod parameters;
mod posture;
mod process_noise;
mod propagate;
mod quantiser;
mod restart;
mod track;
pub mod transition;

use borsh::{BorshDeserialize, BorshSerialize};

pub use alarm::Alarm;
use assembly::{AssemblyHypotheses, Passage, Propagation};
pub use bank::Matrix;
use branches::Branches;
pub use constants::Constants;
use encoder::Reading;
pub use encoder::{Encoder, Fault, Measured};
use forecast::Forecast;
use history::History;
pub use history::REMEMBERED;
pub use innovation::Innovation;
pub use linkage::{Frame, Linkage, Links, MEASURED, Pair};
pub use parameters::{Bands, Parameters};
pub use track::{Track, wrapped};
pub use transition::{Loads, Scene};

/// What the estimate is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Samples of both encoders come in and are used.
    Following,
    /// No samples: a forecast.
    Coasting,
    /// So close to a vertex that nothing is known of the branch: samples are not used.
    Holding,
    /// Behind a vertex, another assembly is followed beside.
    TwoBranches,
    /// One encoder is silent, the other is followed.
    OneEncoder,
    /// The samples do not fit what is expected of them: the bands are too narrow, or the machine was lost and the estimate has begun anew.
    Inconsistent,
    /// What is wrong with an encoder.
    Faulty(Fault),
}

/// Everything of the estimator that changes.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Estimator {
    track: Track,
    /// Whether the last macro step came too close to a vertex.
    held: bool,
    /// Whether samples had ceased to come before the last macro step.
    coasts: bool,
    branches: Branches,
    assembly: AssemblyHypotheses,
    encoders: [Encoder; 2],
    history: History,
    forecast: Forecast,
    alarm: Alarm,
    /// For how much longer samples have been far off the estimate than near, s.
    diverged: f64,
    /// Whether the estimate has begun anew with the last samples.
    restarted: bool,
    /// Of the last sample of each encoder, rad.
    innovation: [f64; 2],
    /// Of the last samples used at once.
    nis: f64,
}

/// Where |sin(θ₃ − θ₂)| is less, a push that is thought of too readily takes the estimate back from the line of the distal links.
const NEAR_SINGULARITY: f64 = 0.3;
/// The largest that is told.
const LARGEST_NIS: f64 = 1e12;

impl Estimator {
    /// The estimate that a scene starts from.
    #[cold]
    pub fn new(constants: &Constants, theta: Links, omega: Links) -> Self {
        Self {
            track: Track { theta, omega, force: [0.0; 4], bank: bank::Bank::new(constants.start_variances()) },
            held: false,
            coasts: true,
            branches: Branches::default(),
            assembly: AssemblyHypotheses::default(),
            encoders: [Encoder::NEW; 2],
            history: History::default(),
            forecast: Forecast::default(),
            alarm: Alarm::default(),
            diverged: 0.0,
            restarted: false,
            innovation: [0.0; 2],
            nis: 0.0,
        }
    }

    /// The estimate.
    pub fn track(&self) -> &Track {
        &self.track
    }

    /// The motion has changed at once, by what is known: the errors about it stay.
    pub fn move_to(&mut self, theta: Links, omega: Links) {
        (self.track.theta, self.track.omega) = (theta, omega);
    }

    /// Takes in what is new of the encoders at a time, s on their clock. Whether the motion has to go on from another state.
    pub fn correct(&mut self, constants: &Constants, measured: &Measured, now: f64) -> bool {
        let Constants { linkage, parameters, .. } = constants;
        let (mut received, mut ages) = ([None; 2], [0.0; 2]);
        let mut any = false;
        let mut frame = linkage.frame(&self.track.theta);
        let persistent = frame.motors_by_lengths(parameters.sigma0_length);
        for i in 0..2 {
            let Some(sample) = self.encoders[i].receive(measured.theta[i], measured.time[i], now, parameters.max_delay) else {
                continue;
            };
            let rate = self.track.omega[MEASURED[i]];
            let noise = self.encoders[i].noise(parameters.sigma[i], parameters.quantum[i], rate, persistent[i]);
            let mut innovation = self.track.innovation(&frame, i, sample.angle, noise);
            if sample.age > 0.0 {
                match self.history.at(&self.track, &frame, i, sample.age) {
                    Some((angle, row)) => innovation = Innovation { residual: wrapped(sample.angle - angle), row, noise },
                    // Older than the run, or than the last change of branch.
                    None => {
                        self.encoders[i].fault = Fault::Late;
                        continue;
                    }
                }
            }
            (received[i], ages[i], any) = (Some((innovation, sample.angle)), sample.age, true);
        }
        // Also where what they say cannot be used.
        if !self.is_coasting() {
            self.forecast.end();
        }
        if any && self.reinitialize(constants, &received, &ages) {
            return true;
        }
        if !any || self.held {
            return false;
        }
        // Where several branches are open, the first samples decide, before any is bent to them.
        if let Some(other) = self.branches.preferred(linkage, &self.track, &received) {
            self.branches.swap(&mut self.track, other);
            self.history.clear();
            frame = linkage.frame(&self.track.theta);
            for i in 0..2 {
                if let Some((innovation, angle)) = &mut received[i] {
                    *innovation = self.track.innovation(&frame, i, *angle, innovation.noise);
                    ages[i] = 0.0;
                }
            }
        }
        let other_stands = [1, 0].map(|i| self.encoders[i].repeats());
        let (mut nis, mut fit, mut used) = (0.0, 0.0, [None; 2]);
        for i in 0..2 {
            let Some((innovation, angle)) = received[i] else { continue };
            let expected = self.track.bank.predict_sample(&innovation);
            let ((own, _), least) = (expected.nis_and_variance(), expected.nis_of_loudest_model());
            let rate = self.track.omega[MEASURED[i]];
            let suspicious =
                !other_stands[i] && self.encoders[i].should_not_repeat(rate, parameters.quantum[i], parameters.sigma[i]);
            self.innovation[i] = innovation.residual;
            nis += own;
            if self.encoders[i].passes_gate(own, least, (suspicious, self.branches.is_branch_known())) {
                self.branches.subtract_likelihood(&expected);
                let (encoder, told) = ((parameters.sigma[i], parameters.quantum[i]), [innovation.noise, persistent[i]]);
                self.track.bank.update(&self.encoders[i].with_quantisation_interval(&expected, encoder, rate, told));
                fit += own;
                used[i] = Some(Reading { angle, noise: innovation.noise, age: ages[i], dead_zone: 0.0 });
            }
        }
        self.nis = if nis < LARGEST_NIS { nis } else { LARGEST_NIS };
        if used.iter().all(Option::is_none) {
            return false;
        }
        match self.track.inject_error(linkage, &frame) {
            Some((error, turn, to)) => {
                self.history.correct(&error, &turn);
                frame = to;
            }
            // Nothing near closes the loop: what is known of the errors is worth nothing.
            None => self.track.bank = bank::Bank::new(constants.start_variances()),
        }
        let by_branches = self.branches.correct(linkage, &used).map(|other| self.branches.swap(&mut self.track, other));
        let confined_to_interval = [0, 1].map(|i| {
            let (noise, rate) = ((parameters.sigma[i], parameters.quantum[i]), self.track.omega[MEASURED[i]]);
            used[i].map(|reading| self.encoders[i].confined_to_interval(reading, noise, rate))
        });
        let by_grazing = self.assembly.correct(constants, &confined_to_interval).map(|other| self.track = other);
        if by_branches.or(by_grazing).is_some() {
            self.history.clear();
            frame = linkage.frame(&self.track.theta);
        }
        let samples = used.iter().flatten().count();
        self.alarm.receive(&self.track, &frame, constants.torque_scale(), (fit, samples));
        true
    }

    /// The motion has gone on by h seconds to these angles and rates; the scenes have the loads of these seconds, with the unknown force and
    /// without.
    pub fn predict<S: Scene>(&mut self, constants: &Constants, [scene, known]: [&S; 2], (theta, omega): (&Links, &Links), h: f64) {
        let Constants { linkage, parameters, .. } = constants;
        let frame = linkage.frame(&self.track.theta);
        let timing = (h, parameters.switch_time);
        // The torques that accelerate the links, each by itself: next to a singularity, where they whip, one holds what another takes, and
        // what is left of all on the basis is no more than what acts on the machine; masses that are off are off one by one.
        let forces = linkage.mass_times(&frame, &std::array::from_fn(|i| (omega[i] - self.track.omega[i]) / h));
        let [first, second] = frame.basis;
        let squares = (0..4).map(|i| (first[i] * first[i] + second[i] * second[i]) * forces[i] * forces[i]).sum::<f64>();
        let scales = [constants.torque_scale(), (squares / 2.0).sqrt()];
        let coasts = self.is_coasting();
        // What masses are off by shows where readings are intervals, which confine the angles; in white noise it drowns.
        let has_intervals = (0..2).any(|i| !self.encoders[i].is_dithered(parameters.sigma[i], parameters.quantum[i]));
        // By what models are followed while samples come.
        let model_prior = match has_intervals {
            true if frame.side().abs() < NEAR_SINGULARITY => &bank::PRIOR,
            true => &bank::BY_INTERVALS,
            false => &bank::BY_NOISE,
        };
        if coasts && !self.coasts {
            self.track.bank.reset_priors(model_prior);
        }
        self.coasts = coasts;
        if coasts && parameters.forecast == Bands::SigmaPoints {
            self.forecast.step(&self.track, constants, scene, (h, scales));
        }
        let to = linkage.frame(theta);
        let flow = self.track.flow(linkage, &frame, scene, (h, 1));
        let step = self.track.step((&frame, &to), (theta, omega), &flow, h);
        let turned = self.track.has_turned(omega, frame.smallest.min(to.smallest));
        self.branches.open_after_vertex(linkage, &self.track, scene, [frame.smallest, to.smallest], turned);
        self.history.step((&self.track, &frame), &step.transition, h, parameters.max_delay);
        let priors = if coasts { &bank::PRIOR } else { model_prior };
        let scales = [scales[0], if has_intervals { scales[1] } else { 0.0 }];
        self.track.bank.predict(linkage, (&frame, &step.transition), scales, timing, priors);
        (self.track.theta, self.track.omega) = (*theta, *omega);
        self.held = step.held;
        self.branches.step(constants, step.held, scene, timing);
        let passage = match () {
            () if coasts => Passage::Unseen,
            () if step.held || self.branches.are_open() => Passage::Vertex,
            () => Passage::Clear,
        };
        let propagation = Propagation { from: &frame, to: &to, transition: &step.transition, steps: flow.steps };
        self.assembly.step(constants, (&self.track, passage, &propagation), known, timing);
        for encoder in &mut self.encoders {
            encoder.time_since_sample += h;
        }
        self.alarm.step(h);
    }

    /// Whether samples have ceased to come.
    pub fn is_coasting(&self) -> bool {
        self.encoders.iter().all(Encoder::is_silent)
    }

    /// What the estimate is worth.
    pub fn status(&self) -> Status {
        let fault = self.encoders.iter().map(|encoder| encoder.fault).max().unwrap_or_default();
        match () {
            () if self.restarted && !self.is_coasting() => Status::Inconsistent,
            () if self.held => Status::Holding,
            () if fault != Fault::None => Status::Faulty(fault),
            () if self.is_coasting() => Status::Coasting,
            () if self.encoders.iter().any(Encoder::is_silent) => Status::OneEncoder,
            () if self.branches.are_open() || self.assembly.is_open() => Status::TwoBranches,
            () if self.alarm.is_inconsistent() => Status::Inconsistent,
            () => Status::Following,
        }
    }

    /// Whether an encoder is silent, and what is wrong with it.
    pub fn encoder(&self, i: usize) -> (bool, Fault) {
        (self.encoders[i].is_silent(), self.encoders[i].fault)
    }

    /// Whether an encoder has ever given a sample.
    pub fn has_received(&self, i: usize) -> bool {
        self.encoders[i].time_since_sample.is_finite()
    }

    /// Of the last sample of each encoder: measured less expected, rad.
    pub fn innovation(&self) -> Pair {
        self.innovation
    }

    /// Squared innovations of the last correction in units of their covariance.
    pub fn nis(&self) -> f64 {
        self.nis
    }

    /// Whether something acts that the model does not know.
    pub fn alarm(&self) -> bool {
        self.alarm.is_on()
    }

    /// Probability of a direct singularity within the horizon, with the inputs held: from motions around the estimate.
    pub fn singularity_probability(&self, constants: &Constants, scene: &impl Scene, step: f64) -> f64 {
        forecast::singularity_probability(&self.track, &self.forecast, constants, scene, step)
    }

    /// Refuses what cannot be an estimator of this mechanism.
    #[cold]
    pub fn check(&self, constants: &Constants, theta: &Links, omega: &Links) -> Result<(), &'static str> {
        let same = |a: &Links, b: &Links| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        if !same(&self.track.theta, theta) || !same(&self.track.omega, omega) {
            return Err("its estimate differs from the simulated motion");
        }
        let mut tracks = std::iter::once(&self.track).chain(self.branches.tracks()).chain(self.assembly.tracks());
        if !tracks.all(|track| track.is_sound(&constants.linkage)) {
            return Err("its estimate has a state or covariance that is not valid");
        }
        let received = self.encoders.iter().all(Encoder::is_sound);
        if !received || !self.history.is_sound() || !self.forecast.is_sound(&constants.linkage) {
            return Err("a sample, the history or the forecast of its estimator is not valid");
        }
        let numbers = self.innovation.iter().chain([&self.nis, &self.diverged]);
        if !numbers.chain(&self.alarm.numbers()).all(|x| x.is_finite()) || !self.branches.is_sound() || !self.assembly.is_sound() {
            return Err("a number of its estimator is not finite");
        }
        Ok(())
    }
}
