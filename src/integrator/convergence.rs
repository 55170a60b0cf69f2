//! Judges Newton's method: an iteration has converged, continues, or has failed.
//!
//! Convergence is quadratic. An iteration therefore ends once the violation of its equations is below its bound and, if it matters, the
//! last correction is so small that the next one would be round-off. If the violation no longer falls, it is compared with round-off
//! instead, and so are corrections.

use super::StepError;

/// Violation below which stagnation counts as round-off, relative to the size of the system.
const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// Ratio of two successive corrections above which they no longer fall.
const STAGNATION_RATE: f64 = 0.25;

/// Bounds on the last correction, m and rad; it must meet one of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastCorrection {
    /// Bound below which the next correction would be round-off.
    pub(super) small: f64,
    /// Bound for corrections that no longer fall.
    pub(super) stagnant: f64,
}

impl LastCorrection {
    /// Every correction is admissible.
    pub(super) const ANY: Self = Self { small: f64::INFINITY, stagnant: 0.0 };

    /// Corrections below a bound are admissible.
    pub(super) const fn below(small: f64) -> Self {
        Self { small, stagnant: 0.0 }
    }
}

/// A running iteration.
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
    /// Last correction, m or rad.
    correction: f64,
    /// Ratio of the last correction to the correction before.
    rate: f64,
}

impl Convergence {
    /// Before the first iteration, for a system with this length scale, m.
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

    /// Records the largest violation of the equations. Returns whether the iteration has converged.
    pub(super) fn is_met(&mut self, violation: f64) -> bool {
        let stagnates = violation >= self.violation && violation < self.round_off;
        self.violation = violation;
        let LastCorrection { small, stagnant } = self.last_correction;
        let is_last = self.correction <= small || self.correction < stagnant && self.rate >= STAGNATION_RATE;
        (violation < self.tolerance || stagnates) && is_last
    }

    /// Records the largest correction of one iteration, m or rad.
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
