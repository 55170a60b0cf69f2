//! Measurement update by a quantisation interval: the angle lies within half an interval of the reading. White noise replaces the
//! interval; it is chosen to give the mean and variance of the truncated normal distribution (Curry, *Estimation and Control with
//! Quantized Measurements*, MIT Press 1970; Minka, *Expectation Propagation*, UAI 2001).

use std::f64::consts::{FRAC_1_PI, PI};

use super::belief::Prediction;
use super::tuning::{
    FARTHEST_INTERVAL, INTERVAL_FLOORS, LARGEST_INNOVATION, LARGEST_VARIANCE, SUCCESSIVE_INTERVALS_FACTOR, WIDEST_SIGMA,
};

impl Prediction {
    /// Expected sample for a reading that stands for an interval of width `quantum`, rad, about its value.
    ///
    /// `noise`: measurement variance that the models assume, rad²; `white`: the part of it that is not due to the quantiser. `repeated`:
    /// number of samples that share one quantisation error and together carry the information of one; `least`: smallest variance of each
    /// of them, in Δ²/12.
    pub(super) fn with_interval(&self, quantum: f64, [noise, white]: [f64; 2], [repeated, least]: [f64; 2]) -> Self {
        let (mean, variance) = self.mixture_moments();
        let variance = variance - noise + white;
        let (sigma, rounding) = (variance.sqrt(), quantum * quantum / 12.0);
        let (mut to, mut told) = (mean, rounding);
        if sigma < WIDEST_SIGMA * quantum && mean.abs() < LARGEST_INNOVATION * quantum {
            let (shift, left) = truncated_normal((mean - quantum / 2.0) / sigma, (mean + quantum / 2.0) / sigma);
            // Sums of information, P⁻¹ + R⁻¹ and P⁻¹ m + R⁻¹ y, equal the sums for the truncated distribution.
            let less = 1.0 - left;
            told = if variance * left < less * LARGEST_VARIANCE * rounding {
                to = sigma * shift / less;
                SUCCESSIVE_INTERVALS_FACTOR * variance * left / less
            } else {
                LARGEST_VARIANCE * rounding
            };
        }
        let changed = (told * repeated).max(least * rounding) + white - noise;
        let mut other = *self;
        for (residual, variance, _) in &mut other.each {
            (*residual, *variance) = (*residual + to - mean, *variance + changed);
        }
        other
    }
}

/// Mean and variance of the part of a standard normal distribution between a and b.
fn truncated_normal(a: f64, b: f64) -> (f64, f64) {
    // Mirrored to the upper tail to avoid cancellation.
    let (a, b, sign) = if a + b < 0.0 { (-b, -a, -1.0) } else { (a, b, 1.0) };
    if a > FARTHEST_INTERVAL {
        return (sign * a, INTERVAL_FLOORS[1]);
    }
    let [at_a, at_b] = [a, b].map(density);
    let part = (tail_probability(a, at_a) - tail_probability(b, at_b)).max(INTERVAL_FLOORS[0]);
    let mean = (at_a - at_b) / part;
    let variance = 1.0 - mean * mean + (a * at_a - b * at_b) / part;
    (sign * mean, variance.clamp(INTERVAL_FLOORS[1], 1.0))
}

/// Density of the standard normal distribution.
fn density(x: f64) -> f64 {
    /// Density at 0: 1/√(2π).
    const DENSITY_AT_ZERO: f64 = 0.398_942_280_401_432_7;
    DENSITY_AT_ZERO * libm::exp(-0.5 * x * x)
}

/// Probability that a standard normal variable exceeds x, accurate to 1.2 % of the smaller tail. The error widens the standard deviation
/// after a narrow interval by up to 0.035 of the interval; with an exact tail the filter trusts single readings too much (Börjesson and
/// Sundberg, IEEE Trans. Communications 27 (1979) 639).
fn tail_probability(x: f64, density: f64) -> f64 {
    let size = x.abs();
    let tail = density / ((1.0 - FRAC_1_PI) * size + FRAC_1_PI * (size * size + 2.0 * PI).sqrt());
    if x < 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments equal sums over many small intervals. Tolerance: the tail's error of 1.2 % divided by the probability of an interval, which
    /// is at least a fifth.
    #[test]
    fn truncated_distributions_have_these_moments() {
        for (a, b) in [
            (-0.25, 0.25),
            (-0.5, 0.5),
            (-3.0, 1.0),
            (0.2, 2.0),
            (2.0, 5.0),
            (-6.0, -3.0),
            (-8.0, 9.0),
            (39.0, 39.5),
            (-80.0, -40.0),
        ] {
            let n = 100_000;
            let mut sums = [0.0; 3];
            for i in 0..n {
                let x: f64 = a + (b - a) * (f64::from(i) + 0.5) / f64::from(n);
                // Density relative to its largest value: the density itself may underflow.
                let nearest = 0.0_f64.clamp(a, b);
                let weight = (-0.5 * (x * x - nearest * nearest)).exp();
                sums = [sums[0] + weight, sums[1] + weight * x, sums[2] + weight * x * x];
            }
            let mean = sums[1] / sums[0];
            let variance = sums[2] / sums[0] - mean * mean;
            let (m, v) = truncated_normal(a, b);
            assert!((m - mean).abs() < 0.03 * mean.abs().max(1.0), "{a} to {b}: mean {m}, not {mean}");
            assert!((v - variance).abs() < 0.035, "{a} to {b}: variance {v}, not {variance}");
        }
    }
}
