//! Interacting multiple models: four process noises in parallel, each with its own error mean and covariance about one estimate, mixed by
//! their likelihoods (Blom and Bar-Shalom, IEEE Trans. Automatic Control 33 (1988) 780).
//!
//! The error state has six elements: angles and rates on the tangent basis N, and the unknown force on the same basis. The models differ in
//! the random walk of the unknown force, in the intensity of a white torque, and in the errors of the links' masses.

use borsh::{BorshDeserialize, BorshSerialize};

use super::innovation::{PredictedSample, log_likelihood};
use super::linkage::{Frame, Linkage, Pair};
use super::process_noise::ProcessNoise;
use super::propagate::{FORCE, apply, propagate_covariance, turned};
use super::transition::ERRORS;

/// Number of models.
pub const MODELS: usize = 4;

/// Error state: two angles, rad, two rates, rad/s, two components of the unknown force, N·m.
pub type Error = [f64; ERRORS];
/// Covariance or transition matrix of the error state.
pub type Matrix = [Error; ERRORS];

/// Process noise: variance rate of the unknown force in each model, 1/s, relative to the squared torque scale. Factors of 100 to 1000
/// cover a constant disturbance to an impact.
const FORCE_WALK: [f64; MODELS] = [4e-5, 0.04, 4.0, 4000.0];
/// Process noise: variance rate of the unknown force by errors of masses, 1/s, relative to the squared inertia torques. Quiet models alone
/// have it: its effect drowns in the force walk of the others.
const MASS_WALK: [f64; MODELS] = [2e-4, 0.03, 0.0, 0.0];
/// Process noise: spectral density of a white torque on every link, s, relative to the squared torque scale.
const WHITE_TORQUE: [f64; MODELS] = [4e-7, 4e-6, 4e-5, 4e-3];
/// Prior probabilities of the models before any sample, and for switching in hypotheses beside the estimate. A model of probability 0 takes
/// no part.
pub(super) const PRIOR: [f64; MODELS] = [0.45, 0.45, 0.095, 0.005];
/// Prior probabilities for switching in the estimate under white encoder noise: the loudest is rare, because a large innovation may be
/// noise.
pub(super) const BY_NOISE: [f64; MODELS] = [0.45, 0.45, 0.0999, 0.0001];
/// Prior probabilities for switching in the estimate under quantisation intervals: the loudest is frequent, because only a force moves an
/// angle out of an interval, and nothing announces it.
pub(super) const BY_INTERVALS: [f64; MODELS] = [0.3, 0.3, 0.1, 0.3];
/// Smallest likelihood ratio of a model in one sample: keeps a model recoverable after an outlier.
const LEAST_LIKELIHOOD: f64 = 1e-12;
/// Largest variances of angles, rad², and rates, rad²/s²: beyond these nothing is known.
const LARGEST_VARIANCES: [f64; 2] = [0.3, 1e4];
/// Probability below which a model is left out of the moments of the mixture, whose digits it does not reach.
const NEGLIGIBLE: f64 = 1e-12;

/// Model of the bank: probability, and error relative to the common estimate.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Member {
    /// Probability of the model.
    pub weight: f64,
    /// Mean of the error state.
    pub error: Error,
    /// Covariance of the error state.
    pub covariance: Matrix,
}

/// Bank of models.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Bank {
    /// One model per process noise.
    pub members: [Member; MODELS],
}

impl Bank {
    /// Bank with prior probabilities, zero mean, and these variances of angles, rad², rates, rad²/s², and force, (N·m)².
    pub fn new(variances: [f64; 3]) -> Self {
        let mut covariance = [[0.0; ERRORS]; ERRORS];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = variances[i / 2];
        }
        Self { members: PRIOR.map(|weight| Member { weight, error: [0.0; ERRORS], covariance }) }
    }

    /// Propagates all errors by a transition matrix.
    #[inline(never)]
    pub fn propagate(&mut self, f: &Matrix) {
        for member in self.active_members() {
            member.error = apply(f, &member.error);
            member.covariance = propagate_covariance(f, &member.covariance);
        }
    }

    /// Transforms all errors to another tangent basis: angles, rates and force turn alike.
    #[inline(never)]
    pub fn change_basis(&mut self, turn: &[Pair; 2]) {
        for member in self.active_members() {
            member.error = turned(turn, &member.error);
            // Transform of the second index, then of the first.
            let half = member.covariance.map(|row| turned(turn, &row));
            let p = &mut member.covariance;
            for first in (0..ERRORS).step_by(2) {
                for (i, row) in turn.iter().enumerate() {
                    for k in 0..=first + i {
                        p[first + i][k] = row[0] * half[first][k] + row[1] * half[first + 1][k];
                        p[k][first + i] = p[first + i][k];
                    }
                }
            }
        }
    }

    /// Models of non-zero probability.
    fn active_members(&mut self) -> impl Iterator<Item = &mut Member> {
        self.members.iter_mut().filter(|member| member.weight > 0.0)
    }

    /// Time update by h seconds: mixing of the models, propagation, process noise. The scales are the torque scale and the inertia torques,
    /// N·m. A model persists for `switch_time`, s, before one drawn from `priors` replaces it.
    #[inline(never)]
    pub fn predict(
        &mut self,
        linkage: &Linkage,
        (at, f): (&Frame, &Matrix),
        [scale, accelerates]: Pair,
        (h, switch_time): (f64, f64),
        priors: &[f64; MODELS],
    ) {
        let stay = libm::exp(-h / switch_time);
        let (mean, all) = self.moments();
        let noise = ProcessNoise::new(linkage, at, h);
        for (j, member) in self.members.iter_mut().enumerate() {
            // Mixing weights: the model has persisted, or any model has switched to it.
            let (own, any) = (member.weight * stay, (1.0 - stay) * priors[j]);
            member.weight = own + any;
            if member.weight == 0.0 {
                continue;
            }
            let (own, any) = (own / member.weight, any / member.weight);
            let white = scale * scale * WHITE_TORQUE[j];
            let walk = scale * scale * FORCE_WALK[j] + accelerates * accelerates * MASS_WALK[j];
            let off: Error = std::array::from_fn(|i| member.error[i] - mean[i]);
            let error: Error = std::array::from_fn(|i| own * member.error[i] + any * mean[i]);
            for i in 0..ERRORS {
                for k in 0..ERRORS {
                    let apart = off[i] * off[k];
                    member.covariance[i][k] = own * (member.covariance[i][k] + any * apart) + any * all[i][k];
                }
            }
            (member.error, member.covariance) = (apply(f, &error), propagate_covariance(f, &member.covariance));
            for i in 0..ERRORS {
                for k in 0..ERRORS {
                    member.covariance[i][k] += white * noise.white[i][k] + walk * noise.walk[i][k];
                }
            }
            bound(&mut member.covariance);
        }
    }

    /// Replaces the priors `model_prior`, by which probabilities have evolved, by [`PRIOR`]; evidence of samples stays.
    #[cold]
    pub(super) fn reset_priors(&mut self, model_prior: &[f64; MODELS]) {
        for (member, (prior, model_prior)) in self.members.iter_mut().zip(PRIOR.iter().zip(model_prior)) {
            member.weight *= prior / model_prior;
        }
        self.normalise();
    }

    /// Normalises the probabilities to sum 1.
    fn normalise(&mut self) {
        let sum: f64 = self.members.iter().map(|member| member.weight).sum();
        for member in &mut self.members {
            member.weight /= sum;
        }
    }

    /// Inflates the variances of angles, rad², and rates, rad²/s²; those of the force stay.
    pub fn inflate(&mut self, variances: Pair) {
        for member in &mut self.members {
            for i in 0..4 {
                member.covariance[i][i] += variances[i / 2];
            }
        }
    }

    /// Bank with the moments of this one in all models, and these probabilities.
    #[cold]
    pub fn with_priors(&self, priors: [f64; MODELS]) -> Self {
        let (error, covariance) = self.moments();
        Self { members: priors.map(|weight| Member { weight, error, covariance }) }
    }

    /// Bank with zero mean of the force, of this variance, (N·m)², and uncorrelated with the motion.
    #[cold]
    pub fn with_force(&self, variance: f64) -> Self {
        let mut bank = *self;
        for member in &mut bank.members {
            for i in FORCE..ERRORS {
                member.error[i] = 0.0;
                member.covariance[i] = [0.0; ERRORS];
                member.covariance.iter_mut().for_each(|row| row[i] = 0.0);
                member.covariance[i][i] = variance;
            }
        }
        bank
    }

    /// Inflates the variance of the force by `variance`, (N·m)².
    pub fn inflate_force(&mut self, variance: f64) {
        for member in &mut self.members {
            for i in FORCE..ERRORS {
                member.covariance[i][i] += variance;
            }
        }
    }

    /// Expected variance rate of the unknown force at the present probabilities, 1/s, relative to the squared torque scale.
    pub fn walk(&self) -> f64 {
        self.members.iter().zip(FORCE_WALK).map(|(member, walk)| member.weight * walk).sum()
    }

    /// Mean error of the mixture.
    pub fn mean(&self) -> Error {
        std::array::from_fn(|i| self.members.iter().map(|member| member.weight * member.error[i]).sum())
    }

    /// Covariance of the force about zero error, (N·m)²: xx, xy, yy.
    pub fn force_covariance(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for Member { weight, error, covariance } in &self.members {
            let [.., x, y] = *error;
            let [.., [.., xx, xy], [.., yy]] = *covariance;
            sum = [sum[0] + weight * (xx + x * x), sum[1] + weight * (xy + x * y), sum[2] + weight * (yy + y * y)];
        }
        sum
    }

    /// Mean and covariance of the mixture.
    #[inline(never)]
    pub fn moments(&self) -> (Error, Matrix) {
        let mean = self.mean();
        let mut covariance = [[0.0; ERRORS]; ERRORS];
        for member in self.members.iter().filter(|member| member.weight >= NEGLIGIBLE) {
            let off: Error = std::array::from_fn(|i| member.error[i] - mean[i]);
            for i in 0..ERRORS {
                for k in 0..ERRORS {
                    covariance[i][k] += member.weight * (member.covariance[i][k] + off[i] * off[k]);
                }
            }
        }
        (mean, covariance)
    }

    /// Measurement update of all models by a sample; their probabilities change by the likelihoods.
    #[inline(never)]
    pub fn update(&mut self, expected: &PredictedSample) {
        let mut likelihood = [f64::NEG_INFINITY; MODELS];
        for ((member, (residual, variance, column)), likelihood) in self.members.iter_mut().zip(&expected.each).zip(&mut likelihood)
        {
            if member.weight == 0.0 {
                continue;
            }
            *likelihood = log_likelihood(residual * residual / variance, *variance);
            let gain = column.map(|element| element / variance);
            for i in 0..ERRORS {
                member.error[i] += gain[i] * residual;
                for k in 0..=i {
                    let less = member.covariance[i][k] - gain[i] * column[k];
                    member.covariance[i][k] = less;
                    member.covariance[k][i] = less;
                }
                // A variance may turn negative by round-off only.
                let own = &mut member.covariance[i][i];
                *own = own.max(f64::EPSILON * gain[i] * column[i]);
            }
        }
        let largest = likelihood.into_iter().fold(f64::NEG_INFINITY, f64::max);
        for (member, likelihood) in self.members.iter_mut().zip(likelihood) {
            member.weight *= libm::exp(likelihood - largest).max(LEAST_LIKELIHOOD);
        }
        self.normalise();
    }

    /// Whether probabilities sum up to 1 and covariances are symmetric and positive.
    #[cold]
    pub(super) fn is_sound(&self) -> bool {
        let sum: f64 = self.members.iter().map(|member| member.weight).sum();
        (sum - 1.0).abs() < 1e-9
            && self.members.iter().all(|member| {
                let p = &member.covariance;
                member.weight >= 0.0
                    && member.error.iter().all(|x| x.is_finite())
                    && (0..ERRORS).all(|i| {
                        p[i][i] >= 0.0
                            && (0..i)
                                .all(|k| p[i][k].to_bits() == p[k][i].to_bits() && p[i][k] * p[i][k] <= 1.01 * p[i][i] * p[k][k])
                    })
            })
    }

    /// Moves the common estimate by `by`: the mean errors become smaller by as much.
    pub fn subtract_mean(&mut self, by: &Error) {
        for member in &mut self.members {
            for (error, by) in member.error.iter_mut().zip(by) {
                *error -= by;
            }
        }
    }
}

/// Bounds the variances of unobserved directions.
#[inline(never)]
fn bound(covariance: &mut Matrix) {
    for i in 0..4 {
        let most = LARGEST_VARIANCES[i / 2];
        if covariance[i][i] > most {
            let factor = (most / covariance[i][i]).sqrt();
            for k in 0..ERRORS {
                covariance[i][k] *= factor;
                covariance[k][i] *= factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without samples the probabilities become [`PRIOR`]; evidence of samples stays; models of probability 0 stay out.
    #[test]
    fn forecasts_are_of_what_is_likely() {
        let weights = |priors: [f64; MODELS], model_prior: &[f64; MODELS]| {
            let mut bank = Bank::new([1.0; 3]).with_priors(priors);
            bank.reset_priors(model_prior);
            assert!(bank.is_sound());
            bank.members.map(|member| member.weight)
        };
        for model_prior in [PRIOR, BY_NOISE, BY_INTERVALS] {
            let weights = weights(model_prior, &model_prior);
            // Tolerance: round-off.
            assert!((0..MODELS).all(|i| (weights[i] - PRIOR[i]).abs() <= 1e-15), "{weights:?}");
        }
        // Odds of 3 to 2 under priors of 3 to 1.
        let [_, _, third, fourth] = weights([0.0, 0.0, 0.4, 0.6], &BY_INTERVALS);
        assert!((fourth / third / (0.5 * PRIOR[3] / PRIOR[2]) - 1.0).abs() < 1e-14);
        assert_eq!(weights([0.0, 0.0, 0.0, 1.0], &BY_INTERVALS), [0.0, 0.0, 0.0, 1.0]);
    }
}
