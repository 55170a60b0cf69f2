//! When to raise an alarm: something acts that the model does not know, or the samples do not fit their bands.

use borsh::{BorshDeserialize, BorshSerialize};

use super::linkage::Frame;
use super::track::Track;

/// The change of the unknown force that is an alarm, in torque scales, where the models of much noise are more probable than this: it is
/// changing now;
const SUDDEN: (f64, f64) = (0.25, 0.999);
/// where they are less probable, but more than this, beyond so many standard deviations.
const LIKELY: (f64, f64) = (0.9, 2.5);
/// The change that is an alarm, in torque scales, beyond this many standard deviations: it has changed.
const LASTING: (f64, f64) = (0.5, 6.0);
/// How slowly what it changes from follows, s.
const SLOW: f64 = 0.3;
/// How long an alarm lasts, s.
const LASTS: f64 = 0.1;
/// A sample counts no more than this there: one that is wild is not forgotten otherwise.
const WORST: f64 = 30.0;
/// Over how many samples NIS is averaged, and what that may be at most, of 1 expected per sample.
const CONSISTENCY: (f64, f64) = (100.0, 4.0);

/// What alarms remember.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Alarm {
    /// The unknown force that is usual, as inputs.
    usual: [f64; 4],
    /// Since it was last raised, s.
    since: f64,
    /// Since the last sample, s.
    gap: f64,
    /// NIS per sample, averaged.
    nis: f64,
}

impl Default for Alarm {
    fn default() -> Self {
        Self { usual: [0.0; 4], since: f64::MAX, gap: 0.0, nis: 1.0 }
    }
}

impl Alarm {
    /// A macro step.
    pub(super) fn step(&mut self, h: f64) {
        self.since = (self.since + h).min(f64::MAX);
        self.gap += h;
    }

    /// A correction by some samples.
    pub(super) fn receive(&mut self, track: &Track, at: &Frame, scale: f64, (nis, samples): (f64, usize)) {
        let samples = samples as f64;
        self.nis += samples / CONSISTENCY.0 * ((nis / samples).min(WORST) - self.nis);
        let change = std::array::from_fn(|i| track.force[i] - self.usual[i]);
        let [x, y] = Track { force: change, ..*track }.tangent_force(at);
        let [xx, xy, yy] = track.bank.force_covariance();
        let (size, determinant) = ((x * x + y * y).sqrt(), xx * yy - xy * xy);
        // (size/σ)² without a division.
        let squared = x * x * yy - 2.0 * x * y * xy + y * y * xx;
        let loud = track.bank.members[2].weight + track.bank.members[3].weight;
        let beyond = |sigmas: f64| squared > sigmas * sigmas * determinant;
        let changes = size > SUDDEN.0 * scale && (loud > SUDDEN.1 || loud > LIKELY.0 && beyond(LIKELY.1));
        let raised = changes || size > LASTING.0 * scale && beyond(LASTING.1);
        if raised {
            self.since = 0.0;
        }
        let share = 1.0 - libm::exp(-self.gap / SLOW);
        for (usual, change) in self.usual.iter_mut().zip(change) {
            *usual += share * change;
        }
        self.gap = 0.0;
    }

    /// Whether it is raised.
    pub fn is_on(&self) -> bool {
        self.since < LASTS
    }

    /// Whether the samples do not fit their bands.
    pub fn is_inconsistent(&self) -> bool {
        self.nis > CONSISTENCY.1
    }

    pub(super) fn numbers(&self) -> [f64; 7] {
        let [a, b, c, d] = self.usual;
        [a, b, c, d, self.since, self.gap, self.nis]
    }
}
