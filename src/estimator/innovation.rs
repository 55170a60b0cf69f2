//! Innovation of an encoder sample, and its expectation by the bank of models.

use super::bank::{Bank, Error, MODELS, Member};
use super::transition::ERRORS;

/// Innovation of one encoder sample.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    /// Measured minus expected angle, rad.
    pub residual: f64,
    /// Derivative of the measured angle with respect to the error state.
    pub row: Error,
    /// Variance of the measurement, rad².
    pub noise: f64,
}

/// Expectation of a sample by the models.
#[derive(Clone, Copy, Debug)]
pub struct PredictedSample {
    weights: [f64; MODELS],
    /// Residual, rad, its variance, rad², and P hᵀ, for each model.
    pub(super) each: [(f64, f64, Error); MODELS],
}

impl PredictedSample {
    /// Normalised innovation squared, and innovation variance, rad², of the mixture.
    pub fn nis_and_variance(&self) -> (f64, f64) {
        let (mean, variance) = self.mixture_moments();
        (mean * mean / variance, variance)
    }

    /// Mean, rad, and variance, rad², of the innovation in the mixture.
    pub(super) fn mixture_moments(&self) -> (f64, f64) {
        let models = || self.weights.iter().zip(&self.each);
        let mean: f64 = models().map(|(weight, (residual, ..))| weight * residual).sum();
        let spread = |residual: f64| (residual - mean) * (residual - mean);
        let variance = models().map(|(weight, (residual, variance, _))| weight * (variance + spread(*residual))).sum();
        (mean, variance)
    }

    /// Normalised innovation squared of the loudest model.
    pub fn nis_of_loudest_model(&self) -> f64 {
        let (residual, variance, _) = self.each[MODELS - 1];
        residual * residual / variance
    }
}

impl Bank {
    /// Expectation of a sample.
    #[inline(never)]
    pub fn predict_sample(&self, sample: &Innovation) -> PredictedSample {
        let each = std::array::from_fn(|i| {
            let Member { weight, error, covariance } = &self.members[i];
            if *weight == 0.0 {
                return (0.0, 1.0, [0.0; ERRORS]);
            }
            let column: Error = std::array::from_fn(|i| along(&sample.row, &covariance[i]));
            let variance = along(&sample.row, &column) + sample.noise;
            (sample.residual - along(&sample.row, error), variance, column)
        });
        PredictedSample { weights: self.members.map(|member| member.weight), each }
    }
}

/// Log-likelihood of an innovation up to a constant: −½ (NIS + ln of the variance).
pub fn log_likelihood(nis: f64, variance: f64) -> f64 {
    -0.5 * (nis + libm::log(variance))
}

fn along(row: &Error, x: &Error) -> f64 {
    row.iter().zip(x).map(|(a, b)| a * b).sum()
}
