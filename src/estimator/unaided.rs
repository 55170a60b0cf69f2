//! The estimate without an encoder that repeats its reading: whether the reading could have stayed.
//!
//! Its errors are about the motion of the estimate and move with them; only the samples of the other encoder correct them.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::bank::Bank;
use super::constants::{CARRIED_WALK, GATE, LIKELY_MODELS, LONGEST_CHANCE, MODELS, OVERDUE};
use super::encoder::{Encoder, Fault, Sample};
use super::error_state::Error;
use super::propagation::{ProcessNoise, Propagation};

/// Errors about the motion of the estimate that an encoder has no part in since its reading last changed.
#[derive(Clone, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Unaided {
    /// Errors while the reading repeats.
    bank: Option<Bank>,
    /// Duration, s.
    time: f64,
    /// Size of the unknown force at its begin, N·m.
    force: f64,
    /// Whether the other encoder's reading has changed since: where neither does, the machine may be blocked.
    other_changed: bool,
}

impl Unaided {
    /// Begins with the estimate at the first repeated reading of an encoder, before that corrects it, and ends where the reading changes or the
    /// other encoder fails or is silent.
    /// `force`: size of the unknown force, N·m; `models`: prior probabilities of the estimate's models.
    pub(super) fn receive(&mut self, [own, other]: [&Encoder; 2], (bank, force): (&Bank, f64), models: &[f64; MODELS]) {
        if !own.repeats() || other.is_silent() || other.fails() {
            self.bank = None;
        } else if self.bank.is_none() && own.fault != Fault::Stuck {
            let mut bank = *bank;
            bank.reset_priors(models);
            *self = Self { bank: Some(bank), time: 0.0, force, other_changed: false };
        }
    }

    /// Whether a repeated reading is no longer possible: the other has changed, the axis has turned by more, and neither a force of any model nor a push that happens
    /// to hold the axis for a while explains it.
    pub(super) fn contradicts(&self, sample: &Sample) -> bool {
        let Sample { sigma, quantum, innovation, .. } = sample;
        self.bank.as_ref().filter(|_| self.other_changed).is_some_and(|bank| {
            let expected = bank.predict_sample(innovation);
            let (off, variance) = expected.mixture_moments();
            let of_angle = (variance - innovation.noise).max(0.0).sqrt();
            off.abs() > OVERDUE[0] * quantum + OVERDUE[1] * sigma + OVERDUE[2] * of_angle
                && (self.time > LONGEST_CHANCE || expected.nis_of_loudest_model(0.0) > GATE)
        })
    }

    /// Measurement update by a sample of the other encoder, with its quantisation interval.
    pub(super) fn update(&mut self, other: &Encoder, sample: &Sample) {
        if let Some(bank) = &mut self.bank {
            bank.update(&other.with_quantisation_interval(&bank.predict_sample(&sample.innovation), sample));
            self.other_changed |= !other.repeats();
        }
    }

    /// Follows a correction of the motion by an error that turns its tangent basis.
    pub(super) fn correct(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some(bank) = &mut self.bank {
            bank.subtract_mean(error);
            bank.change_basis(turn);
        }
    }

    /// Time update by h seconds, as of the estimate's bank, with an unknown force that changes as in a forecast: one encoder does not tell
    /// all of it.
    pub(super) fn predict(&mut self, step: &Propagation, noise: &ProcessNoise, [scale, inertia]: [f64; 2], timing: (f64, f64)) {
        if step.held {
            self.bank = None;
        }
        if let Some(bank) = &mut self.bank {
            self.time += timing.0;
            bank.predict(&step.f, noise, [scale, inertia, self.force * CARRIED_WALK.sqrt()], timing, &LIKELY_MODELS);
        }
    }

    /// Takes the bank, to replace that of the estimate.
    pub(super) fn take(&mut self) -> Option<Bank> {
        self.bank.take()
    }

    /// Whether a stored value is possible.
    pub(super) fn is_sound(&self) -> bool {
        self.bank.as_ref().is_none_or(Bank::is_sound) && [self.time, self.force].iter().all(|x| *x >= 0.0 && x.is_finite())
    }
}
