//! How long the next step may be: one controller for both adaptive methods.
//!
//! E. Hairer, G. Wanner, *Solving Ordinary Differential Equations II*, 2nd ed., section IV.2: proportional to a power of the last error,
//! and with some memory of the one before. Errors are in units of the tolerance.

/// Part of the step promised by the error that is taken.
const SAFETY: f64 = 0.85;

/// ln of the error that is remembered for smaller ones: 1e-4.
pub(super) const LEAST_LOG_ERROR: f64 = -9.210_340_371_976_182;

/// The law by which a method changes its step.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepSizeController {
    /// The exponent of the last error.
    pub(super) exponent: f64,
    /// The exponent of the last but one; 0 for a method that remembers none.
    pub(super) memory: f64,
    /// Bounds on the change after a step that was accepted.
    pub(super) accepted: [f64; 2],
    /// The same after one whose error was too large.
    pub(super) rejected: [f64; 2],
    /// The change after a step that failed altogether.
    pub(super) failed: f64,
}

impl StepSizeController {
    /// By how much the step may change after one that was accepted, by ln of its error and of that before it.
    #[inline]
    pub(super) fn growth(&self, log_error: f64, before: f64) -> f64 {
        let change = SAFETY * libm::exp(self.memory * before - self.exponent * log_error);
        change.clamp(self.accepted[0], self.accepted[1])
    }

    /// The longest step that may follow one of h seconds.
    #[inline]
    pub(super) fn longest_after(&self, h: f64) -> f64 {
        self.accepted[1] * h
    }

    /// The same after one that was rejected; its error is NaN where it failed.
    pub(super) fn reduction(&self, error: f64) -> f64 {
        self.reduction_after(error, None)
    }

    /// The same if another may have been rejected just before it, so many times longer and worse: with stiff forces errors fall more slowly
    /// with the step than the order promises, and by the order alone a third and a fourth rejection would follow.
    pub(super) fn reduction_after(&self, error: f64, before: Option<[f64; 2]>) -> f64 {
        if error.is_nan() {
            return self.failed;
        }
        let exponent = match before {
            Some([longer, worse]) if worse > 1.0 => (libm::log(longer) / libm::log(worse)).clamp(self.exponent, 1.0),
            _ => self.exponent,
        };
        (SAFETY * libm::exp(-exponent * libm::log(error))).clamp(self.rejected[0], self.rejected[1])
    }
}

/// The step wanted next after one of h seconds, where `wanted` had been wanted: a step cut short by a limit says nothing against longer
/// ones.
#[inline]
pub(super) fn next_step(h: f64, growth: f64, wanted: f64) -> f64 {
    if is_cut_short(h, wanted) { (h * growth).max(wanted) } else { h * growth }
}

/// Whether a step was cut short by a limit.
#[inline]
pub(super) fn is_cut_short(h: f64, wanted: f64) -> bool {
    wanted.is_finite() && h < 0.5 * wanted
}
