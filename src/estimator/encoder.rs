//! What is known of an encoder beside its angle: when it spoke last, and whether it can be believed.

use borsh::io::{self, Read, Write};
use borsh::{BorshDeserialize, BorshSerialize};

use super::innovation::PredictedSample;
use super::track::wrapped;

/// The time of a sample that has not been taken, s.
pub const NEVER: f64 = -1e30;
/// An angle of this size, rad, is none: its whole turns are round-off.
const LARGEST_ANGLE: f64 = 1e9;
/// Round-off of the times of a master, relative to them, or to 1 s.
const TIME_ROUND_OFF: f64 = 1e-9;
/// Squared standard deviations by which a sample is off that is left out once,
const GATE: f64 = 30.0;
/// by which no force that is thought of explains it,
const GATE_OF_LOUDEST_MODEL: f64 = 400.0;
/// and how many of these are left out in a row before the encoder is believed again.
const MOST_REJECTED_IN_A_ROW: u32 = 10;
/// A quantiser's error repeats for as long as the axis stays within one step of it, but not for longer than this, s.
const CORRELATION_TIME: f64 = 0.3;
/// White noise of this many steps of the quantiser makes its error white.
const DITHER: f64 = 0.4;
/// A reading that changes by no more steps than this has passed one edge between them,
const SINGLE_EDGE: f64 = 1.5;
/// which is known to this part of a step.
const EDGE_SIGMA: f64 = 0.5;
/// An encoder is silent where this many of its intervals have passed since its last sample,
const SILENT_AFTER_INTERVALS: f64 = 1.5;
/// which before there are two samples are taken to be of this length, s.
const UNKNOWN_INTERVAL: f64 = 0.1;
/// Least variance of the white noise that stands for an interval, in Δ²/12, of an axis that goes through a step from sample to sample; of a
/// slower one as many times more as its error repeats.
const LEAST_VARIANCE: f64 = 0.003;
/// The least standard deviation of a sample, rad.
const LEAST_SIGMA: f64 = 1e-9;

/// What a master has connected: an angle and when it was measured.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Measured {
    /// Angles of the proximal links, rad.
    #[borsh(serialize_with = "as_bits", deserialize_with = "from_bits")]
    pub theta: [f64; 2],
    /// When they were measured, s on the master's clock; [`NEVER`] where nothing has been.
    #[borsh(serialize_with = "as_bits", deserialize_with = "from_bits")]
    pub time: [f64; 2],
}

/// Numbers as their bits: an encoder may tell what is none, which Borsh does not take.
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
    /// Whether both are the same to the bit.
    pub fn same(&self, other: &Self) -> bool {
        let bits = |of: &Self| [of.theta, of.time].map(|pair| pair.map(f64::to_bits));
        bits(self) == bits(other)
    }
}

/// What is wrong with an encoder; the gravest last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, BorshSerialize, BorshDeserialize)]
pub enum Fault {
    /// Nothing.
    #[default]
    None,
    /// The last sample was left out: too far off what was expected.
    Rejected,
    /// It was older than can be accounted for.
    Late,
    /// Its time has not come yet.
    Future,
    /// It was not a number, or too large for an angle.
    Invalid,
    /// It repeats itself while the machine moves.
    Stuck,
}

/// A sample that can be used.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) angle: f64,
    /// s.
    pub(super) age: f64,
}

/// What a sample tells of the angle of an axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    /// rad.
    pub(super) angle: f64,
    /// Its variance, rad².
    pub(super) noise: f64,
    /// s.
    pub(super) age: f64,
    /// So far from the angle, rad, nothing is told.
    pub(super) dead_zone: f64,
}

/// An encoder.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Encoder {
    /// Time of the last sample, as it was set.
    time: f64,
    /// Angle and time of the last one that could be used.
    angle: f64,
    valid_time: f64,
    /// Whether its angle was that of the one before.
    repeated: bool,
    /// From the one before, rad.
    change: f64,
    /// Samples left out in a row.
    rejected_in_a_row: u32,
    /// Between the last two that could be used, s; 0 before there are two.
    interval: f64,
    /// Macro steps since then, s; infinite before the first.
    pub(super) time_since_sample: f64,
    pub(super) fault: Fault,
}

impl Encoder {
    pub(super) const NEW: Self = Self {
        time: NEVER,
        angle: 0.0,
        valid_time: NEVER,
        repeated: false,
        change: 0.0,
        rejected_in_a_row: 0,
        interval: 0.0,
        time_since_sample: f64::INFINITY,
        fault: Fault::None,
    };

    /// The sample of a new time, if it can be used. `max_delay`, s, is the age that can be accounted for.
    pub(super) fn receive(&mut self, angle: f64, time: f64, now: f64, max_delay: f64) -> Option<Sample> {
        if time.to_bits() == self.time.to_bits() {
            return None;
        }
        let has_sample = self.valid_time > NEVER;
        if time.is_finite() {
            self.time = time;
        }
        let (age, rounded) = (now - time, TIME_ROUND_OFF * now.abs().max(1.0));
        self.fault = if angle.is_nan() || angle.abs() >= LARGEST_ANGLE || !time.is_finite() {
            Fault::Invalid
        } else if age < -rounded {
            Fault::Future
        } else if age > max_delay + rounded {
            Fault::Late
        } else {
            Fault::None
        };
        if self.fault != Fault::None {
            return None;
        }
        self.repeated = has_sample && self.angle.to_bits() == angle.to_bits();
        self.change = if has_sample { angle - self.angle } else { 0.0 };
        if has_sample {
            self.interval = (time - self.valid_time).abs();
        }
        (self.angle, self.valid_time) = (angle, time);
        self.time_since_sample = 0.0;
        Some(Sample { angle, age: if age <= rounded { 0.0 } else { age } })
    }

    /// Whether it has been silent for longer than between its last samples.
    pub(super) fn is_silent(&self) -> bool {
        self.time_since_sample > SILENT_AFTER_INTERVALS * if self.interval > 0.0 { self.interval } else { UNKNOWN_INTERVAL }
    }

    /// Whether it can be one.
    #[cold]
    pub(super) fn is_sound(&self) -> bool {
        let numbers = [self.time, self.angle, self.valid_time, self.change, self.interval];
        numbers.iter().all(|x| x.is_finite()) && self.interval >= 0.0 && self.time_since_sample >= 0.0
    }

    /// Between its last two samples, s; 0 before there are two.
    pub(super) fn interval(&self) -> f64 {
        self.interval
    }

    /// How fast its axis has turned between them, rad/s, by less than half a turn.
    pub(super) fn rate(&self) -> f64 {
        if self.interval > 0.0 { wrapped(self.change) / self.interval } else { 0.0 }
    }

    /// Whether it repeats itself.
    pub(super) fn repeats(&self) -> bool {
        self.repeated
    }

    /// Whether it repeats itself on an axis that turns at a rate, rad/s, by more than its step and noise from sample to sample.
    pub(super) fn should_not_repeat(&self, rate: f64, quantum: f64, sigma: f64) -> bool {
        self.repeated && rate.abs() * self.interval > 2.0 * quantum + 4.0 * sigma
    }

    /// Whether a sample is to be used that is off by so many squared standard deviations: of all models, and of the one that allows for
    /// most. `suspicious`: it repeats itself, and the other does not; `patient`: the estimate is to be believed rather than the sample.
    pub(super) fn passes_gate(&mut self, nis: f64, least: f64, (suspicious, patient): (bool, bool)) -> bool {
        self.fault = match self.fault {
            Fault::Stuck if self.repeated => Fault::Stuck,
            // NaN is wild.
            _ if nis <= GATE => Fault::None,
            _ if suspicious => Fault::Stuck,
            _ if self.rejected_in_a_row < 1
                || (patient
                    && (least.is_nan() || least > GATE_OF_LOUDEST_MODEL)
                    && self.rejected_in_a_row < MOST_REJECTED_IN_A_ROW) =>
            {
                Fault::Rejected
            }
            _ => Fault::None,
        };
        self.rejected_in_a_row = if self.fault == Fault::None { 0 } else { self.rejected_in_a_row.saturating_add(1) };
        self.fault == Fault::None
    }

    /// What a reading tells beside where the axis is slow: while it stays the same, that the axis is within the encoder's step; where it
    /// changes, that it has just passed the edge between two steps.
    pub(super) fn confined_to_interval(&self, reading: Reading, (sigma, quantum): (f64, f64), rate: f64) -> Reading {
        let Reading { angle, age, .. } = reading;
        if self.is_dithered(sigma, quantum) || self.change.abs() > SINGLE_EDGE * quantum {
            return reading;
        }
        let passed = rate * self.interval;
        let noise = (EDGE_SIGMA * quantum).powi(2) + passed * passed / 3.0 + sigma * sigma;
        if self.repeated {
            Reading { angle, noise, age, dead_zone: quantum / 2.0 }
        } else {
            Reading { angle: angle - self.change / 2.0, noise, age, dead_zone: 0.0 }
        }
    }

    /// How many samples an error that lasts counts as, at the most.
    fn most_correlated_samples(&self) -> f64 {
        if self.interval > 0.0 { (CORRELATION_TIME / self.interval).max(1.0) } else { 1.0 }
    }

    /// Variance of a sample, rad², without what a quantiser does: that of the white noise, and one of an error that stays, `persistent`, rad².
    fn unquantised_variance(&self, sigma: f64, persistent: f64) -> f64 {
        (sigma * sigma).max(LEAST_SIGMA * LEAST_SIGMA) + persistent * self.most_correlated_samples()
    }

    /// Of how many samples of an axis that turns at a rate, rad/s, a quantiser's error is the same.
    fn correlated_samples(&self, quantum: f64, rate: f64) -> f64 {
        let turns = quantum / (rate.abs() * self.interval).max(LEAST_SIGMA * quantum);
        turns.min(self.most_correlated_samples()).max(1.0)
    }

    /// Whether a quantiser's error is white: the noise that it rounds moves it about, or there has been no sample before.
    pub(super) fn is_dithered(&self, sigma: f64, quantum: f64) -> bool {
        quantum == 0.0 || sigma > DITHER * quantum || self.interval == 0.0
    }

    /// Variance of a sample, rad², of an axis that turns at a rate, rad/s, in itself: white noise, and a quantiser's error, which does not
    /// average out while the axis rests.
    pub(super) fn noise(&self, sigma: f64, quantum: f64, rate: f64, persistent: f64) -> f64 {
        let repeated = if self.is_dithered(sigma, quantum) { 1.0 } else { self.correlated_samples(quantum, rate) };
        self.unquantised_variance(sigma, persistent) + quantum * quantum / 12.0 * repeated
    }

    /// What is expected of a sample, as the models have been told it with this noise, rad², where it is used as what it is: an interval.
    pub(super) fn with_quantisation_interval(
        &self,
        expected: &PredictedSample,
        (sigma, quantum): (f64, f64),
        rate: f64,
        [noise, persistent]: [f64; 2],
    ) -> PredictedSample {
        if self.is_dithered(sigma, quantum) {
            return *expected;
        }
        // An axis that turns by nearly whole steps from sample to sample is always at the same place within them: a reading that changes by as
        // many repeats its error. One that changes by one more or less has just passed an edge, and where that is matters.
        let turned = rate * self.interval;
        let whole = (turned / quantum).round() * quantum;
        let correlated_samples = self.correlated_samples(quantum, (turned - whole) / self.interval);
        let repeats = (wrapped(self.change) - whole).abs() < quantum / 2.0;
        let repeated = if repeats { correlated_samples } else { 1.0 };
        expected.with_interval(
            quantum,
            [noise, self.unquantised_variance(sigma, persistent)],
            [repeated, LEAST_VARIANCE * correlated_samples],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::bank::Bank;
    use crate::estimator::innovation::Innovation;

    /// An axis that turns by whole steps from sample to sample is always at the same place within them: its readings tell as little as those of
    /// an axis at rest. One that passes edges tells where they are.
    #[test]
    fn whole_steps_repeat() {
        let (h, quantum, row) = (1e-3, 0.1_f64.to_radians(), [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let known = (0.5 * quantum).powi(2);
        // Of the white noise that stands for the third reading, with the estimate 0.4 of a step off.
        let variance = |steps: f64| {
            let mut encoder = Encoder::NEW;
            for k in 0..3 {
                let time = h * f64::from(k);
                assert!(encoder.receive((steps * f64::from(k)).round() * quantum, time, time, 0.0).is_some());
            }
            let rate = steps * quantum / h;
            let noise = encoder.noise(0.0, quantum, rate, 0.0);
            let expected = Bank::new([known, 1.0, 1.0]).predict_sample(&Innovation { residual: 0.4 * quantum, row, noise });
            encoder.with_quantisation_interval(&expected, (0.0, quantum), rate, [noise, 0.0]).each[0].1 - known
        };
        let rest = variance(0.0);
        for steps in [1.0, -1.0, 3.0] {
            // Round-off: differences of variances that are alike.
            assert!((variance(steps) / rest - 1.0).abs() < 1e-6, "{steps} steps: {}, at rest {rest}", variance(steps));
        }
        // 0, 1, 3 and 0, 2, 5 steps: the last change is another than the rate's.
        for steps in [1.4, 2.4] {
            assert!(variance(steps) < rest / 100.0, "{steps} steps: {}, at rest {rest}", variance(steps));
        }
    }

    /// Samples that could not be used are no part of intervals and changes, wherever their time is.
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
