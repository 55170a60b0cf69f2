//! The estimate without an encoder that repeats its reading while the other's changes: whether the reading could have stayed.
//!
//! Its errors are about the motion of the estimate and move with them; only the samples of the other encoder correct them.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::bank::{Bank, Innovation};
use super::constants::{CARRIED_WALK, GATE, LIKELY_MODELS, LONGEST_CHANCE, MODELS, OVERDUE};
use super::encoder::{Encoder, Fault, Sample};
use super::error_state::Error;
use super::propagation::{ProcessNoise, Propagation};

/// Errors about the motion of the estimate that one encoder has no part in since its reading last changed.
#[derive(Clone, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Unaided {
    /// The encoder that has no part, and the bank.
    without: Option<(u8, Bank)>,
    /// Duration, s.
    time: f64,
    /// Size of the mean unknown force at its begin, N·m.
    force: f64,
}

impl Unaided {
    /// Begins with the estimate where a reading of encoder i repeats while the other's has changed, and ends where the reading changes or the
    /// other encoder is silent.
    /// `force`: size of the mean unknown force of late, N·m; `models`: prior probabilities of the estimate's models.
    pub(super) fn receive(
        &mut self,
        i: usize,
        encoders: &[Encoder; 2],
        (bank, force): (&Bank, impl FnOnce() -> f64),
        models: &[f64; MODELS],
    ) {
        match self.without {
            _ if encoders[1 - i].is_silent() => self.without = None,
            Some((encoder, _)) if usize::from(encoder) == i && !encoders[i].repeats() => self.without = None,
            None if encoders[i].repeats() && !encoders[1 - i].repeats() && encoders[i].fault != Fault::Stuck => {
                let mut bank = *bank;
                bank.reset_priors(models);
                *self = Self { without: Some((i as u8, bank)), time: 0.0, force: force() };
            }
            _ => (),
        }
    }

    /// Whether a repeated reading of encoder i is no longer possible: its axis has turned by more, and neither a force of any model nor a push
    /// that happens to hold the axis for a while explains it.
    pub(super) fn contradicts(&self, i: usize, sample: &Sample) -> bool {
        let Sample { sigma, quantum, innovation, .. } = sample;
        self.without.as_ref().filter(|(encoder, _)| usize::from(*encoder) == i).is_some_and(|(_, bank)| {
            let expected = bank.predict_sample(innovation);
            let (off, variance) = expected.mixture_moments();
            let of_angle = (variance - innovation.noise).max(0.0).sqrt();
            off.abs() > OVERDUE[0] * quantum + OVERDUE[1] * sigma + OVERDUE[2] * of_angle
                && (self.time > LONGEST_CHANCE || expected.nis_of_loudest_model() > GATE)
        })
    }

    /// Measurement update by a sample of encoder i.
    pub(super) fn update(&mut self, i: usize, sample: &Innovation) {
        if let Some((_, bank)) = self.without.as_mut().filter(|(encoder, _)| usize::from(*encoder) != i) {
            bank.update(&bank.predict_sample(sample));
        }
    }

    /// Follows a correction of the motion by an error that turns its tangent basis.
    pub(super) fn correct(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some((_, bank)) = &mut self.without {
            bank.subtract_mean(error);
            bank.change_basis(turn);
        }
    }

    /// Time update by h seconds, as of the estimate's bank, with an unknown force that changes as in a forecast: one encoder does not tell
    /// all of it.
    pub(super) fn predict(&mut self, step: &Propagation, noise: &ProcessNoise, [scale, inertia]: [f64; 2], timing: (f64, f64)) {
        if step.held {
            self.without = None;
        }
        if let Some((_, bank)) = &mut self.without {
            self.time += timing.0;
            bank.predict(&step.f, noise, [scale, inertia, self.force * CARRIED_WALK.sqrt()], timing, &LIKELY_MODELS);
        }
    }

    /// Takes the bank, to replace that of the estimate.
    pub(super) fn take(&mut self) -> Option<Bank> {
        self.without.take().map(|(_, bank)| bank)
    }

    /// Whether a stored value is possible.
    pub(super) fn is_sound(&self) -> bool {
        self.without.as_ref().is_none_or(|(encoder, bank)| *encoder < 2 && bank.is_sound())
            && [self.time, self.force].iter().all(|x| *x >= 0.0 && x.is_finite())
    }
}
