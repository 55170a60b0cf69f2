//! Alarm for an unmodelled force, and the consistency test of innovations.

use borsh::{BorshDeserialize, BorshSerialize};

use super::linkage::Frame;
use super::track::Track;

/// Sudden alarm: change of the unknown force, in torque scales, and probability of the loud models above which it counts.
const SUDDEN_CHANGE: (f64, f64) = (0.25, 0.999);
/// Sudden alarm of lower probability: probability of the loud models, and normalised change in standard deviations.
const PROBABLE_CHANGE: (f64, f64) = (0.9, 2.5);
/// Lasting alarm: change of the unknown force, in torque scales, and in standard deviations.
const LASTING_CHANGE: (f64, f64) = (0.5, 6.0);
/// Time constant by which the reference force follows, s: slower drift is no alarm.
const REFERENCE_TIME_CONSTANT: f64 = 0.3;
/// Duration of an alarm, s.
const ALARM_DURATION: f64 = 0.1;
/// Largest normalised innovation squared of a sample in the average: caps the influence of an outlier.
const LARGEST_NIS: f64 = 30.0;
/// Consistency test: averaging length in samples, and largest mean normalised innovation squared, of 1 expected.
const CONSISTENCY: (f64, f64) = (100.0, 4.0);

/// State of the alarm.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Alarm {
    /// Reference value of the unknown force as inputs, N·m and N.
    reference_force: [f64; 4],
    /// Time since the alarm was last raised, s.
    time_since_alarm: f64,
    /// Time since the last sample, s.
    time_since_sample: f64,
    /// Mean normalised innovation squared per sample.
    nis: f64,
}

impl Default for Alarm {
    fn default() -> Self {
        Self { reference_force: [0.0; 4], time_since_alarm: f64::MAX, time_since_sample: 0.0, nis: 1.0 }
    }
}

impl Alarm {
    /// Time update by a macro step of h seconds.
    pub(super) fn step(&mut self, h: f64) {
        self.time_since_alarm = (self.time_since_alarm + h).min(f64::MAX);
        self.time_since_sample += h;
    }

    /// Measurement update: `nis` is the normalised innovation squared summed over `samples` samples.
    pub(super) fn receive(&mut self, track: &Track, at: &Frame, scale: f64, (nis, samples): (f64, usize)) {
        let samples = samples as f64;
        self.nis += samples / CONSISTENCY.0 * ((nis / samples).min(LARGEST_NIS) - self.nis);
        let change = std::array::from_fn(|i| track.force[i] - self.reference_force[i]);
        let [x, y] = Track { force: change, ..*track }.tangent_force(at);
        let [xx, xy, yy] = track.bank.force_covariance();
        let (size, determinant) = ((x * x + y * y).sqrt(), xx * yy - xy * xy);
        // Comparison of (size/σ)² without a division.
        let squared = x * x * yy - 2.0 * x * y * xy + y * y * xx;
        let loud = track.bank.members[2].weight + track.bank.members[3].weight;
        let beyond = |sigmas: f64| squared > sigmas * sigmas * determinant;
        let changes =
            size > SUDDEN_CHANGE.0 * scale && (loud > SUDDEN_CHANGE.1 || loud > PROBABLE_CHANGE.0 && beyond(PROBABLE_CHANGE.1));
        let raised = changes || size > LASTING_CHANGE.0 * scale && beyond(LASTING_CHANGE.1);
        if raised {
            self.time_since_alarm = 0.0;
        }
        let share = 1.0 - libm::exp(-self.time_since_sample / REFERENCE_TIME_CONSTANT);
        for (reference_force, change) in self.reference_force.iter_mut().zip(change) {
            *reference_force += share * change;
        }
        self.time_since_sample = 0.0;
    }

    /// Whether the alarm is raised.
    pub fn is_on(&self) -> bool {
        self.time_since_alarm < ALARM_DURATION
    }

    /// Whether innovations exceed their covariance.
    pub fn is_inconsistent(&self) -> bool {
        self.nis > CONSISTENCY.1
    }

    pub(super) fn numbers(&self) -> [f64; 7] {
        let [a, b, c, d] = self.reference_force;
        [a, b, c, d, self.time_since_alarm, self.time_since_sample, self.nis]
    }
}
