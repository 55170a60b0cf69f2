//! Causes: which of several explanations the samples since something went wrong speak for.
//!
//! From the first sample that surprises on, a Kalman filter that knows of no fault follows the errors beside the bank. A fault of constant
//! size u shows in its innovations r as a known response G, since the filter is linear (Friedland, IEEE Trans. Automatic Control 14 (1969)
//! 359; Willsky and Jones, 21 (1976) 108):
//!
//! ```text
//! V ← F V + B      G = H V + D      V ← V − K G      r ~ N(G u, S)
//! ```
//!
//! with B by torques, tip forces and parameters, and D by encoders and clocks. Sums of GᵀG/S and G r/S give the evidence of each
//! explanation, its size integrated over its prior, so that an explanation with more freedom pays for it.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, Matrix4, SMatrix, SVector};

use super::bank::{ERRORS, Error, FORCE, Innovation, Matrix, reduce, turned, turned_covariance};
use super::constants::{
    CAUSE_MODEL, CAUSE_PERSISTS, DOUBT_TIME, EVIDENCE_TIME, LARGEST_NIS, LEAST_SCATTER, RATES_PERSIST, SAME_SURPRISE, SIZES,
    SURPRISE, TAKEN_AS_KNOWN, UNEXPLAINED,
};
use super::learning::{LEARNED, MASSES, PAYLOAD, VISCOUS};
use super::parameters::Constants;
use super::propagation::{ProcessNoise, Propagation, transformed};
use super::stored;
use super::tangent::Frame;

/// Explanation of an alarm or a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cause {
    /// Nothing.
    #[default]
    None,
    /// A torque at a motor, 0: left, 1: right.
    Torque(usize),
    /// A force at the tip.
    TipForce,
    /// An encoder, 0: left, 1: right.
    Encoder(usize),
    /// Masses or friction other than the parameters.
    Parameters,
    /// Times of the samples.
    Timing,
}

impl Cause {
    /// All causes.
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

    /// Number as told to a master.
    pub fn number(self) -> usize {
        Self::ALL.iter().position(|cause| *cause == self).unwrap_or_default()
    }
}

/// First columns of the responses: torques of both motors, force at the tip, offsets of both encoders, delay, parameters.
const TORQUES: usize = 0;
const TIP: usize = 2;
const OFFSETS: usize = 4;
const DELAY: usize = 6;
const PARAMETERS: usize = 7;
/// Number of columns.
const FAULTS: usize = PARAMETERS + LEARNED;

/// Responses of the errors to faults of unit size, by columns.
type Responses = SMatrix<f64, ERRORS, FAULTS>;
/// A number for each fault.
type Faults = SVector<f64, FAULTS>;

/// Filter that knows of no fault, and what its innovations say of each.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Witness {
    /// Duration, s.
    age: f64,
    /// Whether something has been wrong.
    confirmed: bool,
    /// Mean error about the estimate's motion.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    error: Error,
    /// Error that follows the mean slowly, and so keeps the rates from before an encoder jumps.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    ahead: Error,
    /// Covariance of the error.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    covariance: Matrix,
    /// Responses V.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    responses: Responses,
    /// Sum of GᵀG/S.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    information: SMatrix<f64, FAULTS, FAULTS>,
    /// Sums of G r/S.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    told: Faults,
    /// Sum of r²/S, and number of samples.
    squares: f64,
    samples: f64,
}

/// Judge of the causes: at work from a surprise on.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Causes {
    witness: Option<Witness>,
    /// Number and probability of the last cause before the witness.
    last: Option<(u8, f64)>,
    /// Time since something last was wrong, s.
    calm: f64,
}

impl Causes {
    /// Whether samples are judged, with the responses to parameters.
    pub(super) fn are_judged(&self) -> bool {
        self.witness.as_ref().is_some_and(|witness| witness.age < EVIDENCE_TIME)
    }

    /// Witness that still judges samples.
    fn judge(&mut self) -> Option<&mut Witness> {
        self.witness.as_mut().filter(|witness| witness.age < EVIDENCE_TIME)
    }

    /// Witness of what has been wrong.
    fn confirmed(&self) -> Option<&Witness> {
        self.witness.as_ref().filter(|witness| witness.confirmed)
    }

    /// Begins to judge where an innovation of normalised square `nis` surprises, or where an alarm is raised. `start`: mean and covariance of
    /// the errors.
    pub(super) fn look(&mut self, constants: &Constants, nis: f64, alarm: bool, start: impl FnOnce() -> (Error, Matrix)) {
        let surprises = nis.is_nan() || nis > SURPRISE;
        let begins = match &self.witness {
            None => alarm || surprises,
            Some(witness) => surprises && self.calm > 0.0 && witness.age > SAME_SURPRISE,
        };
        if begins {
            if let Some(witness) = self.confirmed() {
                let (cause, probability) = witness.told(constants, None);
                self.last = Some((cause.number() as u8, probability));
            }
            let (error, covariance) = start();
            self.witness = Some(Witness::new(error, covariance));
        }
    }

    /// Measurement update by a sample of encoder i of an axis that turns at `rate`, rad/s, before the estimate's own.
    pub(super) fn receive(&mut self, (i, rate): (usize, f64), sample: &Innovation) {
        if let Some(witness) = self.judge() {
            let rate = rate + sample.row[0] * witness.ahead[2] + sample.row[1] * witness.ahead[3];
            witness.receive((i, rate), sample);
        }
    }

    /// Ends the collection of evidence where the errors are no longer followed; `wrong`: because the estimate was.
    pub(super) fn close(&mut self, wrong: bool) {
        if let Some(witness) = &mut self.witness {
            witness.age = witness.age.max(EVIDENCE_TIME);
            witness.confirmed |= wrong;
        }
    }

    /// Follows a correction of the motion by an error that turns its tangent basis.
    pub(super) fn correct(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some(witness) = self.judge() {
            witness.error = turned(turn, &(witness.error - error));
            witness.ahead = turned(turn, &(witness.ahead - error));
            witness.covariance = turned_covariance(turn, &witness.covariance);
            witness.responses = turned(turn, &witness.responses);
        }
    }

    /// Time update by h seconds: `wrong` says whether an alarm is raised or an encoder fails; `parameters` are the accelerations by those that
    /// may be learned.
    pub(super) fn predict(
        &mut self,
        step: &Propagation,
        noise: &ProcessNoise,
        [scale, inertia]: [f64; 2],
        (wrong, h): (bool, f64),
        parameters: impl FnOnce() -> SMatrix<f64, 4, LEARNED>,
    ) {
        self.calm = if wrong { 0.0 } else { (self.calm + h).min(f64::MAX) };
        if self.calm > CAUSE_PERSISTS {
            self.last = None;
        }
        let Some(witness) = &mut self.witness else { return };
        witness.confirmed |= wrong;
        let forgotten = if witness.confirmed { self.calm > CAUSE_PERSISTS } else { witness.age > DOUBT_TIME };
        if forgotten || !witness.is_finite() {
            self.witness = None;
            return;
        }
        if witness.age < EVIDENCE_TIME && !step.held {
            witness.predict(step, noise, [scale, inertia], &parameters(), h);
            witness.age += h;
        } else {
            witness.age = EVIDENCE_TIME;
        }
    }

    /// Most probable cause and its probability. `away`: an encoder whose readings have left the estimate.
    pub(super) fn told(&self, constants: &Constants, away: Option<usize>) -> (Cause, f64) {
        match (self.confirmed(), self.last) {
            (Some(witness), _) => witness.told(constants, away),
            (None, Some((cause, probability))) if self.calm < CAUSE_PERSISTS => (Cause::ALL[usize::from(cause)], probability),
            _ => (Cause::None, 1.0),
        }
    }

    /// Whether a stored value is possible.
    pub(super) fn is_sound(&self) -> bool {
        let told = self.last.is_none_or(|(cause, of)| usize::from(cause) < Cause::ALL.len() && (0.0..=1.0).contains(&of));
        told && self.calm >= 0.0 && self.witness.as_ref().is_none_or(Witness::is_sound)
    }
}

impl Witness {
    fn new(error: Error, covariance: Matrix) -> Self {
        Self {
            age: 0.0,
            confirmed: false,
            error,
            ahead: error,
            covariance,
            responses: Responses::zeros(),
            information: SMatrix::zeros(),
            told: Faults::zeros(),
            squares: 0.0,
            samples: 0.0,
        }
    }

    /// Whether all numbers are finite.
    fn is_finite(&self) -> bool {
        let errors = self.error.iter().chain(&self.ahead).chain(&self.covariance).chain(&self.responses);
        errors.chain(&self.information).chain(&self.told).chain(&[self.age, self.squares, self.samples]).all(|x| x.is_finite())
    }

    /// Whether stored values are possible.
    fn is_sound(&self) -> bool {
        let p = &self.covariance;
        self.is_finite()
            && *p == p.transpose()
            && (0..ERRORS).all(|i| p[(i, i)] >= 0.0)
            && [self.age, self.squares, self.samples].iter().all(|x| *x >= 0.0)
    }

    /// Measurement update by a sample of encoder i of an axis that turns at `rate`, rad/s.
    fn receive(&mut self, (i, rate): (usize, f64), sample: &Innovation) {
        let Innovation { residual, row, noise } = sample;
        let column = self.covariance * row;
        let (off, variance) = (residual - row.dot(&self.error), row.dot(&column) + noise);
        let mut response: Faults = self.responses.tr_mul(row);
        response[OFFSETS + i] += 1.0;
        response[DELAY] -= rate;
        let gain = column / variance;
        self.error += gain * off;
        reduce(&mut self.covariance, &gain, &column);
        self.responses -= gain * response.transpose();
        self.information += response * (response / variance).transpose();
        self.told += response * (off / variance);
        self.squares += (off * off / variance).min(LARGEST_NIS);
        self.samples += 1.0;
    }

    /// Time update by h seconds; `by` are the accelerations by parameters.
    fn predict(
        &mut self,
        step: &Propagation,
        noise: &ProcessNoise,
        [scale, inertia]: [f64; 2],
        by: &SMatrix<f64, 4, LEARNED>,
        h: f64,
    ) {
        let [white, walk] = TAKEN_AS_KNOWN.of_model(CAUSE_MODEL, [scale, inertia, 0.0]);
        self.error = step.f * self.error;
        self.ahead = step.f * self.ahead;
        self.ahead += (self.error - self.ahead) * (h / RATES_PERSIST).min(1.0);
        self.covariance = transformed(&step.f, &self.covariance, |moved| moved + noise.white * white + noise.walk * walk);
        // Terms of second order in the error of the rates count as noise.
        let bend = self.error.fixed_rows::<2>(2).norm_squared() * h;
        for k in 2..4 {
            self.covariance[(k, k)] += bend * bend;
        }
        let mut moved = step.f * self.responses;
        // Generalised forces of each fault act as the unknown force does, which stays as it is.
        let forces = generalised(&step.from, &step.mass, by);
        if self.age == 0.0 {
            // The unknown force before the surprise contains the effect of the masses.
            let before = step.f.fixed_view::<2, 2>(FORCE, FORCE) * forces;
            let mut of = moved.fixed_view_mut::<2, 4>(FORCE, PARAMETERS + MASSES.start);
            of -= before.fixed_columns::<4>(PARAMETERS + MASSES.start);
        }
        let mut acted = moved.fixed_rows_mut::<FORCE>(0);
        acted += step.f.fixed_view::<FORCE, 2>(0, FORCE) * forces;
        self.responses = moved;
    }

    /// Most probable cause and its probability.
    fn told(&self, constants: &Constants, away: Option<usize>) -> (Cause, f64) {
        let probabilities = self.probabilities(constants, away);
        let best = (1..Cause::ALL.len()).fold(0, |best, k| if probabilities[k] > probabilities[best] { k } else { best });
        (Cause::ALL[best], probabilities[best])
    }

    /// Probabilities of all causes.
    fn probabilities(&self, constants: &Constants, away: Option<usize>) -> [f64; Cause::ALL.len()] {
        let (sizes, known) = (prior_sizes(constants), PARAMETERS + MASSES.start..PARAMETERS + MASSES.end);
        let explained = Cause::ALL.map(|cause| {
            let free = match cause {
                Cause::None => 0..0,
                Cause::Torque(i) => TORQUES + i..TORQUES + i + 1,
                Cause::TipForce => TIP..OFFSETS,
                Cause::Encoder(i) => OFFSETS + i..OFFSETS + i + 1,
                Cause::Parameters => known.end..FAULTS,
                Cause::Timing => DELAY..PARAMETERS,
            };
            // Masses are never exact.
            self.explained(&Faults::from_fn(|k, _| if known.contains(&k) || free.contains(&k) { sizes[k] } else { 0.0 }))
        });
        let most = explained.iter().fold(0.0_f64, |most, (less, _)| most.max(*less));
        // Evidence is divided by the scatter that the best explanation leaves, where that is more than noise.
        let scatter = ((self.squares - most) / self.samples.max(1.0)).max(LEAST_SCATTER);
        let evidence: [f64; Cause::ALL.len()] = std::array::from_fn(|k| {
            let ((less, freedom), cause) = (explained[k], Cause::ALL[k]);
            let possible = away.is_none_or(|i| [Cause::Encoder(i), Cause::Timing].contains(&cause));
            if possible { 0.5 * (less / scatter - freedom) } else { f64::NEG_INFINITY }
        });
        let best = evidence.iter().fold(f64::NEG_INFINITY, |best, of| best.max(*of));
        let probabilities = evidence.map(|of| libm::exp(of - best));
        let sum: f64 = probabilities.iter().sum();
        probabilities.map(|probability| (1.0 - UNEXPLAINED) * probability / sum)
    }

    /// By how much faults of these standard deviations lessen the sum of squares, and the logarithm of the determinant that their freedom costs.
    fn explained(&self, sizes: &Faults) -> (f64, f64) {
        let scaled = |x: &Faults| x.component_mul(sizes);
        let mut free = SMatrix::<f64, FAULTS, FAULTS>::identity();
        for k in 0..FAULTS {
            let column: Faults = scaled(&self.information.column(k).into_owned()) * sizes[k];
            let mut into = free.column_mut(k);
            into += column;
        }
        let told = scaled(&self.told);
        // Round-off alone keeps the matrix from being positive definite.
        free.cholesky().map_or((0.0, 0.0), |factor| {
            (told.dot(&factor.solve(&told)), 2.0 * factor.l_dirty().diagonal().iter().map(|x| libm::log(*x)).sum::<f64>())
        })
    }
}

/// Generalised forces on the tangent basis by faults of unit size, N·m.
fn generalised(at: &Frame, mass: &Matrix4<f64>, by: &SMatrix<f64, 4, LEARNED>) -> SMatrix<f64, 2, FAULTS> {
    let mut forces = SMatrix::<f64, 2, FAULTS>::zeros();
    forces.fixed_columns_mut::<4>(TORQUES).copy_from(&at.basis.tr_mul(&at.by_inputs()));
    forces.fixed_columns_mut::<LEARNED>(PARAMETERS).copy_from(&(at.basis.tr_mul(mass) * by));
    forces
}

/// Standard deviations of the sizes of all faults before any sample.
fn prior_sizes(constants: &Constants) -> Faults {
    let (torque, length) = (constants.torque_scale(), constants.linkage.length);
    Faults::from_fn(|k, _| match k {
        _ if k < TIP => SIZES.torque * torque,
        _ if k < OFFSETS => SIZES.torque * torque / length,
        _ if k < DELAY => SIZES.offset,
        DELAY => SIZES.delay,
        _ if MASSES.contains(&(k - PARAMETERS)) => SIZES.mass,
        _ if k - PARAMETERS == PAYLOAD => SIZES.torque * torque / (9.81 * length),
        _ if VISCOUS.contains(&(k - PARAMETERS)) => SIZES.torque * torque / SIZES.rate,
        _ => SIZES.friction,
    })
}
