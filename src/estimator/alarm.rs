//! Alarm for an unmodelled force, and the consistency test of innovations.

use borsh::{BorshDeserialize, BorshSerialize};

use super::linkage::Frame;
use super::track::Track;

/// Sudden alarm: change of the unknown force, in torque scales, and probability of the loud models above which it counts.
const SUDDEN: (f64, f64) = (0.25, 0.999);
/// Sudden alarm of lower probability: probability of the loud models, and normalised change in standard deviations.
const LIKELY: (f64, f64) = (0.9, 2.5);
/// Lasting alarm: change of the unknown force, in torque scales, and in standard deviations.
const LASTING: (f64, f64) = (0.5, 6.0);
/// Time constant by which the reference force follows, s: slower drift is no alarm.
const SLOW: f64 = 0.3;
/// Duration of an alarm, s.
const LASTS: f64 = 0.1;
/// Largest normalised innovation squared of a sample in the average: caps the influence of an outlier.
const WORST: f64 = 30.0;
/// Consistency test: averaging length in samples, and largest mean normalised innovation squared, of 1 expected.
const CONSISTENCY: (f64, f64) = (100.0, 4.0);

/// State of the alarm.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Alarm {
    /// Reference value of the unknown force as inputs, N·m and N.
    usual: [f64; 4],
    /// Time since the alarm was last raised, s.
    since: f64,
    /// Time since the last sample, s.
    gap: f64,
    /// Mean normalised innovation squared per sample.
    nis: f64,
}

impl Default for Alarm {
    fn default() -> Self {
        Self { usual: [0.0; 4], since: f64::MAX, gap: 0.0, nis: 1.0 }
    }
}

impl Alarm {
    /// Time update by a macro step of h seconds.
    pub(super) fn step(&mut self, h: f64) {
        self.since = (self.since + h).min(f64::MAX);
        self.gap += h;
    }

    /// Measurement update: `nis` is the normalised innovation squared summed over `samples` samples.
    pub(super) fn receive(&mut self, track: &Track, at: &Frame, scale: f64, (nis, samples): (f64, usize)) {
        let samples = samples as f64;
        self.nis += samples / CONSISTENCY.0 * ((nis / samples).min(WORST) - self.nis);
        let change = std::array::from_fn(|i| track.force[i] - self.usual[i]);
        let [x, y] = Track { force: change, ..*track }.tangent_force(at);
        let [xx, xy, yy] = track.bank.force_covariance();
        let (size, determinant) = ((x * x + y * y).sqrt(), xx * yy - xy * xy);
        // Comparison of (size/σ)² without a division.
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

    /// Whether the alarm is raised.
    pub fn is_on(&self) -> bool {
        self.since < LASTS
    }

    /// Whether innovations exceed their covariance.
    pub fn is_inconsistent(&self) -> bool {
        self.nis > CONSISTENCY.1
    }

    pub(super) fn numbers(&self) -> [f64; 7] {
        let [a, b, c, d] = self.usual;
        [a, b, c, d, self.since, self.gap, self.nis]
    }
}
