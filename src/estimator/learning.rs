//! Masses and friction that the estimator learns while it runs: parameters behind the error state, with a value and a covariance each.
//!
//! Errors of the parameters p move the motion by Ψ = ∂x/∂p (`flow.rs`), and stay themselves:
//!
//! ```text
//! F = [ Φ  Ψ ]      error (a, b, δf, δp)
//!     [ 0  1 ]
//! ```
//!
//! The bank of the estimate is the part of this one that belongs to motion and force. Masses are in logarithms: a fall without torques leaves
//! a common factor of all masses unknown, which is then one direction wherever the estimate stands.

use std::ops::Range;

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, SMatrix, SVector};

use super::bank::{Bank, ERRORS, Error, Matrix, Member, PredictedSample};
use super::constants::{LARGEST_FACTORS, MODELS};
use super::flow::Flow;
use super::propagation::{ProcessNoise, Propagation};
use super::stored;

/// Number of parameters that may be learned.
pub const LEARNED: usize = 11;
/// Logarithms of the factors of the masses of links 1 to 4, inertias along with them.
pub const MASSES: Range<usize> = 0..4;
/// Mass of the payload, kg.
pub const PAYLOAD: usize = 4;
/// Coefficients of viscous friction in joints 1 to 5, N·m·s/rad.
pub const VISCOUS: Range<usize> = 5..10;
/// Logarithm of the factor of dry friction in all joints.
pub const DRY: usize = 10;
/// Number of error components with those of the parameters.
const ALL: usize = ERRORS + LEARNED;

/// Values of the parameters: logarithms, kg, N·m·s/rad.
pub type Learned = SVector<f64, LEARNED>;

/// Parameters before any sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Values.
    pub values: Learned,
    /// Standard deviations; 0: known.
    pub sigma: Learned,
}

/// Learned values, and the bank of their errors.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Learning {
    /// Values of the parameters, by which the unit moves.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    values: Learned,
    /// Bank of errors of motion, force and parameters.
    bank: Bank<ALL>,
    /// Whether its part of motion and force is the bank of the estimate: not while learning is held.
    joined: bool,
}

impl Learning {
    /// Nothing learned yet.
    #[cold]
    pub(super) fn new(prior: &Prior) -> Self {
        let mut covariance = SMatrix::zeros();
        for i in 0..LEARNED {
            covariance[(ERRORS + i, ERRORS + i)] = prior.sigma[i] * prior.sigma[i];
        }
        let member = Member { weight: 1.0 / MODELS as f64, error: SVector::zeros(), covariance };
        Self { values: prior.values, bank: Bank { members: [member; MODELS] }, joined: false }
    }

    /// Values of the parameters.
    pub(super) fn values(&self) -> Learned {
        self.values
    }

    /// Standard deviations of the parameters.
    pub(super) fn sigma(&self) -> Learned {
        let (_, covariance) = self.bank.moments();
        Learned::from_fn(|i, _| covariance[(ERRORS + i, ERRORS + i)].max(0.0).sqrt())
    }

    /// Normalised error squared of the parameters of non-zero variance among `which`, against true values, and their number.
    #[cold]
    pub(super) fn nees(&self, truth: &Learned, which: Range<usize>) -> (f64, usize) {
        let (_, covariance) = self.bank.moments();
        let free: Vec<usize> = which.filter(|i| covariance[(ERRORS + i, ERRORS + i)] > 0.0).collect();
        let p = nalgebra::DMatrix::from_fn(free.len(), free.len(), |i, k| covariance[(ERRORS + free[i], ERRORS + free[k])]);
        let error = nalgebra::DVector::from_fn(free.len(), |i, _| truth[free[i]] - self.values[free[i]]);
        (p.cholesky().map_or(f64::INFINITY, |factor| error.dot(&factor.solve(&error))), free.len())
    }

    /// Holds learning: what the parameters are correlated with is lost, and the bank of the estimate goes on by itself.
    pub(super) fn hold(&mut self) {
        self.joined = false;
    }

    /// A parameter begins anew.
    #[cold]
    pub(super) fn begin_anew(&mut self, prior: &Prior, which: usize) {
        self.values[which] = prior.values[which];
        let at = ERRORS + which;
        for Member { error, covariance, .. } in &mut self.bank.members {
            error[at] = 0.0;
            covariance.row_mut(at).fill(0.0);
            covariance.column_mut(at).fill(0.0);
            covariance[(at, at)] = prior.sigma[which] * prior.sigma[which];
        }
    }

    /// Joins the bank of the estimate, with which the parameters are not correlated.
    #[cold]
    fn join(&mut self, own: &Bank) {
        let (_, all) = self.bank.moments();
        self.bank.members = own.members.map(|Member { weight, error, covariance }| {
            let mut joined = Member { weight, error: SVector::zeros(), covariance: all };
            joined.covariance.fixed_rows_mut::<ERRORS>(0).fill(0.0);
            joined.covariance.fixed_columns_mut::<ERRORS>(0).fill(0.0);
            joined.error.fixed_rows_mut::<ERRORS>(0).copy_from(&error);
            joined.covariance.fixed_view_mut::<ERRORS, ERRORS>(0, 0).copy_from(&covariance);
            joined
        });
        self.joined = true;
    }

    /// Time update along a step with its flow, of all and of the bank of the estimate: see [`Bank::predict`].
    pub(super) fn predict(
        &mut self,
        own: &mut Bank,
        (step, flow): (&Propagation, &Flow<LEARNED>),
        noise: &ProcessNoise,
        (scales, timing): ([f64; 3], (f64, f64)),
        priors: &[f64; MODELS],
    ) {
        if !self.joined {
            self.join(own);
        }
        let mut f = SMatrix::<f64, ERRORS, ALL>::zeros();
        f.fixed_columns_mut::<ERRORS>(0).copy_from(&step.f);
        for (i, by_learned) in flow.by_learned.iter().enumerate() {
            f.fixed_view_mut::<2, LEARNED>(2 * i, ERRORS).copy_from(&step.to.basis.tr_mul(by_learned));
        }
        for (all, own) in self.bank.members.iter_mut().zip(&own.members) {
            all.weight = own.weight;
        }
        self.bank.predict(&f, noise, scales, timing, priors);
        for (all, own) in self.bank.members.iter().zip(&mut own.members) {
            let error: Error = all.error.fixed_rows::<ERRORS>(0).into();
            let covariance: Matrix = all.covariance.fixed_view::<ERRORS, ERRORS>(0, 0).into();
            *own = Member { weight: all.weight, error, covariance };
        }
    }

    /// Measurement update by a sample of this row as the bank of the estimate has expected it.
    pub(super) fn update(&mut self, expected: &PredictedSample, row: &Error) {
        if !self.joined {
            return;
        }
        let each = std::array::from_fn(|i| {
            let (residual, variance, _) = expected.each[i];
            (residual, variance, self.bank.members[i].covariance.fixed_columns::<ERRORS>(0) * row)
        });
        self.bank.update(&PredictedSample { weights: expected.weights, each });
    }

    /// Keeps the values within their bounds, before a correction: mean errors that would lead beyond are moved to the bound, with all that they are
    /// correlated with, in this bank and in that of the estimate. Covariances stay (Simon, IET Control Theory and Applications 4 (2010) 1303).
    pub(super) fn keep_within_bounds(&mut self, own: &mut Bank) {
        if !self.joined {
            return;
        }
        for i in 0..LEARNED {
            let at = ERRORS + i;
            let error: f64 = self.bank.members.iter().map(|member| member.weight * member.error[at]).sum();
            let [least, most] = bounds(i);
            let beyond = (self.values[i] + error).clamp(least, most) - (self.values[i] + error);
            if beyond != 0.0 {
                let (_, covariance) = self.bank.moments();
                let by = covariance.column(at) * (beyond / covariance[(at, at)].max(f64::MIN_POSITIVE));
                for (all, own) in self.bank.members.iter_mut().zip(&mut own.members) {
                    all.error += by;
                    own.error += by.fixed_rows::<ERRORS>(0);
                }
            }
        }
    }

    /// Follows a correction of the motion that turns its tangent basis, and corrects the values.
    pub(super) fn correct(&mut self, turn: &Matrix2<f64>) {
        if !self.joined {
            return;
        }
        let error = self.bank.mean();
        self.bank.subtract_mean(&error);
        self.bank.change_basis(turn);
        self.values += error.fixed_rows::<LEARNED>(ERRORS);
        // Round-off, and a bound that another one has led beyond.
        for (i, value) in self.values.iter_mut().enumerate() {
            let [least, most] = bounds(i);
            *value = value.clamp(least, most);
        }
    }

    /// Whether stored values are possible.
    #[cold]
    pub(super) fn is_sound(&self) -> bool {
        let is_within = |(i, value): (usize, &f64)| (bounds(i)[0]..=bounds(i)[1]).contains(value);
        self.bank.is_sound() && self.values.iter().enumerate().all(is_within)
    }
}

/// Bounds of a value: no mass or friction below 0, and no factor that no machine has.
fn bounds(parameter: usize) -> [f64; 2] {
    match parameter {
        _ if MASSES.contains(&parameter) => [-LARGEST_FACTORS[0], LARGEST_FACTORS[0]],
        DRY => [-LARGEST_FACTORS[1], LARGEST_FACTORS[1]],
        _ => [0.0, f64::MAX],
    }
}
