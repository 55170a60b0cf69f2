//! Exponential functions of two numbers at once, for friction and servos: tanh, and exp(−x²) together with tanh.
//!
//! The bits are equal on every platform: no fused multiply-add, no platform libm. With x = k ln 2 + r and |r| ≤ ln 2/2, the core is e^r − 1
//! by its Taylor polynomial of degree 13. Its remainder is below 1.3e-17 r. Estrin's scheme shortens the chain of dependent operations.

use wide::bytemuck::cast;
use wide::i64x2;

use super::legs::{Legs, both};
use crate::vector::ROUND;

/// Smallest exponent of e: e^−700 is about 1e-304, which is a normal number and 0 for every use.
const LEAST_EXPONENT: f64 = -700.0;
/// Largest argument 2|x| of tanh: from |x| = 22 on, tanh is 1 to the last bit.
const TANH_SATURATION: f64 = 44.0;

/// Factors 2^k and e^r − 1 of e^x, with x = k ln 2 + r, for |x| up to 708.
fn exp_factors(x: Legs) -> (Legs, Legs) {
    // ln 2 in two parts. The first has 33 bits, so its product with k is exact.
    const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    const BIAS: i64 = 1023;

    let shifted = x * both(std::f64::consts::LOG2_E) + both(ROUND);
    let k = shifted - both(ROUND);
    let r = (x - k * both(LN_2_HIGH)) - k * both(LN_2_LOW);
    let integer: i64x2 = cast(shifted);
    let power: Legs = cast((integer + i64x2::splat(BIAS)) << 52);

    let per = |factorial: f64| both(1.0 / factorial);
    let r2 = r * r;
    let (r4, r8) = (r2 * r2, r2 * r2 * (r2 * r2));
    let (a, b) = (both(0.5) + r * per(6.0), per(24.0) + r * per(120.0));
    let (c, d) = (per(720.0) + r * per(5_040.0), per(40_320.0) + r * per(362_880.0));
    let (e, f) = (per(3_628_800.0) + r * per(39_916_800.0), per(479_001_600.0) + r * per(6_227_020_800.0));
    let sum = (a + r2 * b) + r4 * (c + r2 * d) + r8 * (e + r2 * f);
    (power, r + r2 * sum)
}

/// Magnitude tanh |x| from the result of [`exp_factors`] for 2|x|.
fn tanh_of(power: Legs, exp_minus_one: Legs) -> Legs {
    // m = e^(2|x|) − 1, computed without cancellation.
    let m = power * exp_minus_one + (power - both(1.0));
    m / (m + both(2.0))
}

/// Hyperbolic tangent, within 4 ulp.
pub fn tanh(x: Legs) -> Legs {
    let sign = x & both(-0.0);
    let (power, exp_minus_one) = exp_factors(((x ^ sign) * both(2.0)).fast_min(both(TANH_SATURATION)));
    tanh_of(power, exp_minus_one) ^ sign
}

/// Returns exp(−bell²), within 3 ulp and the rounding of its argument, and tanh(turn), within 4 ulp. If both are saturated, as for a fast
/// joint, nothing is computed.
pub fn gaussian_and_tanh(bell: f64, turn: f64) -> [f64; 2] {
    if -bell * bell < LEAST_EXPONENT && 2.0 * turn.abs() > TANH_SATURATION {
        return [0.0, 1.0_f64.copysign(turn)];
    }
    let (power, exp_minus_one) =
        exp_factors(Legs::new([(-bell * bell).max(LEAST_EXPONENT), (2.0 * turn.abs()).min(TANH_SATURATION)]));
    let exponential = (power + power * exp_minus_one).to_array()[0];
    [exponential, tanh_of(power, exp_minus_one).to_array()[1].copysign(turn)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Arguments of all sizes, also beyond saturation.
    fn arguments() -> impl Iterator<Item = f64> {
        let fine = (0..200_000).map(|i| f64::from(i) * 1.5e-4);
        let small = (0..3000).map(|i| 1e-300 * 10f64.powf(f64::from(i) / 10.0));
        fine.chain(small).flat_map(|x| [x, -x])
    }

    #[test]
    fn tanh_agrees_with_libm() {
        let mut worst: f64 = 0.0;
        for x in arguments() {
            let [got, opposite] = tanh(Legs::new([x, -x])).to_array();
            let want = libm::tanh(x);
            assert_eq!(got, -opposite, "{x}");
            assert_eq!(gaussian_and_tanh(0.3, x)[1], got, "{x}");
            worst = worst.max((got - want).abs() / want.abs().max(f64::MIN_POSITIVE));
        }
        // The tanh of libm is within 1 ulp, at most 2.2e-16.
        assert!(worst < 8e-16, "worst relative difference {worst:e}");
        assert_eq!(tanh(Legs::new([0.0, -0.0])).to_array().map(f64::to_bits), [0.0, -0.0].map(f64::to_bits));
        assert_eq!(tanh(Legs::new([1e308, -22.1])).to_array(), [1.0, -1.0]);
    }

    #[test]
    fn the_bell_agrees_with_libm() {
        let mut worst: f64 = 0.0;
        for x in arguments().filter(|x| x.abs() < 26.0) {
            let (got, want) = (gaussian_and_tanh(x, 0.7)[0], libm::exp(-x * x));
            worst = worst.max((got - want).abs() / want);
        }
        // The bound is 3 ulp, plus one of libm.
        assert!(worst < 8e-16, "worst relative difference {worst:e}");
        assert!(gaussian_and_tanh(1e200, 0.0)[0] < 1e-300);
        assert_eq!(gaussian_and_tanh(0.0, 0.0), [1.0, 0.0]);
    }
}
