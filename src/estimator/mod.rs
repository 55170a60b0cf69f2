//! Estimator: an error-state Kalman filter on the tangent space of the closed loop, with an unknown force among its states, a
//! multiple-model bank of process noises, and alternative hypotheses after singularities; `docs/estimator-theory.md` derives it.
//!
//! | file | holds |
//! | --- | --- |
//! | `tangent.rs`, `error_state.rs` | the closed loop: J, N, closure; errors on N and their covariance |
//! | `flow.rs`, `propagation.rs` | motion and transition by a scene's equations; process noise |
//! | `belief.rs` | unknown force; Kalman filter of each model, and their mixture |
//! | `filter.rs` | the joint filter: motion and force in `belief.rs`, parameters in `learning.rs` |
//! | `learning.rs` | parameters that the estimator learns: masses, friction, lengths and mounting angles |
//! | `encoder.rs`, `trust.rs`, `quantiser.rs`, `history.rs` | samples: validity, trust, noise, intervals, delay |
//! | `hypotheses.rs` | the open question about the branch, and the motions that are its possible answers |
//! | `unaided.rs` | the estimate without an encoder that repeats its reading |
//! | `forecast.rs`, `bands.rs`, `geometry.rs`, `alarm.rs` | reported properties of the estimate: forecast, uncertainty, alarm |
//! | `unknown_commands.rs` | commands that a forecast does not know |
//! | `doubt.rs` | whether the start is in the right assembly |
//! | `witness.rs`, `cause.rs` | filter without faults; comparison of the explanations of an alarm |
//! | `machine.rs`, `tuning.rs` | the estimator's model of the machine, with the master's parameters; tuned constants |
//! | `stored.rs` | matrices in stored states |
//!
//! A simulation passes the mechanism and the scene: equations of motion with derivatives, and the motion at the beginning and the end of
//! each macro step. The simulation owns the motion. The estimator returns the corrected motion, and the unknown force with which the
//! simulation continues.
//!
//! Invariant: no input or output and no clock; equal input bits give equal output bits.

mod alarm;
mod bands;
pub mod belief;
mod cause;
mod doubt;
mod encoder;
pub mod error_state;
mod filter;
pub mod flow;
mod forecast;
mod geometry;
mod history;
mod hypotheses;
mod learning;
mod machine;
mod propagation;
mod quantiser;
mod stored;
pub mod tangent;
mod trust;
mod tuning;
mod unaided;
mod unknown_commands;
mod witness;

use borsh::{BorshDeserialize, BorshSerialize};

use alarm::Alarm;
pub use belief::Belief;
use belief::{Bank, Innovation};
pub use cause::Cause;
use cause::Causes;
use doubt::Doubt;
pub use encoder::{Encoder, Fault, Measured};
use encoder::{GateConditions, Measurement};
use error_state::{Error, FORCE, LEARNED, Learned};
use filter::{Correction, Estimated, Filter};
use flow::{Flow, flow};
pub use flow::{Linearised, Scene};
use forecast::Forecast;
use history::History;
pub use history::REMEMBERED;
use hypotheses::{Hypotheses, started_by_motors};
use learning::{Persistent, ReadingErrors};
pub use machine::{Bands, Machine, Parameters, Prior, set_lengths};
use propagation::Propagation;
pub use tangent::{Frame, LinkState, Linkage, Links, MEASURED, Pair, wrapped};
use tuning::{
    BY_INTERVALS, BY_NOISE, CARRIED_WALK, DIVERGED_INNOVATION, FORECAST_MASS_WALK, GATE, HOPELESS_RATE, LARGEST_HOLD, LARGEST_NIS,
    LARGEST_SIGMA_ALONE, LEARNING_PERSISTENCES, LIKELY_MODELS, LONGEST_SAMPLE_TIME, MODELS, NEAR_SINGULARITY,
};
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
    /// Several motions are tracked: the assembly of the start is in doubt, or a singularity was passed.
    TwoBranches,
    /// One encoder is silent; the other is used.
    OneEncoder,
    /// Innovations are larger than their covariance allows, or the estimate had diverged and was reinitialised.
    Inconsistent,
    /// An encoder has a fault.
    Faulty(Fault),
}

/// State of the estimator, with its largest parts boxed. Its errors refer to the motion, which the simulation owns.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Estimator {
    filter: Filter,
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
    encoders: [Encoder; 2],
    #[borsh(deserialize_with = "stored::read_boxed")]
    history: Box<History>,
    forecast: Forecast,
    alarm: Alarm,
    #[borsh(deserialize_with = "stored::read_boxed")]
    causes: Box<Causes>,
    /// Whether the estimate from one encoder alone has lost the machine, which may be anywhere until both encoders have settled.
    adrift: bool,
    /// Whether the last samples have reinitialised the estimate.
    restarted: bool,
    /// Normalised innovation squared, summed over the last samples used together.
    nis: f64,
}

clone_by_fields!(Estimator {
    filter,
    held,
    coasts,
    hypotheses,
    doubt,
    unaided,
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
    pub fn new(machine: &Machine) -> Self {
        Self {
            filter: Filter::new(machine),
            held: false,
            coasts: true,
            hypotheses: Box::default(),
            doubt: Box::new(Doubt::Pending),
            unaided: Box::default(),
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
        &self.filter.belief
    }

    /// Measurement update of a motion by the samples that are new at time `now`, s on the encoders' clock. Returns the corrected motion;
    /// `None` if no sample has changed the estimate. Learned lengths change the closed loop of `machine`.
    pub fn correct(&mut self, machine: &mut Machine, motion: &LinkState, measured: &Measured, now: f64) -> Option<LinkState> {
        let mut corrected = self.corrected(machine, motion, measured, now);
        if let Some(learned) = self.learned() {
            let changed = machine.learn(&learned);
            // If learning has restarted, all motions have to close the loop of the new lengths. The machine may already have them.
            let open = corrected.unwrap_or(*motion);
            if changed || !self.filter.learns_geometry() && !machine.linkage.is_closed(&open) {
                corrected = Some(machine.linkage.closed(open).map_or(open, |(closed, _)| closed));
            }
            self.hypotheses.close(&machine.linkage);
            self.doubt.close(&machine.linkage);
        }
        corrected
    }

    /// Stages of a measurement update. The returned motion closes the loop unless learning has restarted.
    fn corrected(&mut self, machine: &mut Machine, motion: &LinkState, measured: &Measured, now: f64) -> Option<LinkState> {
        let mut estimate = self.filter.estimated(machine, motion);
        let mut measurements = self.receive(machine, &estimate, (measured, now));
        if motion.fastest() >= HOPELESS_RATE {
            self.reset(machine, &Reset::Runaway);
            return Some(LinkState { omega: Links::zeros(), ..*motion });
        }
        if measurements.iter().all(Option::is_none) {
            return None;
        }
        self.drop_single_encoder_track(machine, &estimate.frame);
        if let Some(started) = self.restart(machine, motion, &measurements) {
            return Some(started);
        }
        self.look_for_both(&measurements);
        if self.held || self.adrift {
            return None;
        }
        let switched = self.switch_branch(machine, &mut estimate, &mut measurements);
        let residuals = self.update(machine, &estimate, &measurements);
        if residuals.iter().all(|residual| residual.accepted().is_none()) {
            return switched.then_some(estimate.motion);
        }
        self.end_forecast();
        self.inject(machine, &mut estimate);
        self.judge_motions(machine, &mut estimate, &residuals);
        self.judge_force(machine, &estimate, &residuals);
        Some(estimate.motion)
    }

    /// New and valid samples of both encoders, with their deviations from the estimate. Ends a forecast, unless the estimate is coasting.
    fn receive(
        &mut self,
        machine: &Machine,
        Estimated { motion, frame, sigma, offset, .. }: &Estimated,
        measured: (&Measured, f64),
    ) -> [Option<Measurement>; 2] {
        let history = &self.history;
        let mut receive =
            |i: usize| self.encoders[i].measurement(i, machine, (motion, frame, history), (sigma[i], offset[i]), measured);
        let measurements = [receive(0), receive(1)];
        // Samples of trusted encoders end a forecast even if their values cannot be used.
        if !self.is_coasting() {
            self.end_forecast();
        }
        measurements
    }

    /// Ends a forecast. From then on, the errors by commands that were unknown are errors of the estimate.
    fn end_forecast(&mut self) {
        if let Some(by_commands) = self.forecast.end() {
            self.filter.belief.bank.add(&by_commands);
        }
    }

    /// If several hypotheses are open after a vertex, the first samples may select one before any of them is corrected. Returns whether a
    /// hypothesis replaces the estimate.
    fn switch_branch(&mut self, machine: &Machine, estimate: &mut Estimated, measurements: &mut [Option<Measurement>; 2]) -> bool {
        let Some(other) = self.hypotheses.favoured(&machine.linkage, &self.filter.belief, measurements) else { return false };
        self.take_over(other, machine, estimate);
        let Estimated { motion, frame, errors, .. } = estimate;
        *errors = self.filter.reading_errors(machine, motion, frame);
        for (i, measurement) in measurements.iter_mut().enumerate() {
            *measurement = measurement.map(|measurement| measurement.about(i, motion, frame));
        }
        true
    }

    /// Corrects the estimate by its mean errors, and everything that refers to its motion.
    fn inject(&mut self, machine: &mut Machine, estimate: &mut Estimated) {
        let Some(Correction { error, turn }) = self.filter.correct(machine, estimate) else {
            return self.reset(machine, &Reset::Unclosed);
        };
        self.history.correct(&error, &turn);
        self.unaided.iter_mut().for_each(|unaided| unaided.correct(&error, &turn));
        self.causes.correct(&error, &turn);
        self.doubt.follow(&error, &turn);
    }

    /// Compares the other motions, if any are tracked, with the samples that were used. From the first samples of both encoders on, both
    /// assemblies of the start are tracked (`doubt.rs`).
    fn judge_motions(&mut self, machine: &Machine, estimate: &mut Estimated, residuals: &[Residual; 2]) {
        if self.hypotheses.are_open() || self.hypotheses.are_quiet() || self.doubt.is_open() {
            self.judge_alternatives(machine, estimate, residuals);
        }
        if residuals.iter().all(|residual| residual.accepted().is_some()) {
            self.doubt.begin(machine, &estimate.motion);
        }
    }

    /// Updates the alternatives by the samples that were used; one of them may replace the estimate.
    fn judge_alternatives(&mut self, machine: &Machine, estimate: &mut Estimated, residuals: &[Residual; 2]) {
        let confined = self.hypotheses.are_quiet() || self.doubt.is_open();
        let used = [0, 1].map(|i| {
            let Accepted { measurement, .. } = residuals[i].accepted()?;
            let measurement = Measurement { rate: estimate.motion.omega[MEASURED[i]], ..*measurement };
            Some(if confined { self.encoders[i].confined_to_interval(&measurement) } else { measurement })
        });
        let likelihood =
            residuals.iter().filter_map(Residual::accepted).map(|accepted| accepted.likelihood).fold(0.0, |sum, of| sum + of);
        if let Some(other) = self.hypotheses.correct(&machine.linkage, &used, likelihood) {
            self.take_over(other, machine, estimate);
        }
        // The other motion has no history, so the comparison by such samples begins again.
        if residuals.iter().filter_map(Residual::accepted).any(|accepted| accepted.measurement.is_approximate) {
            self.doubt.restart(machine);
        }
        let seen = [0, 1].map(|i| self.seen(i, &residuals[i].accepted()?.measurement));
        if let Some(other) = self.doubt.correct(machine, &used, &seen) {
            self.reset(machine, &Reset::Assembly(&other.belief));
            estimate.move_to(&machine.linkage, &other.motion);
        }
    }

    /// Updates the alarm for an unmodelled force by the samples that were used.
    fn judge_force(&mut self, machine: &Machine, estimate: &Estimated, residuals: &[Residual; 2]) {
        let nis = || residuals.iter().filter_map(Residual::accepted).map(|accepted| accepted.nis);
        let squares = (nis().fold(0.0, |sum, nis| sum + nis), nis().count());
        let exceed_masses = || self.causes.exceed_masses(machine);
        self.alarm.receive(&self.filter.belief, &estimate.frame, machine.torque_scale(), squares, exceed_masses);
    }

    /// Measurement update of the bank, one sample after the other.
    fn update(&mut self, machine: &Machine, estimate: &Estimated, measurements: &[Option<Measurement>; 2]) -> [Residual; 2] {
        if self.are_exchanged((&estimate.motion, &estimate.frame), measurements) {
            for (i, measurement) in measurements.iter().flatten().enumerate() {
                self.encoders[i].leave_out_lastingly(measurement.innovation.residual);
            }
        }
        let models = self.models(machine, &estimate.motion);
        let learns = self.filter.learns_geometry();
        let (mut nis, mut residuals) = (0.0, [Residual::None, Residual::None]);
        for (i, measurement) in measurements.iter().enumerate() {
            if let Some(measurement) = measurement {
                residuals[i] = self.update_by(machine, estimate, (&models, learns), (i, measurement));
                nis += residuals[i].nis();
            }
        }
        self.nis = if nis < LARGEST_NIS { nis } else { LARGEST_NIS };
        residuals
    }

    /// Measurement update of the bank by a sample of encoder i: prediction, gate, gain and covariance. `models` are the prior probabilities
    /// of the models. `learns`: lengths and mounting angles were already being learned before these samples.
    fn update_by(
        &mut self,
        machine: &Machine,
        Estimated { motion, frame, errors, .. }: &Estimated,
        (models, learns): (&[f64; MODELS], bool),
        (i, measurement): (usize, &Measurement),
    ) -> Residual {
        let errors = errors.as_ref();
        // Model errors that the other encoder does not reveal, and errors that are never learned, persist in the reading.
        let alone = !self.encoders[1 - i].is_believed();
        let measurement = if alone { &measurement.alone(i, &self.encoders[i]) } else { measurement };
        let learned = errors.filter(|_| learns).map(|errors| measurement.learned(i, errors.further[i]));
        let used = learned.as_ref().unwrap_or(measurement);
        // Prediction.
        let mut prediction = self.filter.belief.bank.prediction(&used.innovation);
        let columns = self.filter.expect(&mut prediction, (i, &used.innovation), errors);
        let nis = prediction.nis();
        self.watch(machine, (motion, frame), (i, measurement), nis, errors);
        self.begin_unaided(machine.torque_scale(), i, frame, models, errors);
        // Gate.
        let witnessed = self.encoders[1 - i].is_settled();
        let conditions = GateConditions { patient: self.hypotheses.is_branch_known(), witnessed };
        let mut repetition = Fault::None;
        let judge = || {
            repetition = self.unaided[i].judge(measurement);
            repetition
        };
        let admitted = self.encoders[i].admit(&self.filter.belief.bank, (&prediction, used), conditions, judge);
        let Some(mut confined) = admitted else {
            if repetition != Fault::None {
                self.reset(machine, &Reset::Repetition(i, repetition));
            }
            return Residual::Rejected { nis };
        };
        // Gain and covariance.
        let persistent = Persistent {
            unlearned: used.persistent,
            shown: measurement.persistent,
            samples: self.encoders[i].samples_of_persistent_error(),
        };
        self.filter.update(&mut confined, columns.as_ref(), &persistent, used.rests());
        self.unaided[1 - i].update(&self.encoders[i], measurement);
        if let Some(seen) = self.seen(i, measurement) {
            self.doubt.receive(i, &seen.innovation);
        }
        let likelihood = if self.hypotheses.are_open() { prediction.log_likelihood() } else { 0.0 };
        Residual::Accepted(Accepted { measurement: *measurement, nis, likelihood })
    }

    /// Sample of encoder i for the comparison of both assemblies (`doubt.rs`). Samples that are confined to a quantisation interval do not
    /// distinguish the assemblies.
    fn seen(&self, i: usize, measurement: &Measurement) -> Option<Measurement> {
        // The persistent error is left out: it hardly changes, so it does not affect the accelerations.
        self.doubt.is_open().then(|| self.encoders[i].unconfined(&measurement.with_persistent_error(i, 0.0)))?
    }

    /// Updates the causes by a sample of encoder i with the normalised innovation squared `nis`, before the update of the bank.
    fn watch(
        &mut self,
        machine: &Machine,
        (motion, frame): (&LinkState, &Frame),
        (i, measurement): (usize, &Measurement),
        nis: f64,
        errors: Option<&ReadingErrors>,
    ) {
        let before = || {
            let belief = Belief { bank: self.filter.without_parameters(errors), ..self.filter.belief };
            belief.with_force(&(self.alarm.reference_force(frame) - belief.tangent_force(frame)))
        };
        self.causes.begin_where_surprised(machine, (nis, self.alarm.is_on()), || (frame.basis.tr_mul(&motion.omega), before()));
        if self.causes.are_judged()
            && let Some(seen) = self.encoders[i].unconfined(measurement)
        {
            self.causes.receive(i, &seen.innovation);
        }
    }

    /// Starts the estimate without encoder i if the reading repeats, and ends it if the reading changes.
    fn begin_unaided(
        &mut self,
        torque_scale: f64,
        i: usize,
        frame: &Frame,
        models: &[f64; MODELS],
        errors: Option<&ReadingErrors>,
    ) {
        let encoders = [&self.encoders[i], &self.encoders[1 - i]];
        let start = || {
            let mut hold = Error::zeros();
            let on_axis = frame.basis.row(MEASURED[i]).transpose();
            hold.fixed_rows_mut::<2>(FORCE).copy_from(&(on_axis * (LARGEST_HOLD * torque_scale)));
            unaided::Start {
                bank: self.filter.without_parameters(errors),
                force: self.filter.belief.tangent_force(frame).norm(),
                hold,
            }
        };
        self.unaided[i].receive(encoders, start, models);
    }

    /// Whether the encoders are exchanged: their first samples are far from the estimate, but fit it if they are exchanged. Later samples
    /// do not count, because a lost estimate may fit exchanged samples by chance.
    fn are_exchanged(&self, (motion, frame): (&LinkState, &Frame), measurements: &[Option<Measurement>; 2]) -> bool {
        let [Some(left), Some(right)] = measurements else { return false };
        if self.encoders.iter().any(|encoder| encoder.interval() > 0.0)
            || [left, right].iter().any(|sample| sample.innovation.residual.abs() <= DIVERGED_INNOVATION)
        {
            return false;
        }
        let nis =
            |both: [Innovation; 2]| both.iter().map(|innovation| self.filter.belief.bank.prediction(innovation).nis()).sum::<f64>();
        let exchanged = [left.about(1, motion, frame), right.about(0, motion, frame)].map(|sample| sample.innovation);
        nis([left.innovation, right.innovation]) > GATE && nis(exchanged) <= GATE
    }

    /// Restarts an estimate that is adrift once both encoders have settled, or one that the samples of both encoders have contradicted for
    /// long; a single encoder may be faulty. Next to a vertex, where samples do not correct the estimate, one encoder is enough. Returns
    /// the new motion.
    fn restart(&mut self, machine: &Machine, motion: &LinkState, measurements: &[Option<Measurement>; 2]) -> Option<LinkState> {
        self.restarted = false;
        let [Some(left), Some(right)] = measurements else { return None };
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
        let anew = started_by_motors(machine, motion, axes)?;
        let Parameters { sigma, quantum, .. } = machine.parameters;
        let mut variances = machine.start_variances();
        for i in 0..2 {
            let noise = sigma[i] * sigma[i] + quantum[i] * quantum[i] / 12.0;
            variances[0] = variances[0].max(noise);
            variances[1] = variances[1].max(2.0 * noise / (intervals[i] * intervals[i]));
        }
        self.reset(machine, &Reset::Samples { variances, innovations: [left, right].map(|sample| sample.innovation.residual) });
        Some(anew)
    }

    /// Restarts the estimate; the caller replaces the motion. Each `match` lists for its fields which kinds of reset change them.
    fn reset(&mut self, machine: &Machine, kind: &Reset) {
        use Reset::{Adrift, Assembly, Branch, Repetition, Runaway, Samples, Unclosed};
        let Self {
            filter,
            held,
            coasts: _,
            hypotheses,
            doubt,
            unaided,
            encoders,
            history,
            forecast,
            alarm,
            causes,
            adrift,
            restarted,
            nis: _,
        } = self;
        match kind {
            Branch => filter.pause(),
            Repetition(_, fault) if *fault != Fault::Stuck => filter.pause(),
            // The estimate or the accepted samples were wrong, so the learned values are not trusted.
            Repetition(..) | Assembly(_) | Samples { .. } | Unclosed | Runaway | Adrift => filter.restart_parameters(machine),
        }
        let belief = &mut filter.belief;
        match kind {
            // The hypothesis brings its own belief.
            Branch => (),
            Assembly(other) => *belief = **other,
            Samples { variances, .. } => *belief = Belief::new(*variances),
            Unclosed => belief.bank = Bank::new(machine.start_variances()),
            Runaway | Adrift => *belief = Belief::new(machine.variances_anywhere()),
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
            // The wrong assembly explains the surprise.
            Assembly(_) => **causes = Causes::default(),
            Repetition(..) => (),
        }
        match kind {
            Samples { .. } => (**hypotheses, **doubt) = (Hypotheses::of_unknown_side(), Doubt::Ended),
            Unclosed | Runaway | Adrift => {
                if doubt.is_open() {
                    hypotheses.doubt_side(0.0);
                }
                **doubt = Doubt::Ended;
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
                *adrift = true;
            }
            Branch | Assembly(_) | Unclosed | Runaway | Repetition(..) => (),
        }
        match kind {
            // The new covariance contains any motion, and sigma points do not close the loop of restarted lengths.
            Runaway | Adrift => *forecast = Forecast::default(),
            Branch | Assembly(_) | Samples { .. } | Unclosed | Repetition(..) => (),
        }
    }

    /// Restarts the learning of parameters that the master has changed; `tuned` is the prior with the new values.
    pub fn begin_anew_where_tuned(&mut self, machine: &Machine, tuned: Option<&Prior>) {
        if let (Some(before), Some(tuned)) = (&machine.prior, tuned) {
            self.filter.restart_where_changed([before, tuned]);
        }
    }

    /// Values of the learned parameters; `None` if nothing is learned.
    pub fn learned(&self) -> Option<Learned> {
        self.filter.learned()
    }

    /// Standard deviations of the learned parameters; 0 for parameters that are not learned.
    pub fn learned_sigma(&self) -> Learned {
        self.filter.learned_sigma()
    }

    /// Learned parameters that have been moved to a bound since the last call, and their bounds.
    pub fn take_bounds(&mut self, machine: &Machine) -> impl Iterator<Item = (usize, [f64; 2])> {
        self.filter.take_bounds(machine)
    }

    /// Normalised error squared, against true values, of the parameters among `which` that are being learned, and their number.
    pub fn learned_nees(&self, truth: &Learned, which: std::ops::Range<usize>) -> Option<(f64, usize)> {
        self.filter.learned_nees(truth, which)
    }

    /// Replaces the estimate by a hypothesis.
    fn take_over(&mut self, other: usize, machine: &Machine, estimate: &mut Estimated) {
        self.reset(machine, &Reset::Branch);
        self.hypotheses.take_over(other, machine, (&mut estimate.motion, &mut self.filter.belief));
        estimate.frame = machine.linkage.frame(&estimate.motion.theta);
    }

    /// Drops the estimate if it comes from one encoder alone and has become too uncertain: the machine may be anywhere until both encoders
    /// have settled.
    fn drop_single_encoder_track(&mut self, machine: &Machine, frame: &Frame) {
        let is_used = |encoder: &Encoder| encoder.is_believed() && encoder.is_settled();
        let is_gone = |encoder: &Encoder| encoder.has_received() && !encoder.is_believed() && !encoder.is_settled();
        let [left, right] = &self.encoders;
        let alone = is_used(left) && is_gone(right) || is_used(right) && is_gone(left);
        if alone && !self.adrift && bands::sigmas(frame, &self.filter.belief)[0].max() > LARGEST_SIGMA_ALONE {
            self.reset(machine, &Reset::Adrift);
        }
    }

    /// Ends the state in which the machine may be anywhere, once both encoders have settled but the estimate could not restart, because
    /// their samples never come together or the loop does not close. The samples then correct an estimate with the variances of an unknown
    /// position.
    fn look_for_both(&mut self, measurements: &[Option<Measurement>; 2]) {
        if !self.adrift {
            return;
        }
        self.adrift = !self.encoders.iter().all(Encoder::is_settled);
        for (i, measurement) in measurements.iter().enumerate() {
            if let Some(measurement) = measurement {
                self.encoders[i].stays_away(measurement, false);
            }
            // The innovations of such an estimate are large, so the encoders have to settle again.
            if !self.adrift || !self.encoders[i].is_believed() {
                self.encoders[i].settle_anew();
            }
        }
    }

    /// Time update by a macro step of h seconds from one motion to the next; the scene does not include the unknown force.
    pub fn predict(&mut self, machine: &Machine, scene: &impl Scene, [from, to]: [&LinkState; 2], h: f64) {
        let Machine { linkage, parameters, .. } = machine;
        let frame = linkage.frame(&from.theta);
        let coasts = self.is_coasting();
        let models = self.models(machine, from);
        if coasts && !self.coasts {
            self.filter.belief.bank.reset_priors(&models);
        }
        self.coasts = coasts;
        let (mass, ahead) = (scene.mass(&from.theta), linkage.frame(&to.theta));
        let learned: Option<Flow<LEARNED>> =
            self.filter.learns().then(|| flow(linkage, scene, from, &frame, &self.filter.belief.force, h, 1));
        let step = match &learned {
            Some(flow) => Propagation::along(flow, mass, &frame, (to, &ahead), h),
            None => {
                let flow: Flow<0> = flow(linkage, scene, from, &frame, &self.filter.belief.force, h, 1);
                Propagation::along(&flow, mass, &frame, (to, &ahead), h)
            }
        };
        let inertia = step.inertia_torque(&((to.omega - from.omega) / h));
        let scale = machine.torque_scale();
        if coasts && !self.adrift && parameters.forecast == Bands::SigmaPoints {
            self.forecast.step(machine, (from, &self.filter.belief), scene, (h, [scale, inertia]));
        }
        self.hypotheses.open_after_vertex(machine, (from, &self.filter.belief), scene, &step, to);
        self.history.step((from, &frame), &step.f, h, parameters.max_delay);
        // Mass errors are observable through quantisation intervals, which confine the angles; white noise hides them.
        let observable = if self.has_intervals(parameters) { inertia } else { 0.0 };
        // Without samples the models are not mixed, because a quantile of their mixture tells more than a covariance. The unknown force
        // changes as the machine moves, and mass errors act that no sample has revealed yet.
        let force = self.filter.belief.tangent_force(&frame);
        let unrevealed = if self.filter.learns() { 0.0 } else { inertia };
        let (further, lasting) = if coasts {
            ((force.norm_squared() * CARRIED_WALK + unrevealed * unrevealed * FORECAST_MASS_WALK).sqrt(), f64::INFINITY)
        } else {
            let longer = match self.filter.learns() {
                true => LEARNING_PERSISTENCES[usize::from(scene.has_abrupt_forces())],
                false => 1.0,
            };
            (0.0, parameters.switch_time * longer)
        };
        let (noise, scales, timing) = (step.noise(h), [scale, observable, further], (h, lasting));
        // Nothing is learned while the branch after a singularity or the assembly is unknown.
        let known = !step.held && !self.hypotheses.are_open() && !self.hypotheses.are_quiet() && !self.doubt.is_open();
        // While adrift, the covariance already covers any position.
        if !self.adrift {
            self.filter.predict((&frame, &step), learned.as_ref().filter(|_| known), &noise, (scales, timing), &models);
        }
        let (mass, force) = (&step.mass, self.filter.belief.force);
        let by_commands =
            unknown_commands::Step { scene, motion: from, frame: &frame, mass, force: &force, transition: &step.f, h };
        self.step_commands(machine, &by_commands);
        for (i, unaided) in self.unaided.iter_mut().enumerate() {
            unaided.predict((&step, &noise), [scale, observable], timing, &self.encoders[1 - i]);
        }
        let wrong = self.alarm.is_on() || self.encoders.iter().any(Encoder::fails);
        let by = || ByFaults::new(scene, [from, to], &self.filter.belief.force, h);
        let accelerations = || frame.basis.tr_mul(&(to.omega - from.omega)) / h;
        self.causes.predict(&step, (&noise, [scale, observable]), (wrong, h), accelerations, by);
        if wrong && let Some(i) = self.encoders.iter().position(|encoder| encoder.fault == Fault::Stuck) {
            self.causes.know(Cause::Encoder(i));
        }
        self.held = step.held;
        let about = (&step, [from, to], &self.filter.belief.force);
        if let Some(odds) = self.doubt.step(machine, scene, about, (observable > 0.0, h)) {
            self.hypotheses.doubt_side(odds);
        }
        // Other ways from a vertex begin with the errors by commands, too.
        let with_commands = self.forecast.by_commands().map(|_| self.with_commands());
        let belief = with_commands.as_ref().unwrap_or(&self.filter.belief);
        self.hypotheses.step(machine, (to, belief), scene, (&step, coasts), h);
        self.encoders.iter_mut().for_each(|encoder| encoder.step(h));
        self.alarm.step(h, inertia);
    }

    /// Time update of the errors by commands: while no samples arrive, commands are unknown, too.
    fn step_commands<S: Scene>(&mut self, machine: &Machine, step: &unknown_commands::Step<'_, S>) {
        let unknown = unknown_commands::may_change(&machine.parameters) && self.encoders.iter().all(Encoder::is_silent);
        if self.adrift || !unknown && self.forecast.by_commands().is_none() {
            return;
        }
        // Before the first sample, commands have been known until now.
        let since = self.encoders.iter().map(Encoder::time_since_sample).fold(f64::INFINITY, f64::min);
        let since = if since < f64::INFINITY { since } else { 0.0 };
        self.forecast.step_commands(&machine.parameters, step, (unknown, since));
    }

    /// Whether the quantisation interval of an encoder contains more information than white noise.
    fn has_intervals(&self, parameters: &Parameters) -> bool {
        (0..2).any(|i| !self.encoders[i].is_dithered(parameters.sigma[i], parameters.quantum[i]))
    }

    /// Prior probabilities of the models while samples arrive.
    fn models(&self, machine: &Machine, motion: &LinkState) -> [f64; MODELS] {
        match self.has_intervals(&machine.parameters) {
            true if motion.side()[0].abs() < NEAR_SINGULARITY => LIKELY_MODELS,
            true => BY_INTERVALS,
            false => BY_NOISE,
        }
    }

    /// Whether no samples are used: no encoder is trusted, or the estimate from one encoder alone has lost the machine.
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

    /// Whether samples of both encoders have been trusted for long enough that the estimate has settled on them.
    pub fn is_settled(&self) -> bool {
        self.encoders.iter().all(|encoder| encoder.is_settled() && encoder.fault == Fault::None)
    }

    /// Whether the last samples have reinitialised the estimate with their angles.
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

    /// Whether the estimator needs the derivatives with respect to masses and friction.
    pub fn asks_for_parameters(&self) -> bool {
        self.filter.learns() || self.causes.are_judged() || self.doubt.is_open()
    }

    /// Most probable cause of the last alarm or fault, and its probability, which is 1 if the samples of an encoder alone prove the cause.
    pub fn cause(&self, machine: &Machine) -> (Cause, f64) {
        let first = |is: &dyn Fn(&Encoder) -> bool| self.encoders.iter().position(is);
        if first(&|encoder| matches!(encoder.fault, Fault::Late | Fault::Future)).is_some() {
            return (Cause::Timing, 1.0);
        }
        // An encoder that has never delivered a sample is not connected.
        let is_missing =
            |encoder: &Encoder| encoder.is_silent() && encoder.has_received() && !self.encoders.iter().all(Encoder::is_silent);
        match first(&|encoder| matches!(encoder.fault, Fault::Stuck | Fault::Invalid) || is_missing(encoder)) {
            Some(i) => (Cause::Encoder(i), 1.0),
            None => self.causes.most_probable(machine, first(&Encoder::is_away)),
        }
    }

    /// Probability of a direct singularity within the horizon under the inputs of `scene`, a function of the time from now, s; the inputs
    /// include the unknown force. The probability is the fraction of 13 motions, 12 sigma points and their mean, that meet a singularity.
    pub fn singularity_probability<S: Scene>(
        &self,
        machine: &Machine,
        motion: &LinkState,
        scene: impl Fn(f64) -> S,
        step: f64,
    ) -> f64 {
        self.forecast.singularity_probability(machine, (motion, &self.filter.belief), scene, step)
    }

    /// Refuses a stored estimator that is not possible for this mechanism and motion.
    pub fn check(&self, machine: &Machine, motion: &LinkState) -> Result<(), &'static str> {
        let linkage = &machine.linkage;
        if !self.filter.is_sound(machine, motion)
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
        Ok(())
    }
}

/// Reason for a restart of the estimate.
enum Reset<'a> {
    /// A hypothesis after a vertex or a singularity replaces the estimate.
    Branch,
    /// The motion in the other assembly replaces the estimate, with this belief.
    Assembly(&'a Belief),
    /// Samples of both encoders show that the machine is elsewhere. Variances of angles, rad², rates, rad²/s², and force, (N·m)²;
    /// innovations, rad.
    Samples { variances: [f64; 3], innovations: [f64; 2] },
    /// No closed configuration is near the corrected one: the covariance is worthless.
    Unclosed,
    /// The estimate is faster than any machine.
    Runaway,
    /// The estimate from one encoder alone has lost the machine, which may be anywhere.
    Adrift,
    /// The reading of an encoder repeats, with this fault: the estimate without this encoder replaces the estimate by both.
    Repetition(usize, Fault),
}

/// Outcome of the measurement update by a sample.
enum Residual {
    /// There is no sample.
    None,
    /// The gate has rejected the sample.
    Rejected { nis: f64 },
    /// The sample has corrected the bank.
    Accepted(Accepted),
}

/// Sample that has corrected the bank.
struct Accepted {
    measurement: Measurement,
    /// Normalised innovation squared.
    nis: f64,
    /// Log-likelihood while hypotheses are open, otherwise 0.
    likelihood: f64,
}

impl Residual {
    fn accepted(&self) -> Option<&Accepted> {
        match self {
            Self::Accepted(accepted) => Some(accepted),
            Self::None | Self::Rejected { .. } => None,
        }
    }

    /// Normalised innovation squared.
    fn nis(&self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Rejected { nis } | Self::Accepted(Accepted { nis, .. }) => *nis,
        }
    }
}
