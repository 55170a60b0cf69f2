//! Judge of Newton's method: whether an iteration has converged, goes on, or has failed.
//!
//! Convergence is quadratic, so an iteration ends once the violation of its equations is below its bound, and the last correction, where
//! it matters, is so small that the next one would be round-off. A violation that no longer falls is judged by round-off instead, and
//! so are corrections.

use super::StepError;

/// Violation below which stagnation counts as round-off, relative to the system's size.
const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// Ratio of two successive corrections above which they no longer fall.
const STAGNATION_RATE: f64 = 0.25;

/// Bounds on the last correction, m and rad, one of which it meets.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastCorrection {
    /// Bound from which on the next correction would be round-off.
    pub(super) small: f64,
    /// Bound for corrections that no longer fall.
    pub(super) stagnant: f64,
}

impl LastCorrection {
    /// Every correction is admissible.
    pub(super) const ANY: Self = Self { small: f64::INFINITY, stagnant: 0.0 };

    /// A correction is admissible below a bound.
    pub(super) const fn below(small: f64) -> Self {
        Self { small, stagnant: 0.0 }
    }
}

/// An iteration under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Convergence {
    /// Admissible violation: max |Φ|, m, unless the caller scales it.
    tolerance: f64,
    /// Round-off of the violation.
    round_off: f64,
    last_correction: LastCorrection,
    /// Number of iterations taken.
    pub(super) iterations: u32,
    violation: f64,
    /// Last correction, m or rad, and its ratio to the one before.
    correction: f64,
    rate: f64,
}

impl Convergence {
    /// Before the first iteration, in a system of this length scale, m.
    pub(super) fn new(tolerance: f64, length_scale: f64, last_correction: LastCorrection) -> Self {
        let round_off = ROUND_OFF * length_scale;
        Self {
            tolerance,
            round_off,
            last_correction,
            iterations: 0,
            violation: f64::INFINITY,
            correction: f64::INFINITY,
            rate: 0.0,
        }
    }

    /// Takes the largest violation of the equations; returns whether the iteration has converged.
    pub(super) fn is_met(&mut self, violation: f64) -> bool {
        let stagnates = violation >= self.violation && violation < self.round_off;
        self.violation = violation;
        let LastCorrection { small, stagnant } = self.last_correction;
        let is_last = self.correction <= small || self.correction < stagnant && self.rate >= STAGNATION_RATE;
        (violation < self.tolerance || stagnates) && is_last
    }

    /// Takes the largest correction of one iteration, m or rad.
    pub(super) fn corrected(&mut self, correction: f64) {
        self.iterations += 1;
        self.rate = correction / self.correction;
        self.correction = correction;
    }

    /// Error of an iteration that has not converged.
    #[cold]
    pub(super) fn failure(&self) -> StepError {
        let &Self { iterations, violation, tolerance, correction, .. } = self;
        StepError::NotConverged { iterations, violation, tolerance, correction }
    }
}
