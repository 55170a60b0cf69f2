//! Witness: a Kalman filter beside the estimate that assumes no fault; its innovations give the evidence for each fault.
//!
//! A fault of constant size u adds a known response G u to its innovations r, because the filter is linear (Friedland, IEEE Trans. Automatic
//! Control 14 (1969) 359; Willsky and Jones, 21 (1976) 108):
//!
//! ```text
//! V ← F V + B      G = H V + D      V ← V − K G      r ~ N(G u, S)
//! ```
//!
//! B is the effect of torques, tip forces, parameters and delays, D the effect of encoder faults. Sums of GᵀG/S and G r/S give the
//! evidence of each explanation, with its size integrated over the prior: an explanation with more degrees of freedom is penalised.
//!
//! Samples that are late by d measure the motion of d seconds ago, driven by the inputs of that time. So B is minus the rate of the
//! accelerations due to the inputs. When samples start to be late, V starts with minus the rates and accelerations of the motion.

use std::ops::Range;

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, Matrix4, SMatrix, SVector};

use super::belief::Innovation;
use super::error_state::{
    ERRORS, Error, FORCE, LOADS, MASSES, Matrix, PAYLOAD, VISCOUS, bound_variances, is_covariance, move_covariance, move_errors,
    reduce, turn_covariance, turn_errors,
};
use super::flow::Scene;
use super::machine::Machine;
use super::propagation::{ProcessNoise, Propagation};
use super::stored;
use super::tangent::{Frame, LinkState, Links, Pair};
use super::tuning::{ANYWHERE, LARGEST_NIS, LARGEST_RATE_VARIANCE, SIZES, TAKEN_AS_KNOWN};

/// Columns of the responses: torques of both motors, force at the tip, jumps of both encoders, delay, parameters.
pub(super) const TORQUES: Range<usize> = 0..2;
pub(super) const TIP: Range<usize> = 2..4;
pub(super) const JUMPS: Range<usize> = 4..6;
pub(super) const DELAY: usize = 6;
pub(super) const PARAMETERS: usize = 7;
/// Number of columns.
pub(super) const FAULTS: usize = PARAMETERS + LOADS;

/// Responses of the errors to faults of unit size, by columns.
type Responses = SMatrix<f64, ERRORS, FAULTS>;
/// One number for each fault.
pub(super) type Faults = SVector<f64, FAULTS>;

/// Derivatives of the link accelerations by the faults that depend on the motion.
pub(super) struct ByFaults {
    /// By a delay of the inputs, rad/s³.
    delay: Links,
    /// By the loads that can be learned.
    loads: SMatrix<f64, 4, LOADS>,
}

impl ByFaults {
    /// Derivatives in a step of h seconds between two motions under an unknown force.
    pub(super) fn new(scene: &impl Scene, [from, to]: [&LinkState; 2], force: &Links, h: f64) -> Self {
        let alpha = (to.omega - from.omega) / h;
        Self { delay: scene.by_delay(from, force, h), loads: scene.by_loads(from, force, &alpha) }
    }
}

/// Filter that assumes no fault, and the evidence of its innovations for each fault.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Witness {
    /// Mean error relative to the estimate's motion.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    error: Error,
    /// Covariance of the error.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    covariance: Matrix,
    /// Responses V.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    responses: Responses,
    /// Information, the sum of GᵀG/S.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    information: SMatrix<f64, FAULTS, FAULTS>,
    /// Score, the sums of G r/S.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    score: Faults,
    /// Sum of r²/S.
    pub(super) squares: f64,
    /// Number of samples.
    pub(super) samples: f64,
}

impl Witness {
    /// Starts with a mean error and its covariance.
    pub(super) fn new(error: Error, covariance: Matrix) -> Self {
        Self {
            error,
            covariance,
            responses: Responses::zeros(),
            information: SMatrix::zeros(),
            score: Faults::zeros(),
            squares: 0.0,
            samples: 0.0,
        }
    }

    /// Whether all numbers and their sums are finite.
    pub(super) fn is_finite(&self) -> bool {
        let Self { error, covariance, responses, information, score, squares, samples } = self;
        let sums = [error.sum(), covariance.sum(), responses.sum(), information.sum(), score.sum(), *squares, *samples];
        sums.iter().all(|sum| sum.is_finite())
    }

    /// Whether stored values are possible.
    pub(super) fn is_sound(&self) -> bool {
        self.is_finite() && is_covariance(&self.covariance) && [self.squares, self.samples].iter().all(|x| *x >= 0.0)
    }

    /// From now on samples are late: the motion that they measure lags behind by its rates, rad/s, or its accelerations, rad/s², on the
    /// tangent basis.
    pub(super) fn stand_back(&mut self, first: usize, by: &Pair) {
        let mut of = self.responses.fixed_view_mut::<2, 1>(first, DELAY);
        of -= by;
    }

    /// Applies a correction of the motion by an error that turns its tangent basis.
    pub(super) fn correct(&mut self, error: &Error, turn: &Matrix2<f64>) {
        self.error -= error;
        turn_errors(turn, &mut self.error);
        turn_covariance(turn, &mut self.covariance);
        turn_errors(turn, &mut self.responses);
    }

    /// Measurement update by a sample of encoder i.
    pub(super) fn receive(&mut self, i: usize, sample: &Innovation) {
        let Innovation { residual, row, noise } = sample;
        let column = self.covariance * row;
        let (off, variance) = (residual - row.dot(&self.error), row.dot(&column) + noise);
        let mut response: Faults = self.responses.tr_mul(row);
        response[JUMPS.start + i] += 1.0;
        let gain = column / variance;
        self.error += gain * off;
        reduce(&mut self.covariance, &column, variance);
        self.responses -= gain * response.transpose();
        self.information += response * (response / variance).transpose();
        self.score += response * (off / variance);
        self.squares += (off * off / variance).min(LARGEST_NIS);
        self.samples += 1.0;
    }

    /// Time update by h seconds, with the process noise of a model of the bank. `first`: in the first step, the accelerations on the tangent
    /// basis, rad/s².
    pub(super) fn predict(
        &mut self,
        step: &Propagation,
        (noise, model, [scale, inertia]): (&ProcessNoise, usize, [f64; 2]),
        by: &ByFaults,
        first: Option<&Pair>,
        h: f64,
    ) {
        let [white, walk] = TAKEN_AS_KNOWN.of_model(model, [scale, inertia, 0.0]);
        move_errors(&step.f, noise.kept, &mut self.error);
        move_covariance(&step.f, noise.kept, &mut self.covariance, |moved| noise.add_to(moved, [white, walk]));
        // Second-order terms in the error of the rates count as noise.
        let bend = self.error.fixed_rows::<2>(2).norm_squared() * h;
        for k in 2..4 {
            self.covariance[(k, k)] += bend * bend;
        }
        bound_variances(&mut self.covariance, [ANYWHERE, LARGEST_RATE_VARIANCE], |_, _| ());
        if let Some(accelerations) = first {
            self.stand_back(2, accelerations);
        }
        move_errors(&step.f, noise.kept, &mut self.responses);
        // The generalised forces of a fault act like the unknown force, which does not change.
        let effects = step.f.fixed_columns::<2>(FORCE) * generalised(&step.from, &step.mass, by);
        let mut acted = self.responses.fixed_rows_mut::<FORCE>(0);
        acted += effects.fixed_rows::<FORCE>(0);
        if first.is_some() {
            // The unknown force before the first step already contains the effect of the masses at the start of the step.
            let mut contained = self.responses.fixed_view_mut::<2, 4>(FORCE, PARAMETERS + MASSES.start);
            contained -= effects.fixed_view::<2, 4>(FORCE, PARAMETERS + MASSES.start);
        }
    }

    /// Reduction of the sum of squares by faults with these standard deviations, and the log-determinant that penalises their freedom.
    pub(super) fn explained(&self, sizes: &Faults) -> (f64, f64) {
        let scaled = |x: &Faults| x.component_mul(sizes);
        let mut free = SMatrix::<f64, FAULTS, FAULTS>::identity();
        for k in 0..FAULTS {
            let column: Faults = scaled(&self.information.column(k).into_owned()) * sizes[k];
            let mut into = free.column_mut(k);
            into += column;
        }
        let score = scaled(&self.score);
        // Only round-off can keep the matrix from being positive definite.
        free.cholesky().map_or((0.0, 0.0), |factor| {
            (score.dot(&factor.solve(&score)), 2.0 * factor.l_dirty().diagonal().iter().map(|x| libm::log(*x)).sum::<f64>())
        })
    }
}

/// Generalised forces on the tangent basis due to faults of unit size, N·m.
fn generalised(at: &Frame, mass: &Matrix4<f64>, by: &ByFaults) -> SMatrix<f64, 2, FAULTS> {
    let mut forces = SMatrix::<f64, 2, FAULTS>::zeros();
    forces.fixed_columns_mut::<4>(TORQUES.start).copy_from(&at.basis.tr_mul(&at.by_inputs()));
    let inertia = at.basis.tr_mul(mass);
    forces.set_column(DELAY, &(inertia * by.delay));
    forces.fixed_columns_mut::<LOADS>(PARAMETERS).copy_from(&(inertia * by.loads));
    forces
}

/// Standard deviations of the sizes of all faults before any sample.
pub(super) fn prior_sizes(machine: &Machine) -> Faults {
    let (torque, length) = (machine.torque_scale(), machine.linkage.length);
    Faults::from_fn(|k, _| match k {
        _ if TORQUES.contains(&k) => SIZES.torque * torque,
        _ if TIP.contains(&k) => SIZES.torque * torque / length,
        _ if JUMPS.contains(&k) => SIZES.jump,
        DELAY => SIZES.delay,
        _ if MASSES.contains(&(k - PARAMETERS)) => SIZES.mass,
        _ if k - PARAMETERS == PAYLOAD => SIZES.torque * torque / (9.81 * length),
        _ if VISCOUS.contains(&(k - PARAMETERS)) => SIZES.torque * torque / SIZES.rate,
        _ => SIZES.friction,
    })
}
