//! Estimator: an error-state Kalman filter on the tangent space of the closed loop, with an unknown force among its states, a
//! multiple-model bank of process noises, and alternative hypotheses after singularities; `docs/estimator.md` derives it.
//!
//! The module knows the mechanism and the data that a simulation passes: loads with tangents, and the motion at the end of each macro step.
//! The simulation owns the motion; the estimator returns the corrected state and the unknown force to continue with.
//!
//! Invariant: no input or output and no clock; equal input bits give equal output bits.

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

/// Quality of the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Samples of both encoders arrive and are used.
    Following,
    /// No samples arrive: the estimate is a forecast.
    Coasting,
    /// Too close to a vertex to know the branch: samples are not used.
    Holding,
    /// Alternative hypotheses are followed after a singularity.
    TwoBranches,
    /// One encoder is silent; the other is used.
    OneEncoder,
    /// Innovations exceed their covariance, or the estimate had diverged and was reinitialised.
    Inconsistent,
    /// An encoder has a fault.
    Faulty(Fault),
}

/// Changing part of the estimator.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Estimator {
    track: Track,
    /// Whether the last macro step came too close to a vertex to know the branch.
    held: bool,
    /// Whether no samples arrived before the last macro step.
    coasts: bool,
    branches: Branches,
    assembly: AssemblyHypotheses,
    encoders: [Encoder; 2],
    history: History,
    forecast: Forecast,
    alarm: Alarm,
    /// Accumulated time with large innovations minus that with small ones, s.
    diverged: f64,
    /// Whether the last samples have reinitialised the estimate.
    restarted: bool,
    /// Innovation of the last sample of each encoder, rad.
    innovation: [f64; 2],
    /// Normalised innovation squared, summed over the last samples used together.
    nis: f64,
}

/// Distance |sin(θ₃ − θ₂)| from a direct singularity below which models of large process noise keep a low prior probability: an unknown force
/// that is assumed there without need pulls the estimate back to the singularity.
const NEAR_SINGULARITY: f64 = 0.3;
/// Largest normalised innovation squared that is reported, to stay finite.
const LARGEST_NIS: f64 = 1e12;

impl Estimator {
    /// Initial estimate of a scene.
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

    /// Present estimate.
    pub fn track(&self) -> &Track {
        &self.track
    }

    /// Moves the estimate by a known discontinuity; the errors about it stay.
    pub fn move_to(&mut self, theta: Links, omega: Links) {
        (self.track.theta, self.track.omega) = (theta, omega);
    }

    /// Measurement update by the samples that are new at time `now`, s on the encoders' clock. Returns whether the estimate has changed.
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
                    // The sample is older than the run or than the last change of hypothesis.
                    None => {
                        self.encoders[i].fault = Fault::Late;
                        continue;
                    }
                }
            }
            (received[i], ages[i], any) = (Some((innovation, sample.angle)), sample.age, true);
        }
        // Samples end a forecast even where their values cannot be used.
        if !self.is_coasting() {
            self.forecast.end();
        }
        if any && self.reinitialize(constants, &received, &ages) {
            return true;
        }
        if !any || self.held {
            return false;
        }
        // While several hypotheses are open, the first samples select one before any of them is corrected.
        let preferred = self.branches.preferred(linkage, &self.track, &received);
        if let Some(other) = preferred {
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
            return preferred.is_some();
        }
        match self.track.inject_error(linkage, &frame) {
            Some((error, turn, to)) => {
                self.history.correct(&error, &turn);
                frame = to;
            }
            // No closed configuration is near the corrected one: the covariance is worthless.
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

    /// Time update by a macro step of h seconds that ended at these angles, rad, and rates, rad/s. `scene` has the loads of the step with
    /// the unknown force, `known` without.
    pub fn predict<S: Scene>(&mut self, constants: &Constants, [scene, known]: [&S; 2], (theta, omega): (&Links, &Links), h: f64) {
        let Constants { linkage, parameters, .. } = constants;
        let frame = linkage.frame(&self.track.theta);
        let timing = (h, parameters.switch_time);
        // Inertia torques, link by link: in a fast passage next to a singularity those of two links nearly cancel on the basis, while
        // errors of their masses do not.
        let forces = linkage.mass_times(&frame, &std::array::from_fn(|i| (omega[i] - self.track.omega[i]) / h));
        let [first, second] = frame.basis;
        let squares = (0..4).map(|i| (first[i] * first[i] + second[i] * second[i]) * forces[i] * forces[i]).sum::<f64>();
        let scales = [constants.torque_scale(), (squares / 2.0).sqrt()];
        let coasts = self.is_coasting();
        // Errors of masses are observable through quantisation intervals, which confine the angles; in white noise they drown.
        let has_intervals = (0..2).any(|i| !self.encoders[i].is_dithered(parameters.sigma[i], parameters.quantum[i]));
        // Prior probabilities of the models while samples arrive.
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

    /// Whether both encoders are silent.
    pub fn is_coasting(&self) -> bool {
        self.encoders.iter().all(Encoder::is_silent)
    }

    /// Quality of the estimate.
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

    /// Whether an encoder is silent, and its fault.
    pub fn encoder(&self, i: usize) -> (bool, Fault) {
        (self.encoders[i].is_silent(), self.encoders[i].fault)
    }

    /// Whether an encoder has ever delivered a sample.
    pub fn has_received(&self, i: usize) -> bool {
        self.encoders[i].time_since_sample.is_finite()
    }

    /// Innovation of the last sample of each encoder: measured minus expected angle, rad.
    pub fn innovation(&self) -> Pair {
        self.innovation
    }

    /// Normalised innovation squared of the last correction, summed over its samples.
    pub fn nis(&self) -> f64 {
        self.nis
    }

    /// Whether an unmodelled force is detected.
    pub fn alarm(&self) -> bool {
        self.alarm.is_on()
    }

    /// Probability of a direct singularity within the horizon under held inputs: the fraction of 13 motions, those of the sigma points and of
    /// their mean, that meet one.
    pub fn singularity_probability(&self, constants: &Constants, scene: &impl Scene, step: f64) -> f64 {
        forecast::singularity_probability(&self.track, &self.forecast, constants, scene, step)
    }

    /// Refuses a stored estimator that is inconsistent with this mechanism and motion.
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
