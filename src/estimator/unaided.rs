//! Estimate without an encoder that repeats its reading: decides whether the reading could have remained constant.
//!
//! The errors of this second bank are relative to the motion of the estimate and change with it. Only samples of the other encoder correct
//! them.

use std::f64::consts::TAU;

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::belief::{Bank, persistence};
use super::encoder::{Encoder, Fault, Measurement};
use super::error_state::{Error, FORCE, RATE, move_errors, turn_errors};
use super::propagation::{ProcessNoise, Propagation};
use super::stored;
use super::tuning::{CARRIED_WALK, GATE, LARGEST_CHANCE, LARGEST_GROWTH, LIKELY_MODELS, LONGEST_CHANCE, MODELS, OVERDUE};

/// Errors relative to the motion of the estimate, without the samples of one encoder since its reading last changed.
#[derive(Clone, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Unaided {
    /// Errors while the reading repeats.
    bank: Option<Bank>,
    /// Time since the first repeated reading, s.
    time: f64,
    /// Size of the unknown force at the start, N·m.
    force: f64,
    /// Error by a constant torque of [`LARGEST_HOLD`](super::tuning::LARGEST_HOLD) torque scales on the axis, since the reading last agreed
    /// with the bank's angle.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    by_hold: Error,
    /// Whether samples of the encoder are ignored because the axis has turned.
    doubted: bool,
    /// Whether the other encoder's reading has changed since the start. If neither changes, the machine may be blocked.
    other_changed: bool,
    /// Whether the estimate had settled on the encoder at the start.
    settled: bool,
}

/// What the estimate knows when a reading first repeats.
pub(super) struct Start {
    /// Errors of the estimate.
    pub(super) bank: Bank,
    /// Size of the unknown force, N·m.
    pub(super) force: f64,
    /// Error that is the torque which may hold the axis.
    pub(super) hold: Error,
}

impl Unaided {
    /// Starts at the first repeated reading of an encoder, before this sample corrects the estimate. Ends when the reading changes, or when
    /// the other encoder fails after its reading has changed. `models` are the prior probabilities of the estimate's models.
    pub(super) fn receive(&mut self, [own, other]: [&Encoder; 2], start: impl FnOnce() -> Start, models: &[f64; MODELS]) {
        if !own.repeats() || other.fails() && self.other_changed {
            self.bank = None;
        } else if self.bank.is_none() && own.fault != Fault::Stuck && !other.fails() {
            let Start { mut bank, force, hold } = start();
            bank.reset_priors(models);
            let settled = own.is_settled();
            *self = Self { bank: Some(bank), time: 0.0, force, by_hold: hold, doubted: false, other_changed: false, settled };
        }
    }

    /// Judges a repeated reading. The repetition is a fault if the other reading has changed and the axis has turned further than errors
    /// and a small holding torque together explain. Friction or an unknown drive may be such a torque. If a force of some model explains
    /// the repetition, a push may hold the axis for a while by chance. If the push would have to cancel a large turn, the reading is ignored
    /// until it changes. If the other reading repeats as well, the machine may be blocked. The repetition is then a fault only if the
    /// estimate had settled and no force of any model can block the axis like this.
    pub(super) fn judge(&mut self, sample: &Measurement) -> Fault {
        let Some(bank) = &self.bank else { return Fault::None };
        let &Measurement { sigma, quantum, innovation, .. } = sample;
        let expected = bank.prediction(&innovation);
        let (off, variance) = expected.mixture_moments();
        let of_angle = (variance - innovation.noise).max(0.0).sqrt();
        // While the reading agrees with the bank's angle, the hold starts again: no angles and rates.
        if off.abs() <= quantum + sigma {
            self.by_hold.fixed_rows_mut::<FORCE>(0).fill(0.0);
        }
        let held = if self.other_changed { innovation.row.dot(&self.by_hold).abs() } else { 0.0 };
        let turned = off.abs() > held + OVERDUE[0] * quantum + OVERDUE[1] * sigma + OVERDUE[2] * of_angle;
        let (lasts, leaps) = (self.time > LONGEST_CHANCE, off.abs() > LARGEST_CHANCE * quantum);
        let unexplained = expected.nis_of_loudest_model(0.0) > GATE;
        self.doubted |= turned && if self.other_changed { lasts || leaps } else { leaps && unexplained && self.settled };
        match () {
            () if !self.doubted => Fault::None,
            () if lasts || unexplained => Fault::Stuck,
            () => Fault::Rejected,
        }
    }

    /// Measurement update by a sample of the other encoder, with its quantisation interval.
    pub(super) fn update(&mut self, other: &Encoder, sample: &Measurement) {
        if let Some(bank) = &mut self.bank {
            bank.update(&other.with_quantisation_interval(&bank.prediction(&sample.innovation), sample));
            self.other_changed |= !other.repeats();
        }
    }

    /// Applies a correction of the motion by an error that turns its tangent basis.
    pub(super) fn correct(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some(bank) = &mut self.bank {
            bank.subtract_mean(error);
            bank.change_basis(turn);
            turn_errors(turn, &mut self.by_hold);
        }
    }

    /// Time update by h seconds as in the estimate's bank. The unknown force changes as in a forecast, because one encoder does not
    /// determine it. Ends if the other encoder is absent, because then nothing reveals how far the axis turns.
    pub(super) fn predict(
        &mut self,
        (step, noise): (&Propagation, &ProcessNoise),
        [scale, inertia]: [f64; 2],
        timing: (f64, f64),
        other: &Encoder,
    ) {
        if step.held || other.is_absent() {
            self.bank = None;
        }
        if let Some(bank) = &mut self.bank {
            self.time += timing.0;
            // A repeated reading keeps its error.
            let noise = ProcessNoise { kept: 1.0, ..*noise };
            let stay = persistence(timing.0, timing.1);
            move_errors(&step.f, 1.0, &mut self.by_hold);
            // The angles are bounded, so that all errors stay finite.
            let turn = self.by_hold.fixed_rows::<RATE>(0).norm();
            if turn > TAU {
                self.by_hold.fixed_rows_mut::<FORCE>(0).scale_mut(TAU / turn);
            }
            bank.predict(&step.f, &noise, [scale, inertia, self.force * CARRIED_WALK.sqrt()], stay, &LIKELY_MODELS);
        }
    }

    /// Errors without the encoder, in place of the errors of the estimate.
    pub(super) fn bank(&self) -> Option<Bank> {
        self.bank
    }

    /// Whether a stored value is possible.
    pub(super) fn is_sound(&self) -> bool {
        self.bank.as_ref().is_none_or(Bank::is_sound)
            && [self.time, self.force].iter().all(|x| *x >= 0.0 && x.is_finite())
            && self.by_hold.iter().all(|x| x.abs() < LARGEST_GROWTH)
    }
}
