//! Estimator: an error-state Kalman filter on the tangent space of the closed loop, with an unknown force among its states, a
//! multiple-model bank of process noises, and alternative hypotheses after singularities; `docs/estimator-theory.md` derives it.
//!
//! | file | holds |
//! | --- | --- |
//! | `tangent.rs`, `error_state.rs` | the closed loop: J, N, closure; errors on N and their covariance |
//! | `flow.rs`, `propagation.rs` | motion and transition by a scene's equations; process noise |
//! | `belief.rs` | unknown force; Kalman filter of each model, and their mixture |
//! | `learning.rs` | masses, friction, lengths and mounting angles as parameters behind the errors |
//! | `encoder.rs`, `quantiser.rs`, `history.rs` | samples: validity, noise, intervals, delay |
//! | `hypotheses.rs` | motions that encoders do not tell from the estimate at once |
//! | `unaided.rs` | the estimate without an encoder that repeats itself |
//! | `forecast.rs`, `bands.rs`, `geometry.rs`, `alarm.rs` | what is told of the estimate |
//! | `doubt.rs` | whether the start is in the right assembly |
//! | `witness.rs`, `cause.rs` | filter that knows of no fault; explanations of an alarm, compared |
//! | `constants.rs`, `parameters.rs` | tuned constants; the master's parameters |
//! | `stored.rs` | matrices in stored states |
//!
//! The module knows the mechanism and the scene that a simulation passes: equations of motion with derivatives, and the motion at the begin
//! and the end of each macro step. The simulation owns the motion; the estimator returns the corrected one and the unknown force to continue with.
//!
//! Invariant: no input or output and no clock; equal input bits give equal output bits.

mod alarm;
mod bands;
pub mod belief;
mod cause;
mod constants;
mod doubt;
mod encoder;
pub mod error_state;
pub mod flow;
mod forecast;
mod geometry;
mod history;
mod hypotheses;
mod learning;
mod parameters;
mod propagation;
mod quantiser;
mod stored;
pub mod tangent;
mod unaided;
mod witness;

use borsh::{BorshDeserialize, BorshSerialize};

use alarm::Alarm;
pub use belief::Belief;
use belief::{Bank, Innovation};
pub use cause::Cause;
use cause::Causes;
use constants::{
    BY_INTERVALS, BY_NOISE, CARRIED_WALK, DIVERGED_INNOVATION, FORECAST_MASS_WALK, GATE, HOPELESS_RATE, LARGEST_NIS,
    LARGEST_SIGMA_ALONE, LEARNING_PERSISTENCES, LIKELY_MODELS, LONGEST_SAMPLE_TIME, MODELS, NEAR_SINGULARITY,
};
use doubt::Doubt;
pub use encoder::{Encoder, Fault, Measured};
use encoder::{GateConditions, Reading, Sample};
use error_state::{GEOMETRY, LEARNED, LOADS, Learned, OFFSETS, READINGS};
use flow::{Flow, flow};
pub use flow::{Linearised, Scene};
use forecast::Forecast;
use history::History;
pub use history::REMEMBERED;
use hypotheses::{Hypotheses, started_by_motors};
use learning::{Learning, ReadingErrors, without_parameters};
pub use parameters::{Bands, Constants, Parameters, Prior, set_lengths};
use propagation::Propagation;
pub use tangent::{Frame, LinkState, Linkage, Links, MEASURED, Pair, wrapped};
use unaided::Unaided;
use witness::ByFaults;

use crate::copies::clone_by_fields;

/// Quality of the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Samples of both encoders arrive and are used.
    Following,
    /// No samples are used: the estimate is a forecast.
    Coasting,
    /// Too close to a vertex to know the branch: samples are not used.
    Holding,
    /// Several motions are followed: the start is doubted, or a singularity was passed.
    TwoBranches,
    /// One encoder is silent; the other is used.
    OneEncoder,
    /// Innovations exceed their covariance, or the estimate had diverged and was reinitialised.
    Inconsistent,
    /// An encoder has a fault.
    Faulty(Fault),
}

/// Changing part of the estimator, with its largest parts boxed. The motion that its errors are about is the simulation's.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Estimator {
    belief: Belief,
    /// Whether the last macro step came too close to a vertex to know the branch.
    held: bool,
    /// Whether no samples were used before the last macro step.
    coasts: bool,
    #[borsh(deserialize_with = "stored::read_boxed")]
    hypotheses: Box<Hypotheses>,
    #[borsh(deserialize_with = "stored::read_boxed")]
    doubt: Box<Doubt>,
    #[borsh(deserialize_with = "stored::read_boxed")]
    unaided: Box<[Unaided; 2]>,
    /// Learning of parameters; boxed, so that an estimator that does not learn is no larger.
    learning: Option<Box<Learning>>,
    encoders: [Encoder; 2],
    #[borsh(deserialize_with = "stored::read_boxed")]
    history: Box<History>,
    forecast: Forecast,
    alarm: Alarm,
    #[borsh(deserialize_with = "stored::read_boxed")]
    causes: Box<Causes>,
    /// Whether one encoder alone has lost the machine, which may be anywhere until both have shown it.
    adrift: bool,
    /// Whether the last samples have reinitialised the estimate.
    restarted: bool,
    /// Normalised innovation squared, summed over the last samples used together.
    nis: f64,
}

clone_by_fields!(Estimator {
    belief,
    held,
    coasts,
    hypotheses,
    doubt,
    unaided,
    learning,
    encoders,
    history,
    forecast,
    alarm,
    causes,
    adrift,
    restarted,
    nis,
});

impl Estimator {
    /// Initial estimate of a scene.
    pub fn new(constants: &Constants) -> Self {
        Self {
            belief: Belief::new(constants.start_variances()),
            held: false,
            coasts: true,
            hypotheses: Box::default(),
            doubt: Box::new(Doubt::NEW),
            unaided: Box::default(),
            learning: constants.prior.as_ref().map(|prior| Box::new(Learning::new(prior))),
            encoders: [Encoder::NEW; 2],
            history: Box::default(),
            forecast: Forecast::default(),
            alarm: Alarm::default(),
            causes: Box::default(),
            adrift: false,
            restarted: false,
            nis: 0.0,
        }
    }

    /// Unknown force and errors.
    pub fn belief(&self) -> &Belief {
        &self.belief
    }

    /// Measurement update of a motion by the samples that are new at time `now`, s on the encoders' clock. Returns the corrected motion,
    /// `None` where no sample has changed the estimate.
    /// Lengths that are learned change those of the closed loop.
    pub fn correct(&mut self, constants: &mut Constants, motion: &LinkState, measured: &Measured, now: f64) -> Option<LinkState> {
        let corrected = self.corrected(constants, motion, measured, now);
        match self.learned() {
            // Learning has begun anew.
            Some(learned) if constants.learn(&learned) => {
                let corrected = corrected.unwrap_or(*motion);
                Some(constants.linkage.closed(corrected).map_or(corrected, |(closed, _)| closed))
            }
            _ => corrected,
        }
    }

    /// Measurement update, with a motion that closes the loop unless learning has begun anew.
    fn corrected(&mut self, constants: &mut Constants, motion: &LinkState, measured: &Measured, now: f64) -> Option<LinkState> {
        let mut motion = *motion;
        let mut frame = constants.linkage.frame(&motion.theta);
        let mut errors = self.errors_beside_learned(constants, &motion, &frame);
        let systematic = self.systematic_errors(constants, (&motion, &frame), errors.as_ref());
        let mut samples =
            [0, 1].map(|i| self.encoders[i].sample(i, constants, (&motion, &frame, &self.history), systematic[i], (measured, now)));
        // Samples of encoders that are believed end a forecast even where their values cannot be used.
        if !self.is_coasting() {
            self.forecast.end();
        }
        if motion.fastest() >= HOPELESS_RATE {
            self.reset(constants, &Reset::Runaway);
            return Some(LinkState { omega: Links::zeros(), ..motion });
        }
        if samples.iter().all(Option::is_none) {
            return None;
        }
        self.give_up_by_one(constants, &frame);
        if let Some(anew) = self.restart(constants, &motion, &samples) {
            return Some(anew);
        }
        if self.adrift {
            self.look_for_both(&samples);
        }
        if self.held || self.adrift {
            return None;
        }
        // While several hypotheses are open behind a vertex, the first samples select one before any of them is corrected.
        let favoured = self.hypotheses.favoured(&constants.linkage, &self.belief, &samples);
        if let Some(other) = favoured {
            frame = self.take_over(other, constants, &mut motion);
            errors = self.errors_beside_learned(constants, &motion, &frame);
            samples = [0, 1].map(|i| samples[i].map(|sample| sample.about(i, &motion, &frame)));
        }
        let Update { used: samples, seen, likelihood, fit } = self.update(constants, (&motion, &frame), errors.as_ref(), &samples);
        let used = samples.iter().flatten().count();
        if used == 0 {
            return favoured.map(|_| motion);
        }
        self.forecast.end();
        self.inject(constants, (&mut motion, &mut frame), errors.as_ref(), &systematic);
        let constants = &*constants;
        let linkage = &constants.linkage;
        let confined = self.hypotheses.are_quiet() || self.doubt.is_open();
        let readings = [0, 1].map(|i| {
            let sample = Sample { rate: motion.omega[MEASURED[i]], ..samples[i]? };
            Some(if confined { self.encoders[i].confined_to_interval(&sample) } else { sample.reading() })
        });
        if let Some(other) = self.hypotheses.correct(linkage, &readings, likelihood) {
            frame = self.take_over(other, constants, &mut motion);
        }
        if let Some(other) = self.doubt.correct(constants, &readings, &seen) {
            self.reset(constants, &Reset::Assembly(&other.belief));
            (motion, frame) = (other.motion, linkage.frame(&other.motion.theta));
        }
        if used == 2 {
            self.doubt.begin(constants, &motion);
        }
        let exceed_masses = || self.causes.exceed_masses(constants);
        self.alarm.receive(&self.belief, &frame, constants.torque_scale(), (fit, used), exceed_masses);
        Some(motion)
    }

    /// Moves the motion by the mean of its error and learned values by that of theirs; the bank is about them then, and the frame that of
    /// the corrected motion.
    fn inject(
        &mut self,
        constants: &mut Constants,
        (motion, frame): (&mut LinkState, &mut Frame),
        errors: Option<&ReadingErrors>,
        systematic: &[(f64, f64); 2],
    ) {
        let learned = self.learning.as_mut().map(|learning| {
            let before = learning.values();
            let values = learning.corrected(&mut self.belief.bank, constants);
            constants.learn(&values);
            (values, values - before)
        });
        let Some((mut error, turn, corrected)) = self.belief.inject_error(&constants.linkage, frame, motion) else {
            return self.reset(constants, &Reset::Unclosed);
        };
        if let Some(((_, change), errors)) = learned.as_ref().zip(errors) {
            // Persistent errors of the readings are those about what is learned.
            for i in 0..2 {
                error[READINGS + i] = errors.rows[i].dot(&change.fixed_rows::<GEOMETRY>(LOADS)) / systematic[i].0;
            }
        }
        self.history.correct(&error, &turn);
        self.unaided.iter_mut().for_each(|unaided| unaided.correct(&error, &turn));
        self.causes.correct(&error, &turn);
        self.doubt.follow(&error, &turn);
        if let Some((learning, (values, _))) = self.learning.as_mut().zip(learned) {
            learning.correct(&self.belief.bank, &turn, values);
        }
        *frame = corrected;
    }

    /// Errors of both readings beside those of the motion; `None` where nothing is learned.
    fn errors_beside_learned(&self, constants: &Constants, motion: &LinkState, frame: &Frame) -> Option<ReadingErrors> {
        self.learning.is_some().then(|| {
            let by_lengths = frame.motors_by_lengths(constants.unlearned[0]);
            let by_encoders = constants.parameters.variances_of_encoders(&motion.theta);
            let further = [0, 1].map(|i| (by_lengths[i] + by_encoders[i]).sqrt());
            ReadingErrors { rows: frame.readings_by_geometry(), further }
        })
    }

    /// Standard deviation and known part, rad, of the persistent error of each encoder.
    fn systematic_errors(
        &self,
        constants: &Constants,
        (motion, frame): (&LinkState, &Frame),
        errors: Option<&ReadingErrors>,
    ) -> [(f64, f64); 2] {
        if let Some((learning, errors)) = self.learning.as_ref().zip(errors) {
            let sigma = learning.sigma_of_readings(&self.belief.bank, errors);
            return [0, 1].map(|i| (sigma[i], learning.values()[OFFSETS.start + i]));
        }
        let [length, offset] = constants.unlearned;
        let by_lengths = frame.motors_by_lengths(length);
        let by_encoders = constants.parameters.variances_of_encoders(&motion.theta);
        [0, 1].map(|i| ((by_lengths[i] + offset * offset + by_encoders[i]).sqrt(), 0.0))
    }

    /// Measurement update of the bank by the samples that pass their gates, one after the other.
    fn update(
        &mut self,
        constants: &Constants,
        (motion, frame): (&LinkState, &Frame),
        errors: Option<&ReadingErrors>,
        samples: &[Option<Sample>; 2],
    ) -> Update {
        if self.are_exchanged((motion, frame), samples) {
            for (i, sample) in samples.iter().flatten().enumerate() {
                self.encoders[i].leave_out_lastingly(sample.innovation.residual);
            }
        }
        let mut update = Update { used: [None; 2], seen: [None; 2], likelihood: 0.0, fit: 0.0 };
        let (mut nis, models) = (0.0, self.models(constants, motion));
        let beside_learned = errors.filter(|_| self.learning.as_ref().is_some_and(|learning| learning.learns_geometry()));
        for (i, sample) in samples.iter().enumerate() {
            let Some(sample) = sample else { continue };
            let alone = !self.encoders[1 - i].is_believed();
            let by_one = alone.then(|| sample.alone(i, &self.encoders[i]));
            let sample = by_one.as_ref().unwrap_or(sample);
            let learned = beside_learned.map(|errors| sample.learned(i, errors.further[i]));
            let used = learned.as_ref().unwrap_or(sample);
            let mut expected = self.belief.bank.predict_sample(&used.innovation);
            let by_learned = self.learning.as_ref().zip(errors);
            let columns =
                by_learned.map(|(learning, errors)| learning.expect(&mut expected, (i, &used.innovation), &errors.rows[i]));
            let own = expected.nis();
            nis += own;
            self.watch(constants, (motion, frame), (i, sample), own, errors);
            self.begin_unaided(i, frame, &models, errors);
            let witnessed = self.encoders[1 - i].is_settled();
            let conditions = GateConditions { patient: self.hypotheses.is_branch_known(), witnessed };
            let (unaided, mut repetition) = (&mut self.unaided[i], Fault::None);
            let judge = || {
                repetition = unaided.judge(sample);
                repetition
            };
            if let Some(mut told) = self.encoders[i].admit(&self.belief.bank, (&expected, used), conditions, judge) {
                if let (Some(learning), Some(columns)) = (&mut self.learning, &columns) {
                    let persistent = ([used.persistent, sample.persistent], self.encoders[i].samples_of_persistent_error());
                    learning.update(&mut told, columns, persistent, used.rests());
                }
                self.belief.bank.update(&told);
                if self.hypotheses.are_open() {
                    update.likelihood += expected.log_likelihood();
                }
                update.fit += own;
                update.used[i] = Some(*sample);
                self.unaided[1 - i].update(&self.encoders[i], sample);
                if self.doubt.is_open() {
                    let encoder = &self.encoders[i];
                    // Accelerations do not show what hardly changes.
                    let told = sample.with_persistent_error(i, 0.0);
                    update.seen[i] = encoder.unconfined(&told);
                    if let Some(reading) = &update.seen[i] {
                        self.doubt.receive(i, &told.innovation_of(reading));
                    }
                }
            } else if repetition != Fault::None {
                self.reset(constants, &Reset::Repetition(i, repetition));
            }
        }
        self.nis = if nis < LARGEST_NIS { nis } else { LARGEST_NIS };
        update
    }

    /// Lets the causes see a sample of encoder i, of this normalised innovation squared, before the bank is updated.
    fn watch(
        &mut self,
        constants: &Constants,
        (motion, frame): (&LinkState, &Frame),
        (i, sample): (usize, &Sample),
        nis: f64,
        errors: Option<&ReadingErrors>,
    ) {
        let before = || {
            let belief = Belief { bank: without_parameters(self.learning.as_deref(), &self.belief.bank, errors), ..self.belief };
            belief.with_force(&(self.alarm.reference_force(frame) - belief.tangent_force(frame)))
        };
        self.causes.begin_where_surprised(constants, (nis, self.alarm.is_on()), || (frame.basis.tr_mul(&motion.omega), before()));
        if self.causes.are_judged()
            && let Some(reading) = self.encoders[i].unconfined(sample)
        {
            self.causes.receive(i, &sample.innovation_of(&reading));
        }
    }

    /// Lets the estimate without encoder i begin or end, as its reading repeats or not.
    fn begin_unaided(&mut self, i: usize, frame: &Frame, models: &[f64; MODELS], errors: Option<&ReadingErrors>) {
        let encoders = [&self.encoders[i], &self.encoders[1 - i]];
        let bank = || without_parameters(self.learning.as_deref(), &self.belief.bank, errors);
        self.unaided[i].receive(encoders, || (bank(), self.belief.tangent_force(frame).norm()), models);
    }

    /// Whether the first samples of both encoders are far from the estimate, and at the angles that it expects if they are exchanged. Later
    /// samples do not count: an estimate that is lost meets such angles by chance.
    fn are_exchanged(&self, (motion, frame): (&LinkState, &Frame), samples: &[Option<Sample>; 2]) -> bool {
        let [Some(left), Some(right)] = samples else { return false };
        if self.encoders.iter().any(|encoder| encoder.interval() > 0.0)
            || [left, right].iter().any(|sample| sample.innovation.residual.abs() <= DIVERGED_INNOVATION)
        {
            return false;
        }
        let nis =
            |both: [Innovation; 2]| both.iter().map(|innovation| self.belief.bank.predict_sample(innovation).nis()).sum::<f64>();
        let exchanged = [left.about(1, motion, frame), right.about(0, motion, frame)].map(|sample| sample.innovation);
        nis([left.innovation, right.innovation]) > GATE && nis(exchanged) <= GATE
    }

    /// Restarts an estimate that samples of both encoders have long been far from, since one alone may be faulty; next to a vertex, where
    /// samples are not used, one that is far suffices. Returns the motion.
    fn restart(&mut self, constants: &Constants, motion: &LinkState, samples: &[Option<Sample>; 2]) -> Option<LinkState> {
        self.restarted = false;
        let [Some(left), Some(right)] = samples else { return None };
        if !self.encoders.iter().all(Encoder::is_believed) {
            return None;
        }
        let off = [left, right].map(|sample| sample.innovation.residual.abs() > DIVERGED_INNOVATION);
        let off = if self.held { off[0] || off[1] } else { off[0] && off[1] };
        let intervals = self.encoders.each_ref().map(Encoder::interval);
        let lost = self.hypotheses.is_lost(off, intervals[0].min(intervals[1]).min(LONGEST_SAMPLE_TIME));
        let shown = self.adrift && self.encoders.iter().all(Encoder::is_settled);
        if !lost && !shown {
            return None;
        }
        let axes = [(0, left), (1, right)].map(|(i, sample)| {
            let rate = self.encoders[i].rate();
            Pair::new(sample.angle + sample.age * rate, rate)
        });
        let anew = started_by_motors(constants, motion, axes)?;
        let Parameters { sigma, quantum, .. } = constants.parameters;
        let mut variances = constants.start_variances();
        for i in 0..2 {
            let noise = sigma[i] * sigma[i] + quantum[i] * quantum[i] / 12.0;
            variances[0] = variances[0].max(noise);
            variances[1] = variances[1].max(2.0 * noise / (intervals[i] * intervals[i]));
        }
        self.reset(constants, &Reset::Samples { variances, innovations: [left, right].map(|sample| sample.innovation.residual) });
        Some(anew)
    }

    /// Starts the estimate again; the caller replaces the motion. Each field says which kinds of reset concern it.
    fn reset(&mut self, constants: &Constants, kind: &Reset) {
        use Reset::{Adrift, Assembly, Branch, Repetition, Runaway, Samples, Unclosed};
        let Self {
            belief,
            held,
            coasts: _,
            hypotheses,
            doubt,
            unaided,
            learning,
            encoders,
            history,
            forecast,
            alarm,
            causes,
            adrift,
            restarted,
            nis: _,
        } = self;
        if let (Some(learning), Some(prior)) = (learning, &constants.prior) {
            match kind {
                Branch => learning.pause(&belief.bank),
                Repetition(_, fault) if *fault != Fault::Stuck => learning.pause(&belief.bank),
                // Samples have been believed that were wrong, or the estimate was: what was learned by them is not trusted.
                Repetition(..) | Assembly(_) | Samples { .. } | Unclosed | Runaway | Adrift => learning.begin_all_anew(prior),
            }
        }
        match kind {
            // The hypothesis brings its own belief.
            Branch => (),
            Assembly(other) => *belief = **other,
            Samples { variances, .. } => *belief = Belief::new(*variances),
            Unclosed => belief.bank = Bank::new(constants.start_variances()),
            Runaway | Adrift => *belief = Belief::new(constants.variances_anywhere()),
            Repetition(i, _) => belief.bank = unaided[*i].bank().unwrap_or(belief.bank),
        }
        match kind {
            Repetition(i, Fault::Stuck) => unaided[*i] = Unaided::default(),
            Repetition(..) => (),
            Branch | Assembly(_) | Samples { .. } | Unclosed | Runaway | Adrift => **unaided = Default::default(),
        }
        match kind {
            Branch | Assembly(_) | Samples { .. } => history.clear(),
            Unclosed | Runaway | Adrift | Repetition(..) => (),
        }
        match kind {
            Samples { .. } => causes.close(true),
            Branch | Unclosed | Runaway | Adrift => causes.close(false),
            // The assembly explains what has surprised.
            Assembly(_) => **causes = Causes::default(),
            Repetition(..) => (),
        }
        match kind {
            Samples { .. } => (**hypotheses, **doubt) = (Hypotheses::of_unknown_side(), Doubt::ENDED),
            Unclosed | Runaway | Adrift => {
                if doubt.is_open() {
                    hypotheses.doubt_side(0.0);
                }
                **doubt = Doubt::ENDED;
            }
            Branch | Assembly(_) | Repetition(..) => (),
        }
        match kind {
            Samples { innovations, .. } => {
                encoders.iter_mut().zip(innovations).for_each(|(encoder, innovation)| encoder.begin_anew(*innovation));
                (*alarm, *held, *adrift, *restarted) = (Alarm::default(), false, false, true);
            }
            Adrift => {
                encoders.iter_mut().for_each(Encoder::settle_anew);
                forecast.end();
                *adrift = true;
            }
            Branch | Assembly(_) | Unclosed | Runaway | Repetition(..) => (),
        }
    }

    /// Parameters that the master has set to other values begin anew; `tuned` is the prior with these values.
    pub fn begin_anew_where_tuned(&mut self, constants: &Constants, tuned: Option<&Prior>) {
        if let (Some(learning), Some(before), Some(tuned)) = (&mut self.learning, &constants.prior, tuned) {
            for i in (0..LEARNED).filter(|i| before.values[*i] != tuned.values[*i]) {
                learning.begin_anew(tuned, i);
            }
        }
    }

    /// Values of what is learned; `None` where nothing is.
    pub fn learned(&self) -> Option<Learned> {
        self.learning.as_ref().map(|learning| learning.values())
    }

    /// Standard deviations of what is learned, and 0 of what is not.
    pub fn learned_sigma(&self) -> Learned {
        self.learning.as_ref().map_or_else(Learned::zeros, |learning| learning.sigma(&self.belief.bank))
    }

    /// Learned parameters that have been moved to a bound since the last call, and their bounds.
    pub fn take_bounds(&mut self, constants: &Constants) -> impl Iterator<Item = (usize, [f64; 2])> {
        self.learning.iter_mut().flat_map(|learning| learning.take_bounds(constants))
    }

    /// Normalised error squared of the learned parameters among `which` that are not known, against true values, and their number.
    pub fn learned_nees(&self, truth: &Learned, which: std::ops::Range<usize>) -> Option<(f64, usize)> {
        self.learning.as_ref().map(|learning| learning.nees(&self.belief.bank, truth, which))
    }

    /// Lets a hypothesis replace the estimate. Returns the frame of the new motion.
    fn take_over(&mut self, other: usize, constants: &Constants, motion: &mut LinkState) -> Frame {
        self.reset(constants, &Reset::Branch);
        self.hypotheses.take_over(other, constants, (motion, &mut self.belief));
        constants.linkage.frame(&motion.theta)
    }

    /// Gives up the machine where one encoder alone, which has long been used, does not follow it: it may be anywhere until both encoders show it.
    fn give_up_by_one(&mut self, constants: &Constants, frame: &Frame) {
        let is_used = |encoder: &Encoder| encoder.is_believed() && encoder.is_settled();
        let is_gone = |encoder: &Encoder| encoder.has_received() && !encoder.is_believed() && !encoder.is_settled();
        let [left, right] = &self.encoders;
        let alone = is_used(left) && is_gone(right) || is_used(right) && is_gone(left);
        if alone && !self.adrift && bands::sigmas(frame, &self.belief)[0].max() > LARGEST_SIGMA_ALONE {
            self.reset(constants, &Reset::Adrift);
        }
    }

    /// Looks for the end of a failure by which the machine was given up. Where both encoders have long been back and the estimate cannot begin anew by
    /// them, as their samples never come together or the loop does not close, their samples correct it from anywhere.
    fn look_for_both(&mut self, samples: &[Option<Sample>; 2]) {
        self.adrift = !self.encoders.iter().all(Encoder::is_settled);
        for (i, sample) in samples.iter().enumerate() {
            if let Some(sample) = sample {
                self.encoders[i].stays_away(sample, false);
            }
            // An estimate that begins anywhere is itself off.
            if !self.adrift || !self.encoders[i].is_believed() {
                self.encoders[i].settle_anew();
            }
        }
    }

    /// Time update by a macro step of h seconds from a motion to another, in a scene without the unknown force.
    pub fn predict(&mut self, constants: &Constants, scene: &impl Scene, [from, to]: [&LinkState; 2], h: f64) {
        let Constants { linkage, parameters, .. } = constants;
        let frame = linkage.frame(&from.theta);
        let coasts = self.is_coasting();
        let models = self.models(constants, from);
        if coasts && !self.coasts {
            self.belief.bank.reset_priors(&models);
        }
        self.coasts = coasts;
        let (mass, ahead) = (scene.mass(&from.theta), linkage.frame(&to.theta));
        let (step, learned) = if self.learning.is_some() {
            let flow: Flow<LEARNED> = flow(linkage, scene, (from, &frame), &self.belief.force, (h, 1));
            (Propagation::along(&flow, mass, &frame, (to, &ahead), h), Some(flow))
        } else {
            let flow: Flow<0> = flow(linkage, scene, (from, &frame), &self.belief.force, (h, 1));
            (Propagation::along(&flow, mass, &frame, (to, &ahead), h), None)
        };
        let inertia = step.inertia_torque(&((to.omega - from.omega) / h));
        let scale = constants.torque_scale();
        if coasts && !self.adrift && parameters.forecast == Bands::SigmaPoints {
            self.forecast.step(constants, (from, &self.belief), scene, (h, [scale, inertia]));
        }
        self.hypotheses.open_after_vertex(constants, (from, &self.belief), scene, &step, to);
        self.history.step((from, &frame), &step.f, h, parameters.max_delay);
        // Errors of masses are observable through quantisation intervals, which confine the angles; in white noise they drown.
        let observable = if self.has_intervals(parameters) { inertia } else { 0.0 };
        // Without samples each model goes on by itself: a quantile of their mixture shows what a covariance hides. What acts changes as the
        // machine moves, and errors of masses appear that no sample has revealed yet.
        let force = self.belief.tangent_force(&frame);
        let unrevealed = if self.learning.is_some() { 0.0 } else { inertia };
        let (further, lasting) = if coasts {
            ((force.norm_squared() * CARRIED_WALK + unrevealed * unrevealed * FORECAST_MASS_WALK).sqrt(), f64::INFINITY)
        } else {
            let longer = match self.learning {
                Some(_) => LEARNING_PERSISTENCES[usize::from(scene.has_abrupt_forces())],
                None => 1.0,
            };
            (0.0, parameters.switch_time * longer)
        };
        let (noise, scales, timing) = (step.noise(h), [scale, observable, further], (h, lasting));
        // A branch behind a singularity or an assembly that is not known teaches nothing.
        let known = !step.held && !self.hypotheses.are_open() && !self.hypotheses.are_quiet() && !self.doubt.is_open();
        match (&mut self.learning, &learned) {
            // Nothing is known.
            _ if self.adrift => (),
            (Some(learning), Some(flow)) if known => {
                learning.begin_geometry(&mut self.belief.bank, &frame);
                learning.predict(&mut self.belief.bank, (&step, flow), &noise, (scales, timing), &models);
            }
            (learning, _) => {
                learning.iter_mut().for_each(|learning| learning.pause(&self.belief.bank));
                self.belief.bank.predict(&step.f, &noise, scales, timing, &models);
            }
        }
        for (i, unaided) in self.unaided.iter_mut().enumerate() {
            unaided.predict((&step, &noise), [scale, observable], timing, &self.encoders[1 - i]);
        }
        let wrong = self.alarm.is_on() || self.encoders.iter().any(Encoder::fails);
        let by = || ByFaults::new(scene, [from, to], &self.belief.force, h);
        let accelerations = || frame.basis.tr_mul(&(to.omega - from.omega)) / h;
        self.causes.predict(&step, (&noise, [scale, observable]), (wrong, h), accelerations, by);
        if wrong && let Some(i) = self.encoders.iter().position(|encoder| encoder.fault == Fault::Stuck) {
            self.causes.know(Cause::Encoder(i));
        }
        self.held = step.held;
        let about = (&step, [from, to], &self.belief.force);
        if let Some(odds) = self.doubt.step(constants, scene, about, (observable > 0.0, h)) {
            self.hypotheses.doubt_side(odds);
        }
        self.hypotheses.step(constants, (to, &self.belief), scene, (&step, coasts), h);
        self.encoders.iter_mut().for_each(|encoder| encoder.step(h));
        self.alarm.step(h, inertia);
    }

    /// Whether a quantisation interval says more than white noise.
    fn has_intervals(&self, parameters: &Parameters) -> bool {
        (0..2).any(|i| !self.encoders[i].is_dithered(parameters.sigma[i], parameters.quantum[i]))
    }

    /// Prior probabilities of the models while samples arrive.
    fn models(&self, constants: &Constants, motion: &LinkState) -> [f64; MODELS] {
        match self.has_intervals(&constants.parameters) {
            true if motion.side()[0].abs() < NEAR_SINGULARITY => LIKELY_MODELS,
            true => BY_INTERVALS,
            false => BY_NOISE,
        }
    }

    /// Whether no samples are used: no encoder is believed, or one alone has lost the machine.
    pub fn is_coasting(&self) -> bool {
        self.adrift || !self.encoders.iter().any(Encoder::is_believed)
    }

    /// Quality of the estimate.
    pub fn status(&self) -> Status {
        let fault = self.encoders.iter().map(|encoder| encoder.fault).max().unwrap_or_default();
        match () {
            () if self.restarted && !self.is_coasting() => Status::Inconsistent,
            () if self.adrift => Status::Coasting,
            () if self.held => Status::Holding,
            () if fault != Fault::None => Status::Faulty(fault),
            () if self.is_coasting() => Status::Coasting,
            () if self.encoders.iter().any(Encoder::is_silent) => Status::OneEncoder,
            () if self.hypotheses.are_open() || self.doubt.is_open() => Status::TwoBranches,
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
        self.encoders[i].has_received()
    }

    /// Whether samples of both encoders have been believed for long enough that the estimate has settled on them.
    pub fn is_settled(&self) -> bool {
        self.encoders.iter().all(|encoder| encoder.is_settled() && encoder.fault == Fault::None)
    }

    /// Whether the last samples have reinitialised the estimate, with the angles that they read.
    pub fn has_restarted(&self) -> bool {
        self.restarted
    }

    /// Innovation of the last sample of each encoder: measured minus expected angle, rad.
    pub fn innovation(&self) -> [f64; 2] {
        self.encoders.each_ref().map(Encoder::innovation)
    }

    /// Normalised innovation squared of the last correction, summed over its samples.
    pub fn nis(&self) -> f64 {
        self.nis
    }

    /// Whether an unmodelled force is detected.
    pub fn alarm(&self) -> bool {
        self.alarm.is_on()
    }

    /// Whether derivatives by masses and friction are asked for.
    pub fn asks_for_parameters(&self) -> bool {
        self.learning.is_some() || self.causes.are_judged() || self.doubt.is_open()
    }

    /// Most probable cause of the last alarm or fault, and its probability: 1 where an encoder's own samples show it.
    pub fn cause(&self, constants: &Constants) -> (Cause, f64) {
        let first = |is: &dyn Fn(&Encoder) -> bool| self.encoders.iter().position(is);
        if first(&|encoder| matches!(encoder.fault, Fault::Late | Fault::Future)).is_some() {
            return (Cause::Timing, 1.0);
        }
        // An encoder that has never delivered a sample is not connected.
        let is_missing =
            |encoder: &Encoder| encoder.is_silent() && encoder.has_received() && !self.encoders.iter().all(Encoder::is_silent);
        match first(&|encoder| matches!(encoder.fault, Fault::Stuck | Fault::Invalid) || is_missing(encoder)) {
            Some(i) => (Cause::Encoder(i), 1.0),
            None => self.causes.most_probable(constants, first(&Encoder::is_away)),
        }
    }

    /// Probability of a direct singularity within the horizon under the held inputs of `scene`, which include the unknown force: the fraction
    /// of 13 motions, those of the sigma points and of their mean, that meet one.
    pub fn singularity_probability(&self, constants: &Constants, motion: &LinkState, scene: &impl Scene, step: f64) -> f64 {
        self.forecast.singularity_probability(constants, (motion, &self.belief), scene, step)
    }

    /// Refuses a stored estimator that is not possible for this mechanism and motion.
    pub fn check(&self, constants: &Constants, motion: &LinkState) -> Result<(), &'static str> {
        let linkage = &constants.linkage;
        if !self.belief.is_sound(linkage, motion)
            || !self.hypotheses.is_sound(linkage)
            || !self.doubt.is_sound(linkage)
            || !self.unaided.iter().all(Unaided::is_sound)
        {
            return Err("its estimate has a state or covariance that is not valid");
        }
        if !self.encoders.iter().all(Encoder::is_sound) || !self.history.is_sound() || !self.forecast.is_sound(linkage) {
            return Err("a sample, the history or the forecast of its estimator is not valid");
        }
        if !self.nis.is_finite() || !self.alarm.is_sound() || !self.causes.is_sound() {
            return Err("a number of its estimator is not finite");
        }
        if self.learning.is_some() != constants.prior.is_some()
            || !self.learning.iter().all(|learning| learning.is_sound(&self.belief.bank, constants))
        {
            return Err("what its estimator has learned is not valid");
        }
        Ok(())
    }
}

/// Why the estimate starts again.
enum Reset<'a> {
    /// A hypothesis behind a vertex or a singularity replaces it.
    Branch,
    /// The motion in the other assembly than the start replaces it, with this belief.
    Assembly(&'a Belief),
    /// Samples of both encoders show the machine elsewhere: variances of angles, rad², rates, rad²/s², and force, (N·m)²; innovations, rad.
    Samples { variances: [f64; 3], innovations: [f64; 2] },
    /// No closed configuration is near the corrected one: the covariance is worthless.
    Unclosed,
    /// It is faster than any machine.
    Runaway,
    /// One encoder alone has lost the machine, which may be anywhere.
    Adrift,
    /// The reading of an encoder repeats, with this fault: the estimate without it replaces the one by both.
    Repetition(usize, Fault),
}

/// Measurement update by the samples of both encoders.
struct Update {
    /// Those that were used.
    used: [Option<Sample>; 2],
    /// Information of those of them that tell assemblies apart: all that are not confined to a quantisation interval.
    seen: [Option<Reading>; 2],
    /// Their log-likelihood.
    likelihood: f64,
    /// Their normalised innovation squared, summed.
    fit: f64,
}
