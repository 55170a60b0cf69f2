//! Step-size control: a proportional controller with memory of the last error, for all error-controlled methods.
//!
//! E. Hairer, G. Wanner, *Solving Ordinary Differential Equations II*, 2nd ed., section IV.2. Errors are in units of the tolerance.

use crate::vector::ROUND;

/// Safety factor on the step that the error allows.
const SAFETY: f64 = 0.85;

/// Lower limit of ln of a remembered error: ln 1e-4.
pub(super) const LEAST_LOG_ERROR: f64 = -9.210_340_371_976_182;

/// Parameters of a step-size controller.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepSizeController {
    /// Exponent of the last error.
    pub(super) exponent: f64,
    /// Exponent of the error before the last one; 0 for a method without memory.
    pub(super) memory: f64,
    /// Bounds on the factor after an accepted step.
    pub(super) accepted: [f64; 2],
    /// Bounds on the factor after a rejected step.
    pub(super) rejected: [f64; 2],
    /// Factor after a step without an error estimate.
    pub(super) failed: f64,
}

impl StepSizeController {
    /// Factor on the step length after an accepted step, from ln of its error and of the error before.
    pub(super) fn growth(&self, log_error: f64, before: f64) -> f64 {
        let change = SAFETY * exp(self.memory * before - self.exponent * log_error);
        change.clamp(self.accepted[0], self.accepted[1])
    }

    /// Longest step that may follow a step of `h` seconds, s.
    pub(super) fn longest_after(&self, h: f64) -> f64 {
        self.accepted[1] * h
    }

    /// Factor on the step length after a step that was rejected with this error; the error is NaN if there is no estimate.
    pub(super) fn reduction(&self, error: f64) -> f64 {
        self.reduction_after(error, None)
    }

    /// Factor on the step length after a rejected step. `before` are the ratios of lengths and errors of an earlier rejection to this one.
    /// With stiff forces errors fall more slowly with h than the order suggests; the order alone would cause further rejections.
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

/// Length of the next step, s, after a step of `h` seconds that should have taken `wanted` seconds. A step cut short by a limit does not
/// shorten later steps.
pub(super) fn next_step(h: f64, growth: f64, wanted: f64) -> f64 {
    if is_cut_short(h, wanted) { (h * growth).max(wanted) } else { h * growth }
}

/// Whether a step of `h` seconds was cut short by a limit.
pub(super) fn is_cut_short(h: f64, wanted: f64) -> bool {
    wanted.is_finite() && h < 0.5 * wanted
}

/// Natural logarithm of a positive number, with an absolute error below 2e-6: enough for step lengths, at a third of the cost of full
/// precision.
pub(super) fn ln(x: f64) -> f64 {
    // The number is 2^k m with m from √½ to √2. For 0, k is below its value for the smallest number.
    let k = (x.to_bits() as i64 - std::f64::consts::FRAC_1_SQRT_2.to_bits() as i64) >> (f64::MANTISSA_DIGITS - 1);
    let m = f64::from_bits((x.to_bits() as i64 - (k << (f64::MANTISSA_DIGITS - 1))) as u64);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    k as f64 * std::f64::consts::LN_2 + s * (2.0 + z * (2.0 / 3.0 + z * (2.0 / 5.0)))
}

/// Exponential function for |x| ≤ 4 (larger arguments are clamped), with a relative error below 2e-7. The range covers all factors of a
/// step length.
fn exp(x: f64) -> f64 {
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
    fn logarithm_and_exponential_agree_with_libm() {
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
