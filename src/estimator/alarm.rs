//! Alarm for an unmodelled force, and the consistency test of innovations.

use borsh::{BorshDeserialize, BorshSerialize};

use super::belief::{Belief, on_basis};
use super::stored;
use super::tangent::{Frame, Links, Pair};
use super::tuning::{
    ALARM_DURATION, CONSISTENCY_LENGTH, LARGEST_CONSISTENT_NIS, LARGEST_NIS_IN_MEAN, LASTING_CHANGE, PROBABLE_CHANGE,
    REFERENCE_TIME_CONSTANT, SUDDEN_CHANGE, VIOLENCE_PERSISTS,
};

#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Alarm {
    /// Reference value of the unknown force as inputs, N·m and N.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    reference_force: Links,
    /// Time since the alarm was last raised, s.
    time_since_alarm: f64,
    /// Time since the last sample, s.
    time_since_sample: f64,
    /// Mean normalised innovation squared per sample.
    nis: f64,
    /// Peak of the inertia torques with exponential decay, N·m.
    inertia: f64,
}

impl Default for Alarm {
    fn default() -> Self {
        Self { reference_force: Links::zeros(), time_since_alarm: f64::MAX, time_since_sample: 0.0, nis: 1.0, inertia: 0.0 }
    }
}

impl Alarm {
    /// Time update by a macro step of h seconds with these inertia torques, N·m.
    pub(super) fn step(&mut self, h: f64, inertia: f64) {
        self.inertia = inertia.max(self.inertia * libm::exp(-h / VIOLENCE_PERSISTS));
        self.time_since_alarm = (self.time_since_alarm + h).min(f64::MAX);
        self.time_since_sample += h;
    }

    /// Measurement update: `nis` is the normalised innovation squared summed over `samples` samples. `exceed_masses` returns whether a
    /// cause explains the samples better than mass errors.
    pub(super) fn receive(
        &mut self,
        belief: &Belief,
        at: &Frame,
        scale: f64,
        (nis, samples): (f64, usize),
        exceed_masses: impl FnOnce() -> bool,
    ) {
        let samples = samples as f64;
        self.nis += samples / CONSISTENCY_LENGTH * ((nis / samples).min(LARGEST_NIS_IN_MEAN) - self.nis);
        let change = belief.force - self.reference_force;
        let (on_tangent, covariance) = (on_basis(at, &change), belief.bank.force_covariance());
        // Comparison of (size/σ)² without a division: fᵀ adj(P) f > σ² det P.
        let adjugate = covariance.map_with_location(|i, k, x| if i == k { covariance[(1 - i, 1 - k)] } else { -x });
        let (size, squared) = (on_tangent.norm(), on_tangent.dot(&(adjugate * on_tangent)));
        let beyond = |sigmas: f64| squared > sigmas * sigmas * covariance.determinant();
        let loud = belief.bank.members[2].weight + belief.bank.members[3].weight;
        let changes =
            size > SUDDEN_CHANGE.0 * scale && (loud > SUDDEN_CHANGE.1 || loud > PROBABLE_CHANGE.0 && beyond(PROBABLE_CHANGE.1));
        let changes = changes || size > LASTING_CHANGE.0 * scale && beyond(LASTING_CHANGE.1);
        // Mass errors also act like forces, and like large ones if the inertia torques exceed the torque scale.
        if changes && (self.inertia < scale || exceed_masses()) {
            self.time_since_alarm = 0.0;
        }
        let share = 1.0 - libm::exp(-self.time_since_sample / REFERENCE_TIME_CONSTANT);
        self.reference_force += change * share;
        self.time_since_sample = 0.0;
    }

    /// Mean unknown force over [`REFERENCE_TIME_CONSTANT`] on the tangent basis, N·m.
    pub(super) fn reference_force(&self, at: &Frame) -> Pair {
        on_basis(at, &self.reference_force)
    }

    /// Whether the alarm is raised.
    pub(super) fn is_on(&self) -> bool {
        self.time_since_alarm < ALARM_DURATION
    }

    /// Whether the innovations are larger than their covariance allows.
    pub(super) fn is_inconsistent(&self) -> bool {
        self.nis > LARGEST_CONSISTENT_NIS
    }

    pub(super) fn is_sound(&self) -> bool {
        let sizes = [self.time_since_alarm, self.time_since_sample, self.nis, self.inertia];
        self.reference_force.iter().chain(&sizes).all(|x| x.is_finite()) && sizes.iter().all(|size| *size >= 0.0)
    }
}
