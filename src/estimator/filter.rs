//! The filter of the estimate: one joint error state of the motion, the unknown force and the learned parameters.
//!
//! The bank of the [`Belief`] has the block of motion and force, [`Learning`] the blocks of the parameters (see there for the joint
//! covariance). Updates in time and by samples, corrections and restarts pass through here, so that all blocks stay together.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, SMatrix};

use super::belief::{Bank, Belief, Innovation, Prediction, persistence};
use super::error_state::{Error, GEOMETRY, LEARNED, LOADS, Learned, OFFSETS, READINGS};
use super::flow::Flow;
use super::learning::{Columns, Learning, Persistent, ReadingErrors};
use super::machine::{Machine, Prior};
use super::propagation::{ProcessNoise, Propagation};
use super::stored;
use super::tangent::{Frame, LinkState, Linkage};
use super::tuning::MODELS;
use crate::copies::clone_by_fields;

/// Belief about the motion and the force, and the learned parameters.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Filter {
    pub(super) belief: Belief,
    /// Boxed, so that it costs no space if nothing is learned.
    #[borsh(deserialize_with = "stored::read_optional")]
    learning: Option<Box<Learning>>,
}

clone_by_fields!(Filter { belief, learning });

/// Working copy of the simulation's motion, which a measurement update changes.
pub(super) struct Estimated {
    pub(super) motion: LinkState,
    pub(super) frame: Frame,
    /// Errors of the readings in addition to the errors of the motion; `None` if nothing is learned.
    pub(super) errors: Option<ReadingErrors>,
    /// Standard deviations of the persistent errors of both encoders, rad.
    pub(super) sigma: [f64; 2],
    /// Learned mounting angles of both encoders, rad.
    pub(super) offset: [f64; 2],
}

impl Estimated {
    /// Moves the working copy to another motion.
    pub(super) fn move_to(&mut self, linkage: &Linkage, motion: &LinkState) {
        (self.motion, self.frame) = (*motion, linkage.frame(&motion.theta));
    }
}

/// Correction of the estimate by a measurement update.
pub(super) struct Correction {
    /// Error by which motion, force and readings were corrected.
    pub(super) error: Error,
    /// Map between the tangent bases before and after.
    pub(super) turn: Matrix2<f64>,
}

/// Belief about a motion, with the learned parameters if it has any: all that is known of the motion's uncertainty.
#[derive(Clone, Copy)]
pub(super) struct Known<'a> {
    pub(super) belief: &'a Belief,
    pub(super) learning: Option<&'a Learning>,
}

impl Filter {
    /// Initial estimate of a scene.
    pub(super) fn new(machine: &Machine) -> Self {
        Self {
            belief: Belief::new(machine.start_variances()),
            learning: machine.prior.as_ref().map(|prior| Box::new(Learning::new(prior))),
        }
    }

    /// Whether parameters are learned.
    pub(super) fn learns(&self) -> bool {
        self.learning.is_some()
    }

    /// Whether lengths and mounting angles are learned at present.
    pub(super) fn learns_geometry(&self) -> bool {
        self.learning.as_ref().is_some_and(|learning| learning.learns_geometry())
    }

    /// All that is known of the uncertainty of the estimate.
    pub(super) fn known(&self) -> Known<'_> {
        Known { belief: &self.belief, learning: self.learning.as_deref() }
    }

    /// The estimate about a motion.
    pub(super) fn estimated(&self, machine: &Machine, motion: &LinkState) -> Estimated {
        let frame = machine.linkage.frame(&motion.theta);
        let errors = self.reading_errors(machine, motion, &frame);
        let [sigma, offset] = match (&self.learning, &errors) {
            (Some(learning), Some(errors)) => {
                let sigma = learning.sigma_of_readings(&self.belief.bank, errors);
                [sigma, [0, 1].map(|i| learning.values()[OFFSETS.start + i])]
            }
            _ => [unlearned_errors(machine, motion, &frame, machine.unlearned[1]), [0.0; 2]],
        };
        Estimated { motion: *motion, frame, errors, sigma, offset }
    }

    /// Errors of both readings in addition to the errors of the motion; `None` if nothing is learned.
    pub(super) fn reading_errors(&self, machine: &Machine, motion: &LinkState, frame: &Frame) -> Option<ReadingErrors> {
        self.learns()
            .then(|| ReadingErrors { rows: frame.readings_by_geometry(), further: unlearned_errors(machine, motion, frame, 0.0) })
    }

    /// Bank for filters without parameters: all errors of both readings count as persistent errors.
    pub(super) fn without_parameters(&self, errors: Option<&ReadingErrors>) -> Bank {
        let bank = &self.belief.bank;
        self.learning.as_ref().zip(errors).map_or(*bank, |(learning, errors)| learning.shown(bank, errors))
    }

    /// Adds the effect of the parameters to an expected sample of encoder i. Returns its covariances with the parameters.
    pub(super) fn expect(
        &self,
        expected: &mut Prediction,
        (i, sample): (usize, &Innovation),
        errors: Option<&ReadingErrors>,
    ) -> Option<Columns> {
        let learned = self.learning.as_ref().zip(errors);
        learned.map(|(learning, errors)| learning.expect(expected, (i, sample), &errors.rows[i]))
    }

    /// Measurement update by an expected sample: gain and covariance of the parameters, of motion and force. If the axis `rests`,
    /// parameters keep their values.
    pub(super) fn update(&mut self, expected: &mut Prediction, columns: Option<&Columns>, persistent: &Persistent, rests: bool) {
        if let Some((learning, columns)) = self.learning.as_mut().zip(columns) {
            learning.update(expected, columns, persistent, rests);
        }
        self.belief.bank.update(expected);
    }

    /// Adds the mean errors to the motion, the force and the parameters; all errors then refer to the corrected estimate. `None` if no
    /// closed configuration is near the corrected one, or if it would be too fast.
    pub(super) fn correct(&mut self, machine: &mut Machine, estimate: &mut Estimated) -> Option<Correction> {
        let Estimated { motion, frame, errors, sigma, .. } = estimate;
        let bank = &mut self.belief.bank;
        let learned = self.learning.as_mut().map(|learning| {
            let values = learning.corrected(bank, machine);
            machine.learn(&values);
            (learning, values)
        });
        let (mut error, turn, corrected) = self.belief.inject_error(&machine.linkage, frame, motion)?;
        *frame = corrected;
        if let Some((learning, values)) = learned {
            // The change of the learned values changes the persistent errors of the readings.
            let change = values - learning.values();
            for (i, row) in errors.iter().flat_map(|errors| &errors.rows).enumerate() {
                error[READINGS + i] = row.dot(&change.fixed_rows::<GEOMETRY>(LOADS)) / sigma[i];
            }
            learning.correct(&self.belief.bank, &turn, values);
        }
        Some(Correction { error, turn })
    }

    /// Time update over a step, with the frame at its start. If the flow `learned` is given, parameters are learned; else learning pauses
    /// and their correlations with the motion are lost.
    pub(super) fn predict(
        &mut self,
        (frame, step): (&Frame, &Propagation),
        learned: Option<&Flow<LEARNED>>,
        noise: &ProcessNoise,
        (scales, timing): ([f64; 3], (f64, f64)),
        priors: &[f64; MODELS],
    ) {
        let bank = &mut self.belief.bank;
        match (&mut self.learning, learned) {
            (Some(learning), Some(flow)) => {
                learning.begin_geometry(bank, frame);
                learning.predict(bank, (step, flow), noise, (scales, timing), priors);
            }
            (learning, _) => {
                learning.iter_mut().for_each(|learning| learning.pause(bank));
                bank.predict(&step.f, noise, scales, persistence(timing.0, timing.1), priors);
            }
        }
    }

    /// Pauses learning: the correlations of the parameters with motion and force are lost.
    pub(super) fn pause(&mut self) {
        self.learning.iter_mut().for_each(|learning| learning.pause(&self.belief.bank));
    }

    /// Restarts all parameters. Bounds already reported remain reported.
    pub(super) fn restart_parameters(&mut self, machine: &Machine) {
        if let Some((learning, prior)) = self.learning.as_mut().zip(machine.prior.as_ref()) {
            learning.restart_all(prior);
        }
    }

    /// Restarts the parameters that differ between two priors, with the second.
    pub(super) fn restart_where_changed(&mut self, [before, after]: [&Prior; 2]) {
        if let Some(learning) = &mut self.learning {
            for i in (0..LEARNED).filter(|i| before.values[*i] != after.values[*i]) {
                learning.restart(after, i);
            }
        }
    }

    /// Values of the parameters; `None` if nothing is learned.
    pub(super) fn learned(&self) -> Option<Learned> {
        self.learning.as_ref().map(|learning| learning.values())
    }

    /// Standard deviations of the parameters; 0 for parameters that are not learned.
    pub(super) fn learned_sigma(&self) -> Learned {
        self.learning.as_ref().map_or_else(Learned::zeros, |learning| learning.sigma(&self.belief.bank))
    }

    /// Normalised error squared, against true values, of the parameters among `which` that are being learned, and their number.
    pub(super) fn learned_nees(&self, truth: &Learned, which: std::ops::Range<usize>) -> Option<(f64, usize)> {
        self.learning.as_ref().map(|learning| learning.nees(&self.belief.bank, truth, which))
    }

    /// Parameters that have been moved to a bound since the last call, and their bounds.
    pub(super) fn take_bounds(&mut self, machine: &Machine) -> impl Iterator<Item = (usize, [f64; 2])> {
        self.learning.iter_mut().flat_map(|learning| learning.take_bounds(machine))
    }

    /// Whether stored values are possible for a machine at a motion.
    pub(super) fn is_sound(&self, machine: &Machine, motion: &LinkState) -> bool {
        self.belief.is_sound(&machine.linkage, motion)
            && self.learns() == machine.prior.is_some()
            && self.learning.iter().all(|learning| learning.is_sound(&self.belief.bank, machine))
    }
}

impl<'a> Known<'a> {
    /// A belief without learned parameters.
    pub(super) fn of(belief: &'a Belief) -> Self {
        Self { belief, learning: None }
    }

    /// Extra second moments of a quantity due to errors of learned lengths and mounting angles, in each model: see
    /// [`Learning::added_moments`].
    pub(super) fn added_moments<const R: usize>(
        &self,
        by_error: &SMatrix<f64, R, 2>,
        by_parameters: [&SMatrix<f64, R, GEOMETRY>; 2],
    ) -> [SMatrix<f64, R, R>; MODELS] {
        self.learning
            .map_or([SMatrix::zeros(); MODELS], |learning| learning.added_moments(&self.belief.bank, by_error, by_parameters))
    }
}

/// Standard deviations of both readings' errors due to lengths that are not learned, discs and scales, and a mounting angle with the
/// standard deviation `offset`, rad.
fn unlearned_errors(machine: &Machine, motion: &LinkState, frame: &Frame, offset: f64) -> [f64; 2] {
    let by_lengths = frame.motors_by_lengths(machine.unlearned[0]);
    let by_encoders = machine.parameters.variances_of_encoders(&motion.theta);
    [0, 1].map(|i| (by_lengths[i] + offset * offset + by_encoders[i]).sqrt())
}
