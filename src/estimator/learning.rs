//! Learning: the estimator estimates masses, friction, lengths and mounting angles while it runs. Each parameter has a value and,
//! beside the error state, an error with a covariance.
//!
//! Parameter errors δp move the motion by Ψ = ∂x/∂p (`flow.rs`) and are constant, so a time update changes only two blocks of the joint
//! covariance. A sample depends directly on lengths and mounting angles, through h (`geometry.rs`): y = H x + hᵀ δp.
//!
//! ```text
//! P = [ A   C ]       C' = Φ C + Ψ S                                         K ∝ [ A Hᵀ + C h  ]
//!     [ Cᵀ  S ]       A' = Φ A Φᵀ + Y + Yᵀ        Y = (Φ C + ½ Ψ S) Ψᵀ           [ Cᵀ Hᵀ + S h ]
//! ```
//!
//! The bank of the estimate stores A; each model here stores C and S.
//!
//! A fall without torques does not reveal a common factor of all masses, payload and friction included. This unobservable direction of δp
//! must not depend on the estimate; otherwise a linear filter mistakes its rotation for information (Huang, Mourikis and Roumeliotis, Int.
//! J. Robotics Research 29 (2010) 502). So the masses are stored as logarithms. For payload and friction, with value b, the error is ε = δb
//! − b δc, with the mean logarithm c of the masses: a common factor leaves ε at 0. P, Ψ and h refer to these errors. A correction of b does
//! not change ε: to first order, ε is the error of b/exp(c), which a fall does reveal.

use std::ops::Range;

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{ArrayStorage, Matrix2, SMatrix, SVector};

use super::belief::{Bank, Innovation, Mixing, Prediction, bound, persistence};
use super::error_state::{
    DRY, ERRORS, Error, FORCE, GEOMETRY, LEARNED, LENGTHS, LOADS, Learned, MASSES, Matrix, READINGS, Transition, combine,
    is_correlation, is_covariance, move_errors, reduce_in_part, turn_errors,
};
use super::flow::Flow;
use super::machine::{Machine, Prior};
use super::propagation::{ProcessNoise, Propagation};
use super::stored;
use super::tangent::Frame;
use super::tuning::{
    BOUNDS_LEFT_AFTER, LARGEST_FACTORS, LARGEST_MISFIT, LARGEST_STRAIN, LEARNT, LEAST_SIGMA, MODELS, NEGLIGIBLE_PROBABILITY,
    PRODUCTS,
};
use crate::copies::clone_by_fields;

/// Covariance between the errors of motion and force and the errors of the parameters.
type Cross = SMatrix<f64, ERRORS, LEARNED>;
/// Derivatives Ψ of the errors of the motion by the parameters.
type Moving = SMatrix<f64, FORCE, LEARNED>;
/// Derivatives of a reading by lengths and mounting angles.
type Shown = SVector<f64, GEOMETRY>;
/// Covariances of a sample with the parameters, in each model.
pub(super) type Columns = [Learned; MODELS];
/// Covariance of the errors of the parameters.
type Square = SMatrix<f64, LEARNED, LEARNED>;

/// Payload and friction. If all masses grow by a common factor, these parameters grow with them ([`carried`]).
const CARRIED: Range<usize> = MASSES.end..LOADS;
/// Number of masses, the first parameters.
const MASS_COUNT: f64 = MASSES.end as f64;

/// Errors of both readings that are not errors of the motion.
pub(super) struct ReadingErrors {
    /// Derivatives of each reading by lengths and mounting angles.
    pub(super) rows: [Shown; 2],
    /// Standard deviations of the errors due to discs and scales, and to lengths that are not learned, rad.
    pub(super) further: [f64; 2],
}

/// Errors of a reading that a sample contains again and again.
pub(super) struct Persistent {
    /// Standard deviation of the errors that are never learned, rad.
    pub(super) unlearned: f64,
    /// Standard deviation of all errors of the reading, lengths and mounting angles included, rad.
    pub(super) shown: f64,
    /// Number of samples in which the errors count once.
    pub(super) samples: f64,
}

/// Mean and covariance of the parameter errors in one model of the estimate's bank.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Moments {
    /// Mean.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    error: Learned,
    /// Covariance C with the errors of motion and force.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    cross: Cross,
    /// Covariance S.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    covariance: Square,
}

/// Learned values, and their errors in each model of the estimate's bank.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Learning {
    /// Parameter values that the unit moves by.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    values: Learned,
    models: [Moments; MODELS],
    /// Whether lengths and mounting angles are learned at present; if not, they count as persistent noise.
    geometry: bool,
    /// Bit mask of parameters that were moved to a bound. The bound means that the machine differs from its description.
    at_bound: u32,
    /// Bit mask of bounds already reported.
    told: u32,
    /// Time since the last move to a bound, s.
    within_for: f64,
}

clone_by_fields!(Learning { values, models, geometry, at_bound, told, within_for });

impl Learning {
    /// Starts from the prior.
    pub(super) fn new(prior: &Prior) -> Self {
        let covariance = Square::from_diagonal(&prior.sigma.component_mul(&prior.sigma));
        let mut model = Moments { covariance, ..Moments::ZERO };
        model.turn(&-carried(&prior.values, &covariance));
        Self { values: prior.values, models: [model; MODELS], geometry: false, at_bound: 0, told: 0, within_for: 0.0 }
    }

    /// Restarts all parameters. Bounds already reported remain reported.
    pub(super) fn restart_all(&mut self, prior: &Prior) {
        *self = Self { at_bound: self.at_bound & self.told, told: self.told, within_for: self.within_for, ..Self::new(prior) };
    }

    pub(super) fn values(&self) -> Learned {
        self.values
    }

    /// Standard deviations of the parameters.
    pub(super) fn sigma(&self, own: &Bank) -> Learned {
        let mut all = self.moments(own);
        all.turn(&self.carried());
        all.covariance.diagonal().map(|variance| variance.max(0.0).sqrt())
    }

    /// Normalised estimation error squared of the parameters in `which` with non-zero variance, and their number. For payload and friction
    /// the error is ε.
    pub(super) fn nees(&self, own: &Bank, truth: &Learned, which: Range<usize>) -> (f64, usize) {
        let Moments { covariance, .. } = self.moments(own);
        let free = |i: usize| which.contains(&i) && covariance[(i, i)] > 0.0;
        let p = Square::from_fn(|i, k| if free(i) && free(k) { covariance[(i, k)] } else { f64::from(u8::from(i == k)) });
        let off = self.error(&(truth - self.values));
        let error = Learned::from_fn(|i, _| if free(i) { off[i] } else { 0.0 });
        let count = (0..LEARNED).filter(|&i| free(i)).count();
        (p.cholesky().map_or(f64::INFINITY, |factor| error.dot(&factor.solve(&error))), count)
    }

    /// Returns the parameters that were moved to a bound since the last call, with the bounds. Each is reported once, and again only after
    /// all values have been within their bounds.
    pub(super) fn take_bounds(&mut self, machine: &Machine) -> impl Iterator<Item = (usize, [f64; 2])> {
        let news = self.at_bound & !std::mem::replace(&mut self.told, self.at_bound);
        (0..LEARNED).filter(move |i| news >> i & 1 == 1).map(|i| (i, bounds(i, machine)))
    }

    /// Whether lengths and mounting angles are learned at present.
    pub(super) fn learns_geometry(&self) -> bool {
        self.geometry
    }

    /// Extra second moments of a quantity due to errors of lengths and mounting angles, in each model. `by_error` is its derivative with
    /// respect to errors of the motion. Its derivative with respect to lengths and mounting angles is `by_parameters` if they are learned;
    /// otherwise it is `while_held`, at constant encoder readings.
    pub(super) fn added_moments<const R: usize>(
        &self,
        own: &Bank,
        by_error: &SMatrix<f64, R, 2>,
        [by_parameters, while_held]: [&SMatrix<f64, R, GEOMETRY>; 2],
    ) -> [SMatrix<f64, R, R>; MODELS] {
        let by_parameters = if self.geometry { by_parameters } else { while_held };
        std::array::from_fn(|j| {
            let (Moments { error, cross, covariance }, member) = (&self.models[j], &own.members[j]);
            let (off, added) = (by_error * member.error.fixed_rows::<2>(0), by_parameters * error.fixed_rows::<GEOMETRY>(LOADS));
            let both = by_error * cross.fixed_view::<2, GEOMETRY>(0, LOADS) * by_parameters.transpose() + off * added.transpose();
            let within = covariance.fixed_view::<GEOMETRY, GEOMETRY>(LOADS, LOADS);
            both + both.transpose() + by_parameters * within * by_parameters.transpose() + added * added.transpose()
        })
    }

    /// Standard deviations of all errors of the readings, rad; never 0.
    pub(super) fn sigma_of_readings(&self, own: &Bank, ReadingErrors { rows, further }: &ReadingErrors) -> [f64; 2] {
        [0, 1].map(|i| (self.variance(own, &rows[i]) + further[i] * further[i]).sqrt().max(LEAST_SIGMA))
    }

    /// Variance that lengths and mounting angles add to a sample, rad²; `row` has its derivatives by them.
    fn variance(&self, own: &Bank, row: &Shown) -> f64 {
        let of = |model: &Moments| {
            let within = model.covariance.fixed_view::<GEOMETRY, GEOMETRY>(LOADS, LOADS);
            row.dot(&(within * row)) + row.dot(&model.error.fixed_rows::<GEOMETRY>(LOADS)).powi(2)
        };
        self.models
            .iter()
            .zip(&own.members)
            .filter(|(_, member)| member.weight > 0.0)
            .map(|(model, member)| member.weight * of(model))
            .sum()
    }

    /// Errors of motion and force, with all errors of both readings as persistent encoder errors.
    pub(super) fn shown(&self, own: &Bank, errors: &ReadingErrors) -> Bank {
        let mut bank = *own;
        if !self.geometry {
            return bank;
        }
        let (sigma, ReadingErrors { rows, further }) = (self.sigma_of_readings(own, errors), errors);
        // Persistent errors of the readings by disc and scale errors, and by parameters.
        let by_discs = Matrix2::from_diagonal(&[0, 1].map(|i| further[i] / sigma[i]).into());
        let by_parameters = SMatrix::from_columns(&[rows[0] / sigma[0], rows[1] / sigma[1]]).transpose();
        for (model, member) in self.models.iter().zip(&mut bank.members) {
            let cross = model.cross.fixed_columns::<GEOMETRY>(LOADS);
            let within = model.covariance.fixed_view::<GEOMETRY, GEOMETRY>(LOADS, LOADS);
            let (mut error, mut covariance) = (member.error, member.covariance);
            let discs = covariance.fixed_columns::<2>(READINGS) * by_discs + cross * by_parameters.transpose();
            let both = by_discs * discs.fixed_rows::<2>(READINGS)
                + by_parameters * (cross.fixed_rows::<2>(READINGS).transpose() * by_discs + within * by_parameters.transpose());
            let of_readings =
                by_discs * error.fixed_rows::<2>(READINGS) + by_parameters * model.error.fixed_rows::<GEOMETRY>(LOADS);
            error.fixed_rows_mut::<2>(READINGS).copy_from(&of_readings);
            covariance.fixed_columns_mut::<2>(READINGS).copy_from(&discs);
            covariance.fixed_view_mut::<2, 2>(READINGS, READINGS).copy_from(&both);
            covariance.fill_lower_triangle_with_upper_triangle();
            (member.error, member.covariance) = (error, covariance);
        }
        bank
    }

    /// Derivatives of the parameters by the mean logarithm of the masses: see [`carried`].
    fn carried(&self) -> Learned {
        carried(&self.values, &self.models[0].covariance)
    }

    /// Error of the parameters for a change of their values.
    fn error(&self, change: &Learned) -> Learned {
        change - self.carried() * common(change)
    }

    /// Values of the parameters for this error.
    fn with_error(&self, error: &Learned) -> Learned {
        self.values + error + self.carried() * common(error)
    }

    /// Mean error of the mixture.
    fn mean(&self, own: &Bank) -> Learned {
        self.models.iter().zip(&own.members).map(|(model, member)| model.error * member.weight).sum()
    }

    /// Moments of the mixture.
    fn moments(&self, own: &Bank) -> Moments {
        let (mean, mean_own) = (self.mean(own), own.mean());
        let mut all = Moments { error: mean, ..Moments::ZERO };
        for (model, member) in self.models.iter().zip(&own.members) {
            let weight = member.weight;
            if weight >= NEGLIGIBLE_PROBABILITY {
                let share = weight.sqrt();
                let (off, off_own) = ((model.error - mean) * share, (member.error - mean_own) * share);
                combine(&mut all.cross, 1.0, (weight, &model.cross), (&off_own, &off));
                combine(&mut all.covariance, 1.0, (weight, &model.covariance), (&off, &off));
            }
        }
        all
    }

    /// Pauses learning while the bank of the estimate continues alone: the correlations of the parameters with the estimate's bank are
    /// lost.
    pub(super) fn pause(&mut self, own: &Bank) {
        let Moments { covariance, .. } = self.moments(own);
        self.models = [Moments { covariance, ..Moments::ZERO }; MODELS];
        self.geometry = false;
    }

    /// Starts to learn lengths and mounting angles. The encoders have fixed the motor angles until now, so the angles contain the errors of
    /// lengths and mounting angles.
    pub(super) fn begin_geometry(&mut self, own: &mut Bank, frame: &Frame) {
        if !std::mem::replace(&mut self.geometry, true) {
            let held = frame.held_by_geometry();
            for (model, member) in self.models.iter_mut().zip(&mut own.members) {
                let cross = held * model.covariance.fixed_rows::<GEOMETRY>(LOADS);
                let mut angles = model.cross.fixed_rows_mut::<2>(0);
                angles += cross;
                let mut angles = member.covariance.fixed_view_mut::<2, 2>(0, 0);
                angles += cross.fixed_columns::<GEOMETRY>(LOADS) * held.transpose();
                member.covariance.fill_upper_triangle_with_lower_triangle();
            }
        }
    }

    /// Restarts one parameter.
    pub(super) fn restart(&mut self, prior: &Prior, which: usize) {
        let before = self.carried();
        self.values[which] = prior.values[which];
        for model in &mut self.models {
            model.turn(&before);
            let Moments { error, cross, covariance } = model;
            error[which] = 0.0;
            cross.column_mut(which).fill(0.0);
            covariance.row_mut(which).fill(0.0);
            covariance.column_mut(which).fill(0.0);
            covariance[(which, which)] = prior.sigma[which] * prior.sigma[which];
        }
        let back = -self.carried();
        self.models.iter_mut().for_each(|model| model.turn(&back));
    }

    /// Time update along a step with its flow, also of the bank of the estimate: see [`Bank::predict`].
    pub(super) fn predict(
        &mut self,
        own: &mut Bank,
        (step, flow): (&Propagation, &Flow<LEARNED>),
        noise: &ProcessNoise,
        (scales, (h, switch_time)): ([f64; 3], (f64, f64)),
        priors: &[f64; MODELS],
    ) {
        self.within_for += h;
        if self.within_for > BOUNDS_LEFT_AFTER {
            self.at_bound = 0;
        }
        let stay = persistence(h, switch_time);
        let mut psi = Moving::zeros();
        for (i, by_learned) in flow.by_learned.iter().enumerate() {
            psi.fixed_rows_mut::<2>(2 * i).copy_from(&step.to.basis.tr_mul(by_learned));
        }
        let with_common_factor = psi.columns_range(CARRIED) * self.carried().rows_range(CARRIED) / MASS_COUNT;
        psi.columns_range_mut(MASSES).column_iter_mut().for_each(|mut column| column += &with_common_factor);
        if !self.geometry {
            psi.fixed_columns_mut::<GEOMETRY>(LOADS).fill(0.0);
        }
        let (all, mean) = (self.moments(own), own.mean());
        // Contributions of the parameters to the mean and covariance of each model.
        let mut added = [(SVector::<f64, FORCE>::zeros(), SMatrix::<f64, ERRORS, FORCE>::zeros()); MODELS];
        for (j, (model, added)) in self.models.iter_mut().zip(&mut added).enumerate() {
            let mixing = Mixing::new(own.members[j].weight, stay, priors[j]);
            if mixing.weight > 0.0 {
                model.mix(&all, &(own.members[j].error - mean), mixing);
                *added = model.step(&step.f, noise.kept, &psi);
            }
        }
        let models = &mut self.models;
        own.predict_with(&step.f, noise, (&LEARNT, scales), (stay, priors), |j, member| {
            let (error, y) = &added[j];
            let mut moved = member.error.fixed_rows_mut::<FORCE>(0);
            moved += error;
            let mut columns = member.covariance.fixed_columns_mut::<FORCE>(0);
            columns += y;
            let mut rows = member.covariance.fixed_rows_mut::<FORCE>(0);
            rows += y.transpose();
            member.covariance.fill_upper_triangle_with_lower_triangle();
            bound(j, member, |i, factor| models[j].cross.row_mut(i).scale_mut(factor));
        });
    }

    /// Adds the effect of lengths and mounting angles to an expected sample of encoder i; `row` has the derivatives of the reading by them.
    /// Returns the covariance of the sample with the parameters in each model. Lengths and mounting angles that are not learned at present
    /// are part of the sample's noise.
    pub(super) fn expect(&self, expected: &mut Prediction, (i, sample): (usize, &Innovation), row: &Shown) -> Columns {
        let row = if self.geometry { *row } else { Shown::zeros() };
        // Without delay a sample depends only on angles and a persistent error.
        let own = sample.row.fixed_rows::<2>(0);
        let mut columns = [Learned::zeros(); MODELS];
        for (j, (model, (residual, variance, of_errors))) in self.models.iter().zip(&mut expected.each).enumerate() {
            if expected.weights[j] == 0.0 {
                continue;
            }
            let by_errors = model.cross.fixed_columns::<GEOMETRY>(LOADS) * row;
            let by_parameters = model.covariance.fixed_columns::<GEOMETRY>(LOADS) * row;
            *residual -= row.dot(&model.error.fixed_rows::<GEOMETRY>(LOADS));
            *variance += 2.0 * sample.row.dot(&by_errors) + row.dot(&by_parameters.fixed_rows::<GEOMETRY>(LOADS));
            *of_errors += by_errors;
            let of_reading = model.cross.row(READINGS + i).transpose() * sample.row[READINGS + i];
            columns[j] = model.cross.fixed_rows::<2>(0).tr_mul(&own) + of_reading + by_parameters;
        }
        columns
    }

    /// Measurement update by an expected sample and its covariances with the parameters; call it before the update of the estimate's bank.
    /// If the axis `rests`, parameters keep their values and their uncertainty (Schmidt 1966).
    ///
    /// Learning would explain unmodelled errors by parameters. So for lengths and mounting angles a sample has extra noise of variance R. R
    /// represents two errors, each counted once in n = `samples`: an error of standard deviation `unlearned`, rad, that is never learned,
    /// and the product of mass errors and reading errors due to lengths and mounting angles, `shown`, rad, which a linear filter neglects.
    /// If c is the covariance with the innovation, the gain is c/(S + R) = (1 − r) c/S. The covariance of lengths and mounting angles
    /// decreases by (1 − r²) c cᵀ/S (Joseph form), all other covariances as without R. Lengths and mounting angles explain part of an
    /// innovation, with variance d² in the quietest model. The share of it that is not learned persists, so models are compared as if the
    /// sample also had the noise n r d².
    pub(super) fn update(
        &mut self,
        expected: &mut Prediction,
        columns: &Columns,
        &Persistent { unlearned, shown, samples }: &Persistent,
        rests: bool,
    ) {
        // The quietest model, with the smallest process noise, comes first.
        let quietest = &self.models[0];
        let products = PRODUCTS * PRODUCTS * shown * shown * quietest.mass_variance();
        let further = (unlearned * unlearned + products) * samples;
        let left_of = |variance: f64| further / (variance + further);
        if unlearned > 0.0 && !rests && expected.weights[0] > 0.0 {
            let (_, variance, _) = expected.each[0];
            let explained = explained(&columns[0], &quietest.covariance).min(variance);
            expected.lasting = explained * samples * left_of(variance);
        }
        let models = self.models.iter_mut().zip(columns).zip(expected.weights).zip(&expected.each);
        for (((model, column), weight), (residual, variance, own)) in models {
            if weight == 0.0 {
                continue;
            }
            model.cross.ger(-1.0 / *variance, own, column, 1.0);
            if !rests {
                let (left, gain) = (left_of(*variance), residual / *variance);
                for i in 0..LEARNED {
                    model.error[i] += column[i] * if i < LOADS { gain } else { gain * (1.0 - left) };
                }
                reduce_in_part(&mut model.covariance, column, *variance, (LOADS, 1.0 - left * left));
            }
        }
    }

    /// Values after the next correction. Values beyond a bound are moved to the bound in each model. All correlated errors move too, in
    /// this bank and in the bank of the estimate. Covariances do not change (Simon, IET Control Theory and Applications 4 (2010) 1303).
    pub(super) fn corrected(&mut self, own: &mut Bank, machine: &Machine) -> Learned {
        let (carried, mut values) = (self.carried(), self.with_error(&self.mean(own)));
        for i in 0..LEARNED {
            let [least, most] = bounds(i, machine);
            let beyond = values[i].clamp(least, most) - values[i];
            if beyond != 0.0 {
                // A payload or friction of 0 is plausible: a machine may have none.
                if least < 0.0 {
                    (self.at_bound, self.within_for) = (self.at_bound | 1 << i, 0.0);
                }
                for (model, member) in self.models.iter_mut().zip(&mut own.members) {
                    // Covariances with the value, which is the error plus a share of the common factor.
                    let (by_masses, cross_with_masses) = model.with_common();
                    let with_value = model.covariance.column(i) + by_masses * carried[i];
                    let part = beyond / (with_value[i] + carried[i] * common(&with_value)).max(f64::MIN_POSITIVE);
                    model.error += with_value * part;
                    member.error += (model.cross.column(i) + cross_with_masses * carried[i]) * part;
                }
                // Round-off, or this move, may push values 0 to i beyond their bounds.
                let moved = self.with_error(&self.mean(own));
                values = Learned::from_fn(|k, _| {
                    let [least, most] = bounds(k, machine);
                    if k > i { moved[k] } else { moved[k].clamp(least, most) }
                });
            }
        }
        values
    }

    /// Applies a correction of the values, and of the motion, which turns its tangent basis.
    pub(super) fn correct(&mut self, own: &Bank, turn: &Matrix2<f64>, values: Learned) {
        let change = self.error(&(values - self.values));
        for (model, _) in self.models.iter_mut().zip(&own.members).filter(|(_, member)| member.weight > 0.0) {
            model.error -= change;
            turn_errors(turn, &mut model.cross);
        }
        self.values = values;
    }

    /// Whether stored values are possible together with a bank.
    pub(super) fn is_sound(&self, own: &Bank, machine: &Machine) -> bool {
        let is_within = |(i, value): (usize, &f64)| {
            let [least, most] = bounds(i, machine);
            (least..=most).contains(value)
        };
        self.values.iter().enumerate().all(is_within)
            && self.within_for >= 0.0
            && self.models.iter().zip(&own.members).all(|(model, member)| model.is_sound(&member.covariance))
    }
}

impl Moments {
    /// Moments of exactly known parameters.
    const ZERO: Self = Self {
        error: Learned::from_array_storage(ArrayStorage([[0.0; LEARNED]])),
        cross: Cross::from_array_storage(ArrayStorage([[0.0; ERRORS]; LEARNED])),
        covariance: Square::from_array_storage(ArrayStorage([[0.0; LEARNED]; LEARNED])),
    };

    /// Covariances of the mean logarithm of the masses with the parameters, and with motion and force.
    fn with_common(&self) -> (Learned, Error) {
        let Self { cross, covariance, .. } = self;
        (covariance.columns_range(MASSES).column_sum() / MASS_COUNT, cross.columns_range(MASSES).column_sum() / MASS_COUNT)
    }

    /// Converts errors ε to errors of the values, δb = ε + b δc; with −b for b, converts back.
    fn turn(&mut self, carried: &Learned) {
        let (by_common, cross_by_common) = self.with_common();
        let Self { error, cross, covariance } = self;
        *error += carried * common(error);
        cross.ger(1.0, &cross_by_common, carried, 1.0);
        covariance.ger(1.0, carried, &by_common, 1.0);
        covariance.ger(1.0, &(by_common + carried * common(&by_common)), carried, 1.0);
        covariance.fill_lower_triangle_with_upper_triangle();
    }

    /// Mean variance of the logarithms of the link masses about their mean. It ignores a common factor, which a free fall without torques
    /// never reveals.
    fn mass_variance(&self) -> f64 {
        const COUNT: usize = MASSES.end;
        let masses = self.covariance.fixed_view::<COUNT, COUNT>(0, 0);
        (masses.trace() - masses.sum() / MASS_COUNT) / MASS_COUNT
    }

    /// Adds the mixture's share to the moments of this model. `off`: mean error of motion and force of this model minus the mixture's.
    fn mix(&mut self, all: &Self, off: &Error, Mixing { own, any, .. }: Mixing) {
        let share = (own * any).sqrt();
        let (by, off) = ((self.error - all.error) * share, off * share);
        combine(&mut self.cross, own, (any, &all.cross), (&off, &by));
        combine(&mut self.covariance, own, (any, &all.covariance), (&by, &by));
        self.error = self.error * own + all.error * any;
    }

    /// Time update along a step. Returns the contribution to the mean error of motion and force, and Y.
    fn step(&mut self, f: &Transition, kept: f64, psi: &Moving) -> (SVector<f64, FORCE>, SMatrix<f64, ERRORS, FORCE>) {
        let Self { error, cross, covariance } = &*self;
        let (added, pushed, mut half) = (psi * error, psi * covariance, *cross);
        move_errors(f, kept, &mut half);
        self.cross = half;
        let mut rows = self.cross.fixed_rows_mut::<FORCE>(0);
        rows += pushed;
        let mut rows = half.fixed_rows_mut::<FORCE>(0);
        rows += pushed * 0.5;
        (added, half * psi.transpose())
    }

    /// Whether stored moments are possible together with the covariance of motion and force.
    fn is_sound(&self, own: &Matrix) -> bool {
        let Self { error, cross, covariance: p } = self;
        error.iter().all(|x| x.is_finite())
            && is_covariance(p)
            && (0..LEARNED).all(|k| (0..ERRORS).all(|i| is_correlation(cross[(i, k)], own[(i, i)], p[(k, k)])))
    }
}

/// Mean logarithm of the masses.
fn common(learned: &Learned) -> f64 {
    learned.rows_range(MASSES).sum() / MASS_COUNT
}

/// Derivatives of the parameters by the mean logarithm of the masses under a common factor: the value for payload and viscous friction,
/// 1 for dry friction, which is a logarithm, and 0 for known parameters (variance 0) and all others.
fn carried(values: &Learned, covariance: &Square) -> Learned {
    Learned::from_fn(|i, _| match i {
        DRY if covariance[(i, i)] > 0.0 => 1.0,
        _ if CARRIED.contains(&i) && covariance[(i, i)] > 0.0 => values[i],
        _ => 0.0,
    })
}

/// Variance of the part of an innovation that lengths and mounting angles explain, from their covariances with it, as if they were
/// independent of each other.
fn explained(column: &Learned, covariance: &Square) -> f64 {
    // Known parameters have no covariance with anything.
    (LOADS..LEARNED).map(|i| column[i] * column[i] / covariance[(i, i)].max(f64::MIN_POSITIVE)).sum()
}

/// Bounds of a value: payload and friction are at least 0; factors, lengths and mounting angles stay near the described machine.
fn bounds(parameter: usize, machine: &Machine) -> [f64; 2] {
    let about_0 = |most: f64| [-most, most];
    match parameter {
        _ if MASSES.contains(&parameter) => about_0(LARGEST_FACTORS[0]),
        DRY => about_0(LARGEST_FACTORS[1]),
        _ if parameter >= LOADS => {
            let misfit = LARGEST_MISFIT * machine.prior.as_ref().map_or(0.0, |prior| prior.sigma[parameter]);
            let length = machine.nominal.get(parameter - LENGTHS.start);
            about_0(length.map_or(misfit, |length| misfit.min(LARGEST_STRAIN * length)))
        }
        _ => [0.0, f64::MAX],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::error_state::{Error, PAYLOAD};

    /// Before any sample, standard deviations equal the prior, also for payload and friction, which grow with the masses, and after a
    /// restart.
    #[test]
    fn widths_before_any_sample_are_those_of_the_prior() {
        let values = Learned::from_fn(|i, _| if CARRIED.contains(&i) { 0.1 * i as f64 } else { 0.0 });
        let mut prior = Prior { values, sigma: Learned::from_fn(|i, _| if i == PAYLOAD { 0.0 } else { 0.05 + 0.01 * i as f64 }) };
        let bank = Bank::new([1.0; 3]);
        let mut learning = Learning::new(&prior);
        // A part of the change of the values is due to the change of the masses.
        let some = Learned::from_fn(|i, _| libm::sin((3 * i + 1) as f64));
        let change = learning.with_error(&some) - learning.values;
        let mut moments = Moments { error: some, ..Moments::ZERO };
        moments.turn(&learning.carried());
        assert!((moments.error - change).amax() < 1e-15 && (learning.error(&change) - some).amax() < 1e-15);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-15, "{a} {b}");
        near(change[DRY], some[DRY] + common(&some));
        // A known payload does not grow with the masses.
        near(change[PAYLOAD], some[PAYLOAD]);
        // Tolerance: round-off of variances of up to 0.1.
        let off = |learning: &Learning, prior: &Prior| (learning.sigma(&bank) - prior.sigma).amax();
        assert!(off(&learning, &prior) < 1e-15, "{}", learning.sigma(&bank));
        for which in [MASSES.start, PAYLOAD, DRY] {
            (prior.values[which], prior.sigma[which]) = (0.3, 0.2);
            learning.restart(&prior, which);
            assert!(off(&learning, &prior) < 1e-15, "{which}: {}", learning.sigma(&bank));
        }
    }

    /// After a cautious update, a joint filter with the same gains has equal covariances, (I − K H) P (I − K H)ᵀ + K R Kᵀ. R is the
    /// noise of the sample; only the gain of lengths and mounting angles assumes a larger noise.
    #[test]
    fn cautious_updates_keep_true_covariances() {
        const ALL: usize = ERRORS + LEARNED;
        type All = SMatrix<f64, ALL, ALL>;
        let root = All::from_fn(|i, k| libm::sin((3 * i + 7 * k + 1) as f64));
        let all = root * root.transpose();
        let mut bank = Bank::new([1.0; 3]).with_priors([1.0, 0.0, 0.0, 0.0]);
        bank.members[0].covariance = all.fixed_view::<ERRORS, ERRORS>(0, 0).into();
        let prior = Prior { values: Learned::zeros(), sigma: Learned::zeros() };
        let mut learning = Learning { geometry: true, ..Learning::new(&prior) };
        learning.models[0].cross = all.fixed_view::<ERRORS, LEARNED>(0, ERRORS).into();
        learning.models[0].covariance = all.fixed_view::<LEARNED, LEARNED>(ERRORS, ERRORS).into();

        let (noise, persistent, shown_by_readings, samples) = (0.3, 0.5, 40.0, 4.0);
        let row = Error::from_fn(|i, _| [0.7, -0.4, 0.0, 0.0, 0.0, 0.0, persistent, 0.0][i]);
        let shown = Shown::from_fn(|i, _| 0.1 * (i as f64) - 0.2);
        let sample = Innovation { residual: 1.3, row, noise };
        let mut expected = bank.prediction(&sample);
        let columns = learning.expect(&mut expected, (0, &sample), &shown);
        learning.update(&mut expected, &columns, &Persistent { unlearned: persistent, shown: shown_by_readings, samples }, false);
        bank.update(&expected);

        let h = SVector::<f64, ALL>::from_fn(|i, _| match i {
            _ if i < ERRORS => row[i],
            _ if i < ERRORS + LOADS => 0.0,
            _ => shown[i - ERRORS - LOADS],
        });
        let column = all * h;
        let masses = all.fixed_view::<4, 4>(ERRORS, ERRORS);
        let centred = SMatrix::<f64, 4, 4>::identity() - SMatrix::<f64, 4, 4>::from_element(0.25);
        let product = PRODUCTS * shown_by_readings * ((centred * masses * centred).trace() / 4.0).sqrt();
        let variance = h.dot(&column) + noise;
        let cautious = variance + (persistent * persistent + product * product) * samples;
        assert!(product > persistent, "{product}");
        let gain = SVector::<f64, ALL>::from_fn(|i, _| column[i] / if i < ERRORS + LOADS { variance } else { cautious });
        let left = All::identity() - gain * h.transpose();
        let true_one = left * all * left.transpose() + gain * gain.transpose() * noise;
        let Moments { cross, covariance, error } = &learning.models[0];
        // Tolerance: round-off of sums of 26 products.
        let near = |off: f64| assert!(off < 1e-12 * all.amax(), "{off}");
        near((bank.members[0].covariance - true_one.fixed_view::<ERRORS, ERRORS>(0, 0)).amax());
        near((cross - true_one.fixed_view::<ERRORS, LEARNED>(0, ERRORS)).amax());
        near((covariance - true_one.fixed_view::<LEARNED, LEARNED>(ERRORS, ERRORS)).amax());
        near((error - gain.fixed_rows::<LEARNED>(ERRORS) * sample.residual).amax());
        assert!(expected.lasting > 0.0);
    }
}
