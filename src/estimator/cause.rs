//! Causes: the most probable explanation of the samples since something went wrong.
//!
//! From the first surprising sample on, a witness (`witness.rs`) tracks the errors in parallel to the bank. An explanation is a set of
//! faults that the witness leaves free.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::belief::Innovation;
use super::error_state::{Error, MASSES, Matrix};
use super::machine::Machine;
use super::propagation::{ProcessNoise, Propagation};
use super::tangent::Pair;
use super::tuning::{
    BEYOND_MASSES, CAUSE_MODEL, CAUSE_PERSISTS, DOUBT_TIME, EVIDENCE_TIME, LEAST_SCATTER, SAME_SURPRISE, SURPRISE, UNEXPLAINED,
};
use super::witness::{ByFaults, DELAY, FAULTS, Faults, JUMPS, PARAMETERS, TIP, TORQUES, Witness, prior_sizes};

/// Explanation of an alarm or a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cause {
    /// No cause.
    #[default]
    None,
    /// A torque at a motor, 0: left, 1: right.
    Torque(usize),
    /// A force at the tip.
    TipForce,
    /// An encoder, 0: left, 1: right.
    Encoder(usize),
    /// Payload or friction that differ from the parameters.
    Parameters,
    /// Times of the samples.
    Timing,
}

impl Cause {
    const ALL: [Self; 8] = [
        Self::None,
        Self::Torque(0),
        Self::Torque(1),
        Self::TipForce,
        Self::Encoder(0),
        Self::Encoder(1),
        Self::Parameters,
        Self::Timing,
    ];

    /// Number of the cause as reported to the master.
    pub fn number(self) -> usize {
        Self::ALL.iter().position(|cause| *cause == self).unwrap_or_default()
    }
}

/// A surprise and its witness.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Surprise {
    /// Duration, s.
    age: f64,
    /// Whether an alarm or a fault has confirmed the surprise.
    confirmed: bool,
    witness: Witness,
}

/// Judge of the causes; active from a surprise on.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Causes {
    surprise: Option<Surprise>,
    /// Number and probability of the last cause before the surprise, or of a certain cause.
    last: Option<(u8, f64)>,
    /// Time since the last alarm or fault, s.
    calm: f64,
}

impl Causes {
    /// Whether samples are judged, which needs the responses to parameters.
    pub(super) fn are_judged(&self) -> bool {
        self.surprise.as_ref().is_some_and(|surprise| surprise.age < EVIDENCE_TIME)
    }

    /// The surprise, if its samples are still judged.
    fn judge(&mut self) -> Option<&mut Surprise> {
        self.surprise.as_mut().filter(|surprise| surprise.age < EVIDENCE_TIME)
    }

    /// The surprise, if an alarm or a fault has confirmed it.
    fn confirmed(&self) -> Option<&Surprise> {
        self.surprise.as_ref().filter(|surprise| surprise.confirmed)
    }

    /// Whether a force, parameters or timing explain the samples since the last surprise better than mass errors. Encoder faults do not
    /// count: encoders have their own gates, and in fast motion an offset looks like a mass error.
    pub(super) fn exceed_masses(&self, machine: &Machine) -> bool {
        self.surprise.as_ref().is_some_and(|surprise| {
            let [masses, left, right, tip, _, _, parameters, timing] = surprise.evidence(machine, None);
            [left, right, tip, parameters, timing].iter().any(|evidence| evidence - masses > BEYOND_MASSES)
        })
    }

    /// Starts a judgement if an innovation with the normalised square `nis` surprises, or if an alarm is raised. `start` returns the rates
    /// of the estimate on its tangent basis, rad/s, and the mean and covariance of its errors.
    pub(super) fn begin_where_surprised(
        &mut self,
        machine: &Machine,
        (nis, alarm): (f64, bool),
        start: impl FnOnce() -> (Pair, (Error, Matrix)),
    ) {
        let surprises = nis.is_nan() || nis > SURPRISE;
        let begins = match &self.surprise {
            None => alarm || surprises,
            Some(surprise) => surprises && self.calm > 0.0 && surprise.age > SAME_SURPRISE,
        };
        if begins {
            if let Some(surprise) = self.confirmed() {
                let (cause, probability) = surprise.most_probable(machine, None);
                self.last = Some((cause.number() as u8, probability));
            }
            let (rates, (error, covariance)) = start();
            let mut witness = Witness::new(error, covariance);
            witness.stand_back(0, &(rates + error.fixed_rows::<2>(2)));
            self.surprise = Some(Surprise { age: 0.0, confirmed: false, witness });
        }
    }

    /// Measurement update by a sample of encoder i, before the update of the estimate.
    pub(super) fn receive(&mut self, i: usize, sample: &Innovation) {
        if let Some(surprise) = self.judge() {
            surprise.witness.receive(i, sample);
        }
    }

    /// Ends the collection of evidence when the errors are no longer tracked. `wrong`: the estimate was wrong, which confirms the surprise.
    pub(super) fn close(&mut self, wrong: bool) {
        if let Some(surprise) = &mut self.surprise {
            surprise.age = surprise.age.max(EVIDENCE_TIME);
            surprise.confirmed |= wrong;
        }
    }

    /// Accepts a certain cause, which explains the surprise.
    pub(super) fn know(&mut self, cause: Cause) {
        *self = Self { surprise: None, last: Some((cause.number() as u8, 1.0)), calm: 0.0 };
    }

    /// Applies a correction of the motion by `error`, which turns the tangent basis by `turn`.
    pub(super) fn correct(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some(surprise) = self.judge() {
            surprise.witness.correct(error, turn);
        }
    }

    /// Time update by h seconds: `wrong` says whether an alarm is raised or an encoder fails; `accelerations` returns the accelerations on
    /// the tangent basis, rad/s².
    pub(super) fn predict(
        &mut self,
        step: &Propagation,
        (noise, [scale, inertia]): (&ProcessNoise, [f64; 2]),
        (wrong, h): (bool, f64),
        accelerations: impl FnOnce() -> Pair,
        by: impl FnOnce() -> ByFaults,
    ) {
        self.calm = if wrong { 0.0 } else { (self.calm + h).min(f64::MAX) };
        if self.calm > CAUSE_PERSISTS {
            self.last = None;
        }
        let Some(surprise) = &mut self.surprise else { return };
        surprise.confirmed |= wrong;
        let forgotten = if surprise.confirmed { self.calm > CAUSE_PERSISTS } else { surprise.age > DOUBT_TIME };
        if forgotten || !surprise.witness.is_finite() {
            self.surprise = None;
            return;
        }
        if surprise.age < EVIDENCE_TIME && !step.held {
            let first = (surprise.age == 0.0).then(accelerations);
            surprise.witness.predict(step, (noise, CAUSE_MODEL, [scale, inertia]), &by(), first.as_ref(), h);
            surprise.age += h;
        } else {
            surprise.age = EVIDENCE_TIME;
        }
    }

    /// Most probable cause and its probability. `away`: an encoder with readings that have jumped away from the estimate.
    pub(super) fn most_probable(&self, machine: &Machine, away: Option<usize>) -> (Cause, f64) {
        match (self.confirmed(), self.last) {
            (Some(surprise), _) => surprise.most_probable(machine, away),
            (None, Some((cause, probability))) if self.calm < CAUSE_PERSISTS => (Cause::ALL[usize::from(cause)], probability),
            _ => (Cause::None, 1.0),
        }
    }

    /// Whether a stored value is possible.
    pub(super) fn is_sound(&self) -> bool {
        let told = self.last.is_none_or(|(cause, of)| usize::from(cause) < Cause::ALL.len() && (0.0..=1.0).contains(&of));
        told && self.calm >= 0.0 && self.surprise.as_ref().is_none_or(Surprise::is_sound)
    }
}

impl Surprise {
    /// Whether stored values are possible.
    fn is_sound(&self) -> bool {
        self.age.is_finite() && self.age >= 0.0 && self.witness.is_sound()
    }

    /// Most probable cause and its probability.
    fn most_probable(&self, machine: &Machine, away: Option<usize>) -> (Cause, f64) {
        let probabilities = self.probabilities(machine, away);
        let best = (1..Cause::ALL.len()).fold(0, |best, k| if probabilities[k] > probabilities[best] { k } else { best });
        (Cause::ALL[best], probabilities[best])
    }

    fn probabilities(&self, machine: &Machine, away: Option<usize>) -> [f64; Cause::ALL.len()] {
        let evidence = self.evidence(machine, away);
        let best = evidence.iter().fold(f64::NEG_INFINITY, |best, of| best.max(*of));
        let probabilities = evidence.map(|of| libm::exp(of - best));
        let sum: f64 = probabilities.iter().sum();
        probabilities.map(|probability| (1.0 - UNEXPLAINED) * probability / sum)
    }

    /// Log-evidence of all causes; the first, no cause, is mass errors alone.
    fn evidence(&self, machine: &Machine, away: Option<usize>) -> [f64; Cause::ALL.len()] {
        let (sizes, known) = (prior_sizes(machine), PARAMETERS + MASSES.start..PARAMETERS + MASSES.end);
        let explained = Cause::ALL.map(|cause| {
            let free = match cause {
                Cause::None => 0..0,
                Cause::Torque(i) => TORQUES.start + i..TORQUES.start + i + 1,
                Cause::TipForce => TIP,
                Cause::Encoder(i) => JUMPS.start + i..JUMPS.start + i + 1,
                Cause::Parameters => known.end..FAULTS,
                Cause::Timing => DELAY..PARAMETERS,
            };
            // Masses are never exact.
            self.witness.explained(&Faults::from_fn(|k, _| if known.contains(&k) || free.contains(&k) { sizes[k] } else { 0.0 }))
        });
        let most = explained.iter().fold(0.0_f64, |most, (less, _)| most.max(*less));
        // The evidence is divided by the scatter that the best explanation leaves, if this scatter exceeds the noise.
        let scatter = ((self.witness.squares - most) / self.witness.samples.max(1.0)).max(LEAST_SCATTER);
        std::array::from_fn(|k| {
            let ((less, freedom), cause) = (explained[k], Cause::ALL[k]);
            let possible = away.is_none_or(|i| [Cause::Encoder(i), Cause::Timing].contains(&cause));
            if possible { 0.5 * (less / scatter - freedom) } else { f64::NEG_INFINITY }
        })
    }
}
