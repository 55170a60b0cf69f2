//! How long the next step may be, and whether the scene is too stiff for an explicit method.

use borsh::{BorshDeserialize, BorshSerialize};

/// Part of the step promised by the error that is taken.
const SAFETY: f64 = 0.85;
/// The exponent of the last but one error: a proportional-integral controller (Hairer, Wanner II, section IV.2). With it and with
/// growth by 3 at most a quarter of the rejections of the classical controller remain.
const MEMORY: f64 = 0.02;
/// The exponent of the last error.
const EXPONENT: f64 = 1.0 / 8.0 - 0.75 * MEMORY;
/// Bounds on the change of the step.
const CHANGE: [f64; 2] = [0.3, 3.0];
/// ln of the error that is remembered for smaller ones: 1e-4.
const LEAST_LOG_ERROR: f64 = -9.210_340_371_976_182;

/// Accepted steps between two looks at the stiffness.
const INTERVAL: u64 = 1000;
/// A step whose product with the fastest rate is larger than this is at the border of stability: there the estimated product is 3.9 for
/// a damper and in the mean 3.3 for a damped spring (the true ones are 6.4 and 5.5), and below 1.7 where accuracy limits the step.
const BORDER: f64 = 2.5;
/// So many steps there in all, without [`CALM`] others in a row between them, are no accident.
const ENOUGH: u8 = 15;
/// So many steps away from the border begin the count anew.
const CALM: u8 = 6;

/// What is remembered from step to step.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Controller {
    /// ln of the error of the last accepted step in units of the tolerance.
    log_error: f64,
    at_border: u8,
    away: u8,
    /// Whether steps have been limited by stability and not by accuracy.
    pub(super) stiff: bool,
}

impl Default for Controller {
    fn default() -> Self {
        Self { log_error: LEAST_LOG_ERROR, at_border: 0, away: 0, stiff: false }
    }
}

impl Controller {
    /// By how much the step may change after one with this error, in units of the tolerance.
    #[inline(always)]
    pub(super) fn accepted(&mut self, error: f64) -> f64 {
        let log_error = libm::log(error);
        let change = SAFETY * libm::exp(MEMORY * self.log_error - EXPONENT * log_error);
        self.log_error = log_error.max(LEAST_LOG_ERROR);
        change.clamp(CHANGE[0], CHANGE[1])
    }

    /// The same after a step whose error is too large, or not a number.
    pub(super) fn rejected(error: f64) -> f64 {
        let change = SAFETY * libm::exp(-EXPONENT * libm::log(error));
        if change > CHANGE[0] { change.min(SAFETY) } else { CHANGE[0] }
    }

    /// Whether to look at the stiffness after this many accepted steps.
    #[inline(always)]
    pub(super) fn looks(&self, substeps: u64) -> bool {
        !self.stiff && (self.at_border > 0 || substeps.is_multiple_of(INTERVAL))
    }

    /// A look: step times fastest rate (Hairer, Wanner II, section IV.2, the test of DOP853).
    #[cold]
    pub(super) fn look(&mut self, step_times_rate: f64) {
        if step_times_rate > BORDER {
            self.away = 0;
            self.at_border += 1;
            self.stiff = self.at_border == ENOUGH;
        } else if self.at_border > 0 {
            self.away += 1;
            if self.away == CALM {
                (self.at_border, self.away) = (0, 0);
            }
        }
    }
}
