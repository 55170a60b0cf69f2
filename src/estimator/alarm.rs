//! When to raise an alarm: something acts that the model does not know, or the samples do not fit their bands.

use borsh::{BorshDeserialize, BorshSerialize};

use super::linkage::Frame;
use super::track::Track;

/// The change of the unknown force that is an alarm, in torque scales, where the models of much noise are more probable than this: it is
/// changing now;
const SUDDEN_CHANGE: (f64, f64) = (0.25, 0.999);
/// where they are less probable, but more than this, beyond so many standard deviations.
const PROBABLE_CHANGE: (f64, f64) = (0.9, 2.5);
/// The change that is an alarm, in torque scales, beyond this many standard deviations: it has changed.
const LASTING_CHANGE: (f64, f64) = (0.5, 6.0);
/// How slowly what it changes from follows, s.
const REFERENCE_TIME_CONSTANT: f64 = 0.3;
/// How long an alarm lasts, s.
const ALARM_DURATION: f64 = 0.1;
/// A sample counts no more than this there: one that is wild is not forgotten otherwise.
const LARGEST_NIS: f64 = 30.0;
/// Over how many samples NIS is averaged, and what that may be at most, of 1 expected per sample.
const CONSISTENCY: (f64, f64) = (100.0, 4.0);

/// What alarms remember.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Alarm {
    /// The unknown force that is usual, as inputs.
    reference_force: [f64; 4],
    /// Since it was last raised, s.
    time_since_alarm: f64,
    /// Since the last sample, s.
    time_since_sample: f64,
    /// NIS per sample, averaged.
    nis: f64,
}

impl Default for Alarm {
    fn default() -> Self {
        Self { reference_force: [0.0; 4], time_since_alarm: f64::MAX, time_since_sample: 0.0, nis: 1.0 }
    }
}

impl Alarm {
    /// A macro step.
    pub(super) fn step(&mut self, h: f64) {
        self.time_since_alarm = (self.time_since_alarm + h).min(f64::MAX);
        self.time_since_sample += h;
    }

    /// A correction by some samples.
    pub(super) fn receive(&mut self, track: &Track, at: &Frame, scale: f64, (nis, samples): (f64, usize)) {
        let samples = samples as f64;
        self.nis += samples / CONSISTENCY.0 * ((nis / samples).min(LARGEST_NIS) - self.nis);
        let change = std::array::from_fn(|i| track.force[i] - self.reference_force[i]);
        let [x, y] = Track { force: change, ..*track }.tangent_force(at);
        let [xx, xy, yy] = track.bank.force_covariance();
        let (size, determinant) = ((x * x + y * y).sqrt(), xx * yy - xy * xy);
        // (size/σ)² without a division.
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

    /// Whether it is raised.
    pub fn is_on(&self) -> bool {
        self.time_since_alarm < ALARM_DURATION
    }

    /// Whether the samples do not fit their bands.
    pub fn is_inconsistent(&self) -> bool {
        self.nis > CONSISTENCY.1
    }

    pub(super) fn numbers(&self) -> [f64; 7] {
        let [a, b, c, d] = self.reference_force;
        [a, b, c, d, self.time_since_alarm, self.time_since_sample, self.nis]
    }
}
