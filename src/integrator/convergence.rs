//! Judge of Newton's method on the constraints: whether an iteration has converged, goes on, or has failed.
//!
//! Convergence is quadratic, so an iteration ends once the violation of the constraints is below its bound, and the last correction, where
//! it matters, is so small that the next one would be round-off. A violation that no longer falls is judged by round-off instead.

use super::StepError;

/// Violation below which stagnation counts as round-off, relative to the system's size.
const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// An iteration under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Convergence {
    /// Admissible max |Φ|, m.
    tolerance: f64,
    /// Round-off of max |Φ|, m.
    round_off: f64,
    /// Admissible last correction, m and rad, where it is judged.
    last_correction: Option<f64>,
    /// Number of iterations taken.
    pub(super) iterations: u32,
    violation: f64,
    correction: f64,
}

impl Convergence {
    /// Before the first iteration, in a system of this length scale, m.
    pub(super) fn new(tolerance: f64, length_scale: f64, last_correction: Option<f64>) -> Self {
        let round_off = ROUND_OFF * length_scale;
        Self { tolerance, round_off, last_correction, iterations: 0, violation: f64::INFINITY, correction: f64::INFINITY }
    }

    /// Takes the largest violation of the constraints, m; returns whether the iteration has converged.
    pub(super) fn is_met(&mut self, violation: f64) -> bool {
        let stagnates = violation >= self.violation && violation < self.round_off;
        self.violation = violation;
        (violation < self.tolerance || stagnates) && self.last_correction.is_none_or(|largest| self.correction < largest)
    }

    /// Takes the largest correction of one iteration, m or rad.
    pub(super) fn corrected(&mut self, correction: f64) {
        self.iterations += 1;
        self.correction = correction;
    }

    /// Error of an iteration that has not converged.
    #[cold]
    pub(super) fn failure(&self) -> StepError {
        let &Self { iterations, violation, tolerance, correction, .. } = self;
        StepError::NotConverged { iterations, violation, tolerance, correction }
    }
}
