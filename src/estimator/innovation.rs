//! A sample against what was expected of it.

use super::bank::{Bank, Error, MODELS, Member};
use super::transition::ERRORS;

/// A sample of one encoder against what was expected of it.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    /// Measured less expected, rad.
    pub residual: f64,
    /// How the measured angle changes with the error.
    pub row: Error,
    /// Variance of the measurement, rad².
    pub noise: f64,
}

/// What the models expect of a sample.
#[derive(Clone, Copy, Debug)]
pub struct PredictedSample {
    weights: [f64; MODELS],
    /// Of each model: residual, its variance, P hᵀ.
    pub(super) each: [(f64, f64, Error); MODELS],
}

impl PredictedSample {
    /// NIS and variance of the residual, with all models together.
    pub fn nis_and_variance(&self) -> (f64, f64) {
        let (mean, variance) = self.mixture_moments();
        (mean * mean / variance, variance)
    }

    /// Mean and variance of the residual, with all models together.
    pub(super) fn mixture_moments(&self) -> (f64, f64) {
        let models = || self.weights.iter().zip(&self.each);
        let mean: f64 = models().map(|(weight, (residual, ..))| weight * residual).sum();
        let spread = |residual: f64| (residual - mean) * (residual - mean);
        let variance = models().map(|(weight, (residual, variance, _))| weight * (variance + spread(*residual))).sum();
        (mean, variance)
    }

    /// The same in units of what the model that allows for most would expect.
    pub fn nis_of_loudest_model(&self) -> f64 {
        let (residual, variance, _) = self.each[MODELS - 1];
        residual * residual / variance
    }
}

impl Bank {
    /// What each model expects of a sample.
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

/// −½ (NIS + ln of the variance).
pub fn log_likelihood(nis: f64, variance: f64) -> f64 {
    -0.5 * (nis + libm::log(variance))
}

fn along(row: &Error, x: &Error) -> f64 {
    row.iter().zip(x).map(|(a, b)| a * b).sum()
}
