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
        let change = SAFETY * exp(self.memory * before - self.exponent * log_error);
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
            Some([longer, worse]) if worse > 1.0 => (ln(longer) / ln(worse)).clamp(self.exponent, 1.0),
            _ => self.exponent,
        };
        (SAFETY * exp(-exponent * ln(error))).clamp(self.rejected[0], self.rejected[1])
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

/// The natural logarithm of a positive number within 2e-6: as much as a step's length needs, for a third of what all digits take.
#[inline(never)]
pub(super) fn ln(x: f64) -> f64 {
    // 2^k m with m from √½ to √2; of 0 the k below the least.
    let k = (x.to_bits() as i64 - std::f64::consts::FRAC_1_SQRT_2.to_bits() as i64) >> (f64::MANTISSA_DIGITS - 1);
    let m = f64::from_bits((x.to_bits() as i64 - (k << (f64::MANTISSA_DIGITS - 1))) as u64);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    k as f64 * std::f64::consts::LN_2 + s * (2.0 + z * (2.0 / 3.0 + z * (2.0 / 5.0)))
}

/// The exponential function, of numbers up to 4 beside 0, within a part of 2e-7: all changes of a step's length are within.
#[inline(never)]
fn exp(x: f64) -> f64 {
    // Adding 1.5·2^52 rounds to an integer and leaves it in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let shifted = x.clamp(-4.0, 4.0) * std::f64::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = x.clamp(-4.0, 4.0) - k * std::f64::consts::LN_2;
    let e = 1.0 + r * (1.0 + r * (1.0 / 2.0 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r / 720.0)))));
    f64::from_bits(e.to_bits().wrapping_add(shifted.to_bits() << (f64::MANTISSA_DIGITS - 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_and_exponential_are_near_those_of_libm() {
        for i in -3000..3000 {
            let x = 1.01f64.powi(i);
            assert!((ln(x) - libm::log(x)).abs() < 2e-6, "ln {x:e}");
            let y = f64::from(i) / 750.0;
            assert!((exp(y) / libm::exp(y) - 1.0).abs() < 2e-7, "exp {y}");
        }
        assert_eq!((ln(1.0), exp(0.0)), (0.0, 1.0));
        assert!(ln(1.0 - f64::EPSILON) <= 0.0 && (-800.0..-700.0).contains(&ln(0.0)));
    }
}
