//! Encoder model: validity, gating, silence, noise and quantisation of the samples.

use borsh::io::{self, Read, Write};
use borsh::{BorshDeserialize, BorshSerialize};

use super::belief::{Bank, Innovation, Prediction};
use super::error_state::{Error, RATE};
use super::history::{Expected, History};
use super::machine::{Machine, Parameters};
use super::tangent::{Frame, LinkState, MEASURED, wrapped};
use super::trust::{Event, Trust};
use super::tuning::{
    CORRELATION_TIME, DITHER, EDGE_SIGMA, ERROR_ALONE, GATE, GATE_OF_LOUDEST_MODEL, LARGEST_ANGLE, LEAST_SIGMA, LEAST_VARIANCE,
    MOST_REJECTED_IN_A_ROW, NEW_AFTER_SILENCE, PERSISTENT_TIME, SAMPLES_OF_JITTER, SETTLING_TIME, SILENT_AFTER_INTERVALS,
    SINGLE_EDGE, TIME_ALONE, TIME_ROUND_OFF, UNKNOWN_INTERVAL,
};

/// Time of an encoder without samples, s.
pub(super) const NEVER: f64 = -1e30;
/// Samples connected by a master: angles and their times.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Measured {
    /// Angles of the proximal links, rad.
    #[borsh(serialize_with = "as_bits", deserialize_with = "from_bits")]
    pub theta: [f64; 2],
    /// Times of measurement, s on the master's clock; −1e30 before the first sample.
    #[borsh(serialize_with = "as_bits", deserialize_with = "from_bits")]
    pub time: [f64; 2],
}

/// Stores numbers as bits, because samples may be NaN, which Borsh refuses.
fn as_bits<W: Write>(pair: &[f64; 2], writer: &mut W) -> io::Result<()> {
    pair.map(f64::to_bits).serialize(writer)
}

fn from_bits<R: Read>(reader: &mut R) -> io::Result<[f64; 2]> {
    <[u64; 2]>::deserialize_reader(reader).map(|pair| pair.map(f64::from_bits))
}

impl Default for Measured {
    fn default() -> Self {
        Self { theta: [0.0; 2], time: [NEVER; 2] }
    }
}

impl Measured {
    /// Whether both are equal to the bit.
    pub fn same(&self, other: &Self) -> bool {
        let bits = |of: &Self| [of.theta, of.time].map(|pair| pair.map(f64::to_bits));
        bits(self) == bits(other)
    }
}

/// Fault of an encoder, in ascending order of severity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, BorshSerialize, BorshDeserialize)]
pub enum Fault {
    /// No fault.
    #[default]
    None,
    /// The last sample was rejected by the gate.
    Rejected,
    /// The last sample was older than the history.
    Late,
    /// The last sample lies in the future.
    Future,
    /// The last sample is not a number, or too large for an angle.
    Invalid,
    /// The encoder repeats its angle while the machine moves.
    Stuck,
}

/// New, valid sample of an encoder, about a motion.
#[derive(Clone, Copy)]
pub(super) struct Measurement {
    /// Angle, rad.
    pub(super) angle: f64,
    /// Mean rate between the two valid samples before this one, rad/s; `None` if there are none, or if samples between them are missing.
    pub(super) before: Option<f64>,
    /// Age, s.
    pub(super) age: f64,
    /// Rate of the axis in the motion, rad/s.
    pub(super) rate: f64,
    /// Standard deviation of the white noise, rad, due to the encoder and to jitter of the time stamps.
    pub(super) sigma: f64,
    /// Quantisation interval, rad.
    pub(super) quantum: f64,
    /// Standard deviation of the persistent error, rad.
    pub(super) persistent: f64,
    /// Whether the derivative of a late sample is only approximate (`history.rs`).
    pub(super) is_approximate: bool,
    /// Variance of the noise due to model errors that one encoder alone does not reveal, rad².
    pub(super) unrevealed: f64,
    /// Half-width of the interval about the angle that carries no information, rad.
    pub(super) dead_zone: f64,
    /// Innovation y − h(x̂), with the quantisation error as noise.
    pub(super) innovation: Innovation,
}

impl Measurement {
    /// The sample about another motion, as a sample of encoder i. Other motions have no history, so the rate extrapolates a past angle to
    /// the present.
    pub(super) fn about(&self, i: usize, motion: &LinkState, frame: &Frame) -> Self {
        let rate = motion.omega[MEASURED[i]];
        let angle = self.angle + self.age * rate;
        let innovation = Innovation::new(motion, frame, i, angle, [self.innovation.noise, self.persistent]);
        Self { angle, age: 0.0, rate, innovation, ..*self }
    }

    /// The sample at another angle, rad, with the variance `noise`, rad², and a dead zone of this half-width, rad.
    fn at(&self, angle: f64, noise: f64, dead_zone: f64) -> Self {
        let residual = self.innovation.residual + angle - self.angle;
        Self { angle, dead_zone, innovation: Innovation { residual, noise, ..self.innovation }, ..*self }
    }

    /// Variance of the sample, rad², if its quantisation error is independent of other samples.
    pub(super) fn single_variance(&self) -> f64 {
        white_variance(self.sigma) + self.quantum * self.quantum / 12.0
    }

    /// The sample of encoder i if only this encoder is used: model errors count as errors of its readings.
    pub(super) fn alone(&self, i: usize, encoder: &Encoder) -> Self {
        let mut alone = self.with_persistent_error(i, self.persistent.max(ERROR_ALONE));
        alone.unrevealed = ERROR_ALONE * ERROR_ALONE * encoder.samples_within(TIME_ALONE);
        alone.innovation.noise += alone.unrevealed;
        alone
    }

    /// The sample of encoder i while lengths and mounting angles are learned and therefore do not count as errors of the reading. Errors of
    /// disc and scale, with the standard deviation `further`, rad, and model errors remain.
    pub(super) fn learned(&self, i: usize, further: f64) -> Self {
        let of_model = if self.unrevealed > 0.0 { ERROR_ALONE } else { 0.0 };
        self.with_persistent_error(i, further.max(of_model))
    }

    /// The sample of encoder i with a persistent error of another standard deviation, rad.
    pub(super) fn with_persistent_error(&self, i: usize, persistent: f64) -> Self {
        Self { persistent, innovation: self.innovation.with_persistent_error(i, persistent), ..*self }
    }

    /// Innovation of the rate, from the `change` of the innovation, rad, since the last sample `interval` seconds before. A persistent
    /// error is common to both samples and cancels.
    pub(super) fn change(&self, change: f64, interval: f64) -> Innovation {
        let mut row = Error::zeros();
        row.fixed_rows_mut::<2>(RATE).copy_from(&(self.innovation.row.fixed_rows::<2>(0) * interval));
        Innovation { residual: wrapped(change), row, noise: 2.0 * self.single_variance() }
    }

    /// Whether the axis rests. Quantisation and persistent errors of a resting axis are common to all its samples. They are not noise, and
    /// nothing is learned from the samples.
    pub(super) fn rests(&self) -> bool {
        self.rate.abs() * CORRELATION_TIME < self.quantum.max(self.persistent)
    }
}

/// Variance of white noise with this standard deviation, rad²; never 0.
fn white_variance(sigma: f64) -> f64 {
    (sigma * sigma).max(LEAST_SIGMA * LEAST_SIGMA)
}

/// Conditions under which the gate judges a sample.
#[derive(Clone, Copy)]
pub(super) struct GateConditions {
    /// Whether the estimate is trusted more than the sample.
    pub(super) patient: bool,
    /// Whether the estimate has settled on the other encoder.
    pub(super) witnessed: bool,
}

/// State of an encoder.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Encoder {
    /// Time of the last sample as set by the master, s.
    time: f64,
    /// Angle of the last valid sample, rad.
    angle: f64,
    /// Time of the last valid sample, s.
    valid_time: f64,
    /// Whether the last two valid samples have equal angles.
    repeated: bool,
    /// Difference of the last two valid samples, rad.
    change: f64,
    trust: Trust,
    /// Innovation of the last sample that was compared with the estimate: measured minus expected angle, rad.
    innovation: f64,
    /// Simulated time since the encoder was absent, a sample was rejected or the estimate restarted, s.
    believed_for: f64,
    /// Time between the last two valid samples, s; 0 before there are two.
    interval: f64,
    /// Simulated time since the last valid sample, s; infinite before the first.
    time_since_sample: f64,
    /// Simulated time since the last sample, s, valid or not; since the start before the first.
    time_since_arrival: f64,
    /// Simulated time between the last two valid samples, s; 0 before there are two.
    arrival_interval: f64,
    /// Mean variance of the time stamps, s².
    jitter: f64,
    /// Standard deviation of the time of the last valid sample, s.
    timing: f64,
    pub(super) fault: Fault,
}

impl Encoder {
    pub(super) const NEW: Self = Self {
        time: NEVER,
        angle: 0.0,
        valid_time: NEVER,
        repeated: false,
        change: 0.0,
        trust: Trust::Good,
        innovation: 0.0,
        believed_for: 0.0,
        interval: 0.0,
        time_since_sample: f64::INFINITY,
        time_since_arrival: 0.0,
        arrival_interval: 0.0,
        jitter: 0.0,
        timing: 0.0,
        fault: Fault::None,
    };

    /// Measurement of encoder `i` about a motion, if it is new and valid. `persistent` is the standard deviation of the encoder's
    /// persistent error, rad; `offset` is its mounting angle, rad.
    pub(super) fn measurement(
        &mut self,
        i: usize,
        machine: &Machine,
        (motion, frame, history): (&LinkState, &Frame, &History),
        (persistent, offset): (f64, f64),
        (measured, now): (&Measured, f64),
    ) -> Option<Measurement> {
        let Parameters { sigma, quantum, max_delay, .. } = machine.parameters;
        let (angle, rate) = (measured.theta[i], motion.omega[MEASURED[i]]);
        let before = *self;
        let age = self.receive(angle, measured.time[i], now, max_delay)?;
        let angle = angle - offset;
        let before = self.mean_rate_before(&before);
        let (sigma, quantum) = (self.white_sigma(sigma[i], rate), quantum[i]);
        let noise = self.noise(sigma, quantum, rate);
        let Some(Expected { angle: expected, row, is_approximate }) = history.at(motion, frame, i, age) else {
            self.fault = Fault::Late;
            return None;
        };
        let innovation = Innovation { residual: wrapped(angle - expected), row, noise }.with_persistent_error(i, persistent);
        Some(Measurement {
            angle,
            before,
            age,
            rate,
            sigma,
            quantum,
            persistent,
            is_approximate,
            unrevealed: 0.0,
            dead_zone: 0.0,
            innovation,
        })
    }

    /// Mean rate between the two samples before the last one, rad/s, from the encoder's state `before` the last sample; `None` if there are
    /// none, or if samples are missing.
    fn mean_rate_before(&self, before: &Self) -> Option<f64> {
        let is_known = before.interval > 0.0 && before.interval <= SILENT_AFTER_INTERVALS * self.interval;
        is_known.then(|| before.rate())
    }

    /// Age of a sample, s, if its time is new and it is valid. `max_delay` is the largest admissible age, s.
    fn receive(&mut self, angle: f64, time: f64, now: f64, max_delay: f64) -> Option<f64> {
        if time.to_bits() == self.time.to_bits() {
            return None;
        }
        let has_sample = self.valid_time > NEVER;
        if time.is_finite() {
            self.time = time;
        }
        let returns = self.is_absent();
        let (age, rounded) = (now - time, TIME_ROUND_OFF * now.abs().max(1.0));
        // A sample is accepted if the error of its time stamp is less than a sampling period.
        let period = if self.arrival_interval > 0.0 { self.arrival_interval } else { f64::INFINITY };
        let tolerance = std::mem::take(&mut self.time_since_arrival).min(period).max(rounded);
        self.fault = if angle.is_nan() || angle.abs() >= LARGEST_ANGLE || !time.is_finite() {
            Fault::Invalid
        } else if age < -tolerance {
            Fault::Future
        } else if age > max_delay + tolerance {
            Fault::Late
        } else {
            Fault::None
        };
        if self.fault != Fault::None {
            return None;
        }
        self.repeated = has_sample && self.angle.to_bits() == angle.to_bits();
        if !self.repeated {
            self.trust = self.trust.after(Event::Changed);
        }
        if self.is_stuck() {
            self.fault = Fault::Stuck;
        }
        self.change = if has_sample { angle - self.angle } else { 0.0 };
        if has_sample {
            let interval = (time - self.valid_time).abs();
            // Time stamps jitter if their interval differs both from the last one and from the interval of arrivals.
            let off = (interval - self.time_since_sample).abs().min((interval - self.interval).abs());
            let off = if off > rounded && self.interval > 0.0 { off } else { 0.0 };
            self.jitter += (off * off / 2.0 - self.jitter) / SAMPLES_OF_JITTER;
            (self.interval, self.arrival_interval) = (interval, self.time_since_sample);
        }
        (self.angle, self.valid_time) = (angle, time);
        if returns {
            self.believed_for = 0.0;
        }
        if self.time_since_sample > NEW_AFTER_SILENCE {
            self.trust = self.trust.after(Event::Renewed);
        }
        self.time_since_sample = 0.0;
        let used = if age <= rounded { 0.0 } else { age.min(max_delay.max(rounded)) };
        let excess = age - used;
        let excess = if excess.abs() > 2.0 * rounded { excess } else { 0.0 };
        let timing = (self.jitter + excess * excess).sqrt();
        self.timing = if timing > rounded { timing } else { 0.0 };
        Some(if used <= rounded { 0.0 } else { used })
    }

    /// Time update by h seconds.
    pub(super) fn step(&mut self, h: f64) {
        self.time_since_sample += h;
        self.believed_for += h;
        self.time_since_arrival += h;
    }

    /// Whether the encoder has ever delivered a valid sample.
    pub(super) fn has_received(&self) -> bool {
        self.time_since_sample.is_finite()
    }

    /// Standard deviation of the white noise of the last sample, rad: the encoder's noise `sigma`, rad, and the error of the time stamp on
    /// an axis that turns at `rate`, rad/s.
    fn white_sigma(&self, sigma: f64, rate: f64) -> f64 {
        if self.timing == 0.0 { sigma } else { libm::hypot(sigma, self.timing * rate) }
    }

    /// Simulated time since the last valid sample, s; infinite before the first.
    pub(super) fn time_since_sample(&self) -> f64 {
        self.time_since_sample
    }

    /// Whether the encoder is silent: no sample for longer than its sampling interval allows.
    pub(super) fn is_silent(&self) -> bool {
        let interval = self.interval.max(self.arrival_interval);
        self.time_since_sample > SILENT_AFTER_INTERVALS * if interval > 0.0 { interval } else { UNKNOWN_INTERVAL }
    }

    /// Whether samples arrive and are believed, except for single outliers.
    pub(super) fn is_believed(&self) -> bool {
        !(self.is_silent() || self.is_stuck() || self.is_away())
    }

    /// Whether the encoder has been silent for so long that the estimate may have drifted away from it. Single lost samples do not count.
    pub(super) fn is_absent(&self) -> bool {
        self.is_silent() && self.time_since_sample > SETTLING_TIME
    }

    /// Whether stored values are possible.
    pub(super) fn is_sound(&self) -> bool {
        let numbers = [self.time, self.angle, self.valid_time, self.change, self.innovation];
        let durations =
            [self.interval, self.time_since_arrival, self.arrival_interval, self.jitter, self.timing, self.believed_for];
        numbers.iter().chain(&durations).all(|x| x.is_finite())
            && durations.iter().chain([&self.time_since_sample]).all(|x| *x >= 0.0)
            && self.trust.is_sound()
    }

    /// Innovation of the last sample that was compared with the estimate: measured minus expected angle, rad.
    pub(super) fn innovation(&self) -> f64 {
        self.innovation
    }

    /// Restarts with an estimate that the samples have reinitialised; `innovation` is the innovation before the restart, rad.
    pub(super) fn begin_anew(&mut self, innovation: f64) {
        self.innovation = innovation;
        self.settle_anew();
    }

    /// Time between the last two valid samples, s; 0 before there are two.
    pub(super) fn interval(&self) -> f64 {
        self.interval
    }

    /// Mean rate between the last two samples, rad/s, unambiguous below half a turn.
    pub(super) fn rate(&self) -> f64 {
        if self.interval > 0.0 { wrapped(self.change) / self.interval } else { 0.0 }
    }

    /// Whether the last two samples are equal.
    pub(super) fn repeats(&self) -> bool {
        self.repeated
    }

    /// Whether samples have arrived and have been trusted for long enough that the estimate has settled on them.
    pub(super) fn is_settled(&self) -> bool {
        self.believed_for >= SETTLING_TIME && !self.is_absent()
    }

    /// Restarts the time for which samples have been trusted, because the estimate restarts.
    pub(super) fn settle_anew(&mut self) {
        self.believed_for = 0.0;
    }

    /// Whether the encoder fails: it is stuck, or several samples in a row have been rejected. A sample with a wrong time stamp counts as
    /// lost, not as rejected.
    pub(super) fn fails(&self) -> bool {
        self.is_stuck() || self.trust.is_lasting()
    }

    /// Ignores the samples, which have the innovation `residual`, rad, until the reading jumps, even if the estimate has not settled yet.
    pub(super) fn leave_out_lastingly(&mut self, residual: f64) {
        (self.innovation, self.trust) = (residual, self.trust.after(Event::Exchanged(residual)));
    }

    /// Whether the reading has jumped away from the estimate.
    pub(super) fn is_away(&self) -> bool {
        matches!(self.trust, Trust::Away { .. })
    }

    /// Whether the reading repeats while the axis turns.
    fn is_stuck(&self) -> bool {
        matches!(self.trust, Trust::Stuck { .. })
    }

    /// Judges whether a reading that has jumped stays away, by the change of its innovation since the last sample. If the innovation moves
    /// by more than half the jump, the axis was struck, and the reading counts again. After several rejections in a row, the reading counts
    /// only if its second difference is as large, too: an estimate from one encoder may turn quickly and change the innovations.
    /// `witnessed`: the estimate has settled on the other encoder.
    pub(super) fn stays_away(&mut self, sample: &Measurement, witnessed: bool) -> bool {
        let (lasting, change) = (self.trust.is_lasting(), wrapped(self.innovation_change(sample)).abs());
        self.innovation = sample.innovation.residual;
        let second_difference = |before: f64| wrapped(self.change - before * self.interval).abs();
        let moved = if lasting { sample.before.map_or(change, |before| change.min(second_difference(before))) } else { change };
        if let Trust::Away { jump, .. } = self.trust
            && (moved > jump.abs() / 2.0 || !(witnessed || lasting))
        {
            self.trust = self.trust.after(Event::Returned);
        }
        self.is_away()
    }

    /// Prediction for the update of the bank, with the quantisation interval instead of white noise; `None` if the gate rejects the sample.
    /// `repetition` returns the fault of a reading that repeats.
    pub(super) fn admit(
        &mut self,
        bank: &Bank,
        (expected, sample): (&Prediction, &Measurement),
        conditions: GateConditions,
        repetition: impl FnOnce() -> Fault,
    ) -> Option<Prediction> {
        let admitted = self.passes_gate(bank, (expected, sample), conditions, repetition);
        admitted.then(|| self.with_quantisation_interval(expected, sample))
    }

    /// Gate: whether a sample is used. Errors that many samples share count once here: the test whether a force explains the sample uses
    /// the quantisation error of a single sample, and the gate excludes model errors.
    fn passes_gate(
        &mut self,
        bank: &Bank,
        (expected, sample): (&Prediction, &Measurement),
        GateConditions { patient, witnessed }: GateConditions,
        repetition: impl FnOnce() -> Fault,
    ) -> bool {
        let change = self.innovation_change(sample);
        let away = self.stays_away(sample, witnessed);
        let repetition = if away { Fault::None } else { repetition() };
        let Innovation { residual, noise, .. } = sample.innovation;
        let least = expected.nis_of_loudest_model(noise - sample.single_variance());
        let rejected = self.trust.rejected();
        let unexplained = patient && (least.is_nan() || least > GATE_OF_LOUDEST_MODEL);
        self.fault = match self.fault {
            Fault::Stuck => Fault::Stuck,
            _ if repetition != Fault::None => repetition,
            _ if away => Fault::Rejected,
            // NaN exceeds the gate.
            _ if expected.nis_with_less(sample.unrevealed) <= GATE => Fault::None,
            // The first sample is not rejected, because the start may be wrong.
            _ if (rejected < 1 && self.interval > 0.0) || (unexplained && rejected < MOST_REJECTED_IN_A_ROW) => Fault::Rejected,
            _ => Fault::None,
        };
        let event = match self.fault {
            Fault::None => Event::Accepted,
            Fault::Stuck => Event::Froze,
            // A force that has moved the axis so far moves it further, which the next sample reveals.
            _ if patient && witnessed && self.is_settled() && self.jumps(bank, sample, change) => Event::Jumped(residual),
            _ => Event::Rejected,
        };
        self.trust = self.trust.after(event);
        if self.fault != Fault::None {
            self.believed_for = 0.0;
        }
        self.fault == Fault::None
    }

    /// Change of the innovation from the last sample to this one, rad.
    fn innovation_change(&self, sample: &Measurement) -> f64 {
        sample.innovation.residual - self.innovation
    }

    /// Whether no assumed force explains the `change` of the innovation since the last sample, rad.
    fn jumps(&self, bank: &Bank, sample: &Measurement, change: f64) -> bool {
        bank.prediction(&sample.change(change, self.interval)).nis_of_loudest_model(0.0) > GATE
    }

    /// The sample for filters without a model of the quantiser. If the axis turns by less than half a quantisation interval per sample, an
    /// unchanged reading confines the axis to the interval, and a changed reading locates it at the edge between two intervals. If the axis
    /// is faster, the quantisation error is noise; it persists while the axis turns by nearly an integer number of intervals per sample.
    pub(super) fn confined_to_interval(&self, sample: &Measurement) -> Measurement {
        let &Measurement { angle, rate, sigma, quantum, unrevealed, innovation, .. } = sample;
        if self.is_dithered(sigma, quantum) {
            return sample.at(angle, innovation.noise, 0.0);
        }
        let passed = rate * self.interval;
        if passed.abs() > quantum / 2.0 || self.change.abs() > SINGLE_EDGE * quantum {
            return sample.at(angle, self.noise(sigma, quantum, self.beat(quantum, rate)) + unrevealed, 0.0);
        }
        let noise = (EDGE_SIGMA * quantum).powi(2) + passed * passed / 3.0 + sigma * sigma + unrevealed;
        if self.repeated { sample.at(angle, noise, quantum / 2.0) } else { sample.at(angle - self.change / 2.0, noise, 0.0) }
    }

    /// The sample for filters without a model of the quantiser; `None` if it is confined to a quantisation interval.
    pub(super) fn unconfined(&self, sample: &Measurement) -> Option<Measurement> {
        Some(self.confined_to_interval(sample)).filter(|sample| sample.dead_zone == 0.0)
    }

    /// Number of samples that share a persistent error.
    pub(super) fn samples_of_persistent_error(&self) -> f64 {
        self.samples_within(PERSISTENT_TIME)
    }

    /// Number of samples within `time`, s; at least one.
    fn samples_within(&self, time: f64) -> f64 {
        if self.interval > 0.0 { (time / self.interval).max(1.0) } else { 1.0 }
    }

    /// Difference of the rate, rad/s, from the nearest integer number of quantisation intervals per sample. An axis with exactly such a
    /// rate repeats its quantisation error.
    fn beat(&self, quantum: f64, rate: f64) -> f64 {
        let single = quantum / self.interval;
        rate - (rate / single).round() * single
    }

    /// Number of samples that share a quantisation error while the axis turns at `rate`, rad/s.
    fn correlated_samples(&self, quantum: f64, rate: f64) -> f64 {
        let turns = quantum / (rate.abs() * self.interval).max(LEAST_SIGMA * quantum);
        turns.min(self.samples_within(CORRELATION_TIME)).max(1.0)
    }

    /// Whether the quantisation error is white: noise dithers it, or it belongs to the first sample.
    pub(super) fn is_dithered(&self, sigma: f64, quantum: f64) -> bool {
        quantum == 0.0 || sigma > DITHER * quantum || self.interval == 0.0
    }

    /// Variance of a single sample, rad², while the axis turns at `rate`, rad/s: white noise plus the quantisation error, which does not
    /// average out at rest.
    fn noise(&self, sigma: f64, quantum: f64, rate: f64) -> f64 {
        let repeated = if self.is_dithered(sigma, quantum) { 1.0 } else { self.correlated_samples(quantum, rate) };
        white_variance(sigma) + quantum * quantum / 12.0 * repeated
    }

    /// Prediction with the quantisation interval instead of the white noise.
    pub(super) fn with_quantisation_interval(&self, expected: &Prediction, sample: &Measurement) -> Prediction {
        let &Measurement { rate, sigma, quantum, unrevealed, innovation: Innovation { noise, .. }, .. } = sample;
        if self.is_dithered(sigma, quantum) {
            return *expected;
        }
        // The quantisation error repeats as long as the reading changes by the turn of the axis; any other change locates an edge.
        let correlated_samples = self.correlated_samples(quantum, self.beat(quantum, rate));
        let repeats = (wrapped(self.change) - rate * self.interval).abs() < quantum / 2.0;
        let repeated = if repeats { correlated_samples } else { 1.0 };
        expected.with_interval(
            quantum,
            [noise, white_variance(sigma) + unrevealed],
            [repeated, LEAST_VARIANCE * correlated_samples],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An axis that turns by an integer number of intervals per sample is as poorly observed as an axis at rest; an axis that crosses edges
    /// is not.
    #[test]
    fn whole_steps_repeat() {
        let (h, quantum, row) = (1e-3, 0.1_f64.to_radians(), Error::from_fn(|i, _| [1.0, 0.0][i.min(1)]));
        let known = (0.5 * quantum).powi(2);
        // Variance of the white noise that replaces the third reading if the estimate is off by 0.4 intervals, and of the reading for
        // filters without a model of the quantiser.
        let variances = |steps: f64| {
            let mut encoder = Encoder::NEW;
            for k in 0..3 {
                let time = h * f64::from(k);
                assert!(encoder.receive((steps * f64::from(k)).round() * quantum, time, time, 0.0).is_some());
            }
            let rate = steps * quantum / h;
            let noise = encoder.noise(0.0, quantum, rate);
            let innovation = Innovation { residual: 0.4 * quantum, row, noise };
            let sample = Measurement {
                angle: 0.0,
                before: None,
                age: 0.0,
                rate,
                sigma: 0.0,
                quantum,
                persistent: 0.0,
                is_approximate: false,
                unrevealed: 0.0,
                dead_zone: 0.0,
                innovation,
            };
            let expected = Bank::new([known, 1.0, 1.0]).prediction(&innovation);
            let reading = encoder.confined_to_interval(&sample);
            (encoder.with_quantisation_interval(&expected, &sample).each[0].1 - known, reading.innovation.noise)
        };
        let variance = |steps: f64| variances(steps).0;
        let rest = variance(0.0);
        for steps in [1.0, -1.0, 3.0] {
            // Tolerance: round-off of the difference of nearly equal variances.
            assert!((variance(steps) / rest - 1.0).abs() < 1e-6, "{steps} steps: {}, at rest {rest}", variance(steps));
            // An error that lasts for 0.3 s counts once in 300 samples.
            let once = 300.0 * quantum * quantum / 12.0;
            assert!((variances(steps).1 / once - 1.0).abs() < 1e-6, "{steps} steps: {}, not {once}", variances(steps).1);
        }
        // Readings of 0, 1, 3 and 0, 2, 5 intervals: the last change differs from the turn of the axis.
        for steps in [1.4, 2.4] {
            assert!(variance(steps) < rest / 100.0, "{steps} steps: {}, at rest {rest}", variance(steps));
        }
    }

    /// If the axis rests, a jump of the reading is larger than any force explains, although the quantisation error persists. The encoder is
    /// then left out until the reading jumps back, for any motion of the estimate. If the axis is struck, it moves further at once.
    #[test]
    fn jumps_are_judged_by_the_reading() {
        let (h, quantum, row) = (1e-3, 0.1_f64.to_radians(), Error::from_fn(|i, _| [1.0, 0.0][i.min(1)]));
        // Innovation and second difference of each sample after the jump, rad, and whether the reading is left out.
        let is_away_after = |samples: &[(f64, f64)]| {
            let mut encoder = Encoder { believed_for: 2.0 * SETTLING_TIME, interval: h, time_since_sample: 0.0, ..Encoder::NEW };
            let noise = encoder.noise(0.0, quantum, 0.0);
            let (bank, conditions) = (Bank::new([1e-6, 1.0, 1.0]), GateConditions { patient: true, witnessed: true });
            for &(residual, second_difference) in samples {
                let innovation = Innovation { residual, row, noise };
                let sample = Measurement {
                    angle: 0.0,
                    before: Some(-second_difference / h),
                    age: 0.0,
                    rate: 0.0,
                    sigma: 0.0,
                    quantum,
                    persistent: 0.0,
                    is_approximate: false,
                    unrevealed: 0.0,
                    dead_zone: 0.0,
                    innovation,
                };
                encoder.admit(&bank, (&bank.prediction(&innovation), &sample), conditions, || Fault::None);
            }
            encoder.is_away()
        };
        let jump = (0.1, 0.1);
        assert!(is_away_after(&[jump]) && is_away_after(&[jump, (0.1, -0.1), (0.1, 0.0)]), "the reading jumps");
        assert!(!is_away_after(&[jump, (0.2, 0.0)]), "the axis is struck");
        assert!(is_away_after(&[jump, (0.1, -0.1), (0.1, 0.0), (0.3, 0.0), (-0.1, 0.0)]), "the estimate turns");
        assert!(!is_away_after(&[jump, (0.1, -0.1), (0.1, 0.0), (0.0, -0.1)]), "the reading jumps back");
    }

    /// Samples with stamps that err by less than a sampling period are used, with a noise that grows with the rate of the axis. Samples
    /// with larger errors are refused; exact stamps add no noise.
    #[test]
    fn stamps_that_jitter_are_used() {
        let (h, steps) = (1e-3, 2000);
        // Times of arrival minus the stamps, s: uniform errors of ±0.4 ms, with the standard deviation 0.4 ms/√3.
        let received = |error: &dyn Fn(u32) -> f64| {
            let (mut encoder, mut used, mut silent) = (Encoder::NEW, 0, 0);
            for k in 0..steps {
                let now = h * f64::from(k);
                used += u32::from(encoder.receive(f64::from(k), now - error(k), now, 0.0).is_some());
                encoder.step(h);
                silent += u32::from(k > 1 && encoder.is_silent());
            }
            assert!(encoder.is_sound());
            (encoder, used, silent)
        };
        let uniform = |k: u32| 0.8e-3 * ((f64::from(k) * 0.618_033_988_75).fract() - 0.5);
        let (encoder, used, silent) = received(&uniform);
        assert!(used >= steps - 1 && silent == 0, "{used} used, {silent} times silent");
        let (told, expected) = (encoder.white_sigma(0.0, 2.0), 2.0 * 0.4e-3 / 3f64.sqrt());
        // The mean is over 50 samples, and an excess of the last age over the admissible age is added.
        assert!((0.5..2.5).contains(&(told / expected)), "{told} for {expected}");
        assert_eq!(encoder.white_sigma(1e-4, 0.0), 1e-4);
        let (encoder, used, silent) = received(&|_| 0.0);
        assert_eq!((used, silent, encoder.white_sigma(1e-4, 2.0)), (steps, 0, 1e-4));
        // Errors beyond a period, after two exact stamps.
        assert_eq!(received(&|k| if k < 2 { 0.0 } else { 1.5e-3 }).1, 2);
        assert_eq!(received(&|k| if k < 2 { 0.0 } else { -1.5e-3 }).1, 2);
    }

    /// A stuck encoder stays stuck until a reading changes, even if a sample is refused for its stamp.
    #[test]
    fn refused_samples_free_no_encoder() {
        let mut encoder = Encoder::NEW;
        assert!(encoder.receive(2.0, 0.0, 0.0, 0.0).is_some());
        encoder.trust = encoder.trust.after(Event::Froze);
        assert!(encoder.receive(2.0, 5.0, 1.0, 0.0).is_none() && encoder.fault == Fault::Future && encoder.fails());
        assert!(encoder.receive(2.0, 1.1, 1.1, 0.0).is_some() && encoder.fault == Fault::Stuck);
        assert!(encoder.receive(2.1, 1.2, 1.2, 0.0).is_some() && encoder.fault == Fault::None && !encoder.fails());
    }

    /// Invalid samples change neither the sampling interval nor the difference, at any time stamp.
    #[test]
    fn what_is_not_used_is_not_counted() {
        let mut encoder = Encoder::NEW;
        let unused = |encoder: &mut Encoder, angle: f64, time: f64, fault: Fault| {
            assert!(encoder.receive(angle, time, 1.0, 0.0).is_none());
            assert_eq!((encoder.fault, encoder.interval), (fault, if encoder.time_since_sample == 0.0 { 0.25 } else { 0.0 }));
        };
        unused(&mut encoder, 5.0, 1e9, Fault::Future);
        unused(&mut encoder, 5.0, -1.0, Fault::Late);
        assert!(encoder.receive(2.0, 1.0, 1.0, 0.0).is_some());
        assert_eq!((encoder.interval, encoder.change, encoder.repeated), (0.0, 0.0, false));
        assert!(encoder.receive(2.5, 1.25, 1.25, 0.0).is_some());
        unused(&mut encoder, f64::NAN, 1.0, Fault::Invalid);
        unused(&mut encoder, -1e9, 1.01, Fault::Invalid);
        unused(&mut encoder, 7.0, 1e300, Fault::Future);
        assert!(encoder.receive(2.5, 1.5, 1.5, 0.0).is_some());
        assert_eq!((encoder.interval, encoder.change, encoder.repeated), (0.25, 0.0, true));
        assert!(encoder.is_sound() && !Encoder { interval: f64::INFINITY, ..encoder }.is_sound());
    }
}
