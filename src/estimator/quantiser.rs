//! What a quantised reading tells: the angle is within half a step of it. Of a normal distribution an interval leaves a part; a reading with
//! white noise that leaves the same mean and variance is used in its place (Curry, *Estimation and Control with Quantized Measurements*,
//! MIT Press 1970; Minka, *Expectation Propagation*, UAI 2001).

use std::f64::consts::{FRAC_1_PI, PI};

use super::innovation::PredictedSample;

/// Where the estimate's standard deviation is more than this many steps, an interval is a reading with white noise of Δ²/12;
const WIDEST_SIGMA: f64 = 2.0;
/// likewise where the reading is off by more steps than this: what explains it is not what was thought of.
const LARGEST_INNOVATION: f64 = 1.5;
/// An interval that the estimate lies well within tells next to nothing: its noise is at most this, in Δ²/12.
const LARGEST_VARIANCE: f64 = 1e4;
/// Intervals one after the other confine the error more than variances can say, by this factor: with bounded noise errors decrease with the
/// number of samples, not with its root.
const SUCCESSIVE_INTERVALS_FACTOR: f64 = 0.56;
/// An interval further out than so many standard deviations, of which nothing can be computed, leaves its edge.
const FARTHEST_INTERVAL: f64 = 35.0;
/// A part of the normal distribution that cannot be computed, and the least variance of one that can.
const FLOORS: [f64; 2] = [1e-300, 1e-3];

impl PredictedSample {
    /// The same of the reading that stands for an interval of `quantum`, rad, about the measured angle. The models have been told of a variance
    /// `noise`, rad², of which `white` is not the quantiser's. The error is that of `repeated` samples, which together tell no more than one;
    /// `least`, in Δ²/12, is what each of them has at the least.
    pub(super) fn with_interval(&self, quantum: f64, [noise, white]: [f64; 2], [repeated, least]: [f64; 2]) -> Self {
        let (mean, variance) = self.mixture_moments();
        let variance = variance - noise + white;
        let (sigma, rounding) = (variance.sqrt(), quantum * quantum / 12.0);
        let (mut to, mut told) = (mean, rounding);
        if sigma < WIDEST_SIGMA * quantum && mean.abs() < LARGEST_INNOVATION * quantum {
            let (shift, left) = truncated_normal((mean - quantum / 2.0) / sigma, (mean + quantum / 2.0) / sigma);
            // P⁻¹ + R⁻¹ and P⁻¹ m + R⁻¹ y of a normal distribution are those of the part that is left.
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
    // Seen from where both are tails, if they are: no digits are lost.
    let (a, b, sign) = if a + b < 0.0 { (-b, -a, -1.0) } else { (a, b, 1.0) };
    if a > FARTHEST_INTERVAL {
        return (sign * a, FLOORS[1]);
    }
    let [at_a, at_b] = [a, b].map(density);
    let part = (tail_probability(a, at_a) - tail_probability(b, at_b)).max(FLOORS[0]);
    let mean = (at_a - at_b) / part;
    let variance = 1.0 - mean * mean + (a * at_a - b * at_b) / part;
    (sign * mean, variance.clamp(FLOORS[1], 1.0))
}

/// The normal distribution's density.
fn density(x: f64) -> f64 {
    /// 1/√(2π).
    const DENSITY_AT_ZERO: f64 = 0.398_942_280_401_432_7;
    DENSITY_AT_ZERO * libm::exp(-0.5 * x * x)
}

/// What of it is above x, within 1.2 % of the smaller side, which makes narrow intervals up to 0.035 wider: with a tail that is exact single
/// runs trust their readings too much (Börjesson and Sundberg, IEEE Trans. Communications 27 (1979) 639).
fn tail_probability(x: f64, density: f64) -> f64 {
    let size = x.abs();
    let tail = density / ((1.0 - FRAC_1_PI) * size + FRAC_1_PI * (size * size + 2.0 * PI).sqrt());
    if x < 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the sum over many small intervals. The tail's error of 1.2 % counts against what lies between: a fifth at the least.
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
                // Of its largest, which may be no number.
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
