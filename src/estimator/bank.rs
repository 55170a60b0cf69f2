//! Interacting multiple models: four process noises side by side, each with its own error about one mean, mixed by how well each tells
//! the samples (Blom and Bar-Shalom, IEEE Trans. Automatic Control 33 (1988) 780).
//!
//! The error has six elements: angles and rates on the tangent basis N, and the unknown force on the same basis. What the models differ in
//! is how fast the unknown force may change, and how much white torque there is.

use borsh::{BorshDeserialize, BorshSerialize};

use super::innovation::{PredictedSample, log_likelihood};
use super::linkage::{Frame, Linkage, Pair};
use super::process_noise::ProcessNoise;
use super::propagate::{FORCE, apply, propagate_covariance, turned};
use super::transition::ERRORS;

/// Number of models.
pub const MODELS: usize = 4;

/// An error.
pub type Error = [f64; ERRORS];
/// A covariance or a transition.
pub type Matrix = [Error; ERRORS];

/// Squared change of the unknown force per second, in units of the squared torque scale.
const FORCE_WALK: [f64; MODELS] = [4e-5, 0.04, 4.0, 4000.0];
/// The same in units of the squared torques that accelerate the links: masses are not known exactly, and what they are off by changes as
/// the motion does.
const MASS_WALK: [f64; MODELS] = [2e-4, 0.03, 0.0, 0.0];
/// White torque on every link, s, in units of the squared torque scale.
const WHITE_TORQUE: [f64; MODELS] = [4e-7, 4e-6, 4e-5, 4e-3];
/// How likely models are before any sample, and on motions beside the estimate what one that is left is followed by; one of 0 takes no part.
pub(super) const PRIOR: [f64; MODELS] = [0.45, 0.45, 0.095, 0.005];
/// By what it is followed on the estimate, where encoders have white noise: a sample that is far off may be noise;
pub(super) const BY_NOISE: [f64; MODELS] = [0.45, 0.45, 0.0999, 0.0001];
/// and where readings are intervals: nothing but a force takes an angle out of them, and until it does nothing tells of the force.
pub(super) const BY_INTERVALS: [f64; MODELS] = [0.3, 0.3, 0.1, 0.3];
/// A model never becomes less likely than this in one sample.
const LEAST_LIKELIHOOD: f64 = 1e-12;
/// Variances that say that nothing is known, rad² and rad²/s².
const LARGEST_VARIANCES: [f64; 2] = [0.3, 1e4];
/// Models less likely than this do not take part in a mixture.
const NEGLIGIBLE: f64 = 1e-12;

/// A model with its error about the mean.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Member {
    /// Probability.
    pub weight: f64,
    /// Mean of the error.
    pub error: Error,
    /// Covariance of the error.
    pub covariance: Matrix,
}

/// The models.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Bank {
    /// One for each process noise.
    pub members: [Member; MODELS],
}

impl Bank {
    /// Nothing known but the variances of angles, rates and forces.
    pub fn new(variances: [f64; 3]) -> Self {
        let mut covariance = [[0.0; ERRORS]; ERRORS];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = variances[i / 2];
        }
        Self { members: PRIOR.map(|weight| Member { weight, error: [0.0; ERRORS], covariance }) }
    }

    /// Moves all errors by a transition.
    #[inline(never)]
    pub fn propagate(&mut self, f: &Matrix) {
        for member in self.active_members() {
            member.error = apply(f, &member.error);
            member.covariance = propagate_covariance(f, &member.covariance);
        }
    }

    /// The same errors on another tangent basis: angles, rates and force turn alike.
    #[inline(never)]
    pub fn change_basis(&mut self, turn: &[Pair; 2]) {
        for member in self.active_members() {
            member.error = turned(turn, &member.error);
            // By the second index, then by the first.
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

    /// Those that are believed at all.
    fn active_members(&mut self) -> impl Iterator<Item = &mut Member> {
        self.members.iter_mut().filter(|member| member.weight > 0.0)
    }

    /// Mixes the models as they may have changed in h seconds, moves them, and adds what each expects of the process: in units of a torque
    /// scale, and of the torques that accelerate the links, N·m. `switch_time`, s, is how long a model stays before one of `priors` follows.
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
            // It has stayed, or any of them is left for it.
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

    /// Models that have been thought of by some priors become as likely as they are by [`PRIOR`].
    #[cold]
    pub(super) fn reset_priors(&mut self, model_prior: &[f64; MODELS]) {
        for (member, (prior, model_prior)) in self.members.iter_mut().zip(PRIOR.iter().zip(model_prior)) {
            member.weight *= prior / model_prior;
        }
        self.normalise();
    }

    /// Weights sum up to 1.
    fn normalise(&mut self) {
        let sum: f64 = self.members.iter().map(|member| member.weight).sum();
        for member in &mut self.members {
            member.weight /= sum;
        }
    }

    /// The motion may be another one, by these variances of angles and rates; what is known of the forces stays.
    pub fn inflate(&mut self, variances: Pair) {
        for member in &mut self.members {
            for i in 0..4 {
                member.covariance[i][i] += variances[i / 2];
            }
        }
    }

    /// The same error in all models, as likely as before any sample.
    #[cold]
    pub fn with_priors(&self, priors: [f64; MODELS]) -> Self {
        let (error, covariance) = self.moments();
        Self { members: priors.map(|weight| Member { weight, error, covariance }) }
    }

    /// The same where nothing is known of the force but its variance.
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

    /// The force may be another one, by this variance.
    pub fn inflate_force(&mut self, variance: f64) {
        for member in &mut self.members {
            for i in FORCE..ERRORS {
                member.covariance[i][i] += variance;
            }
        }
    }

    /// By how much the unknown force's variance grows while the models stay as likely as they are, in squared torque scales per second.
    pub fn walk(&self) -> f64 {
        self.members.iter().zip(FORCE_WALK).map(|(member, walk)| member.weight * walk).sum()
    }

    /// Mean of all models together.
    pub fn mean(&self) -> Error {
        std::array::from_fn(|i| self.members.iter().map(|member| member.weight * member.error[i]).sum())
    }

    /// Covariance of the force about the mean, (N·m)²: xx, xy, yy.
    pub fn force_covariance(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for Member { weight, error, covariance } in &self.members {
            let [.., x, y] = *error;
            let [.., [.., xx, xy], [.., yy]] = *covariance;
            sum = [sum[0] + weight * (xx + x * x), sum[1] + weight * (xy + x * y), sum[2] + weight * (yy + y * y)];
        }
        sum
    }

    /// Mean and covariance of all models together.
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

    /// Corrects all models by a sample of which they have expected that, and their weights by how likely each had made it.
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
                // What the sample tells cannot be more than everything, but for round-off.
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

    /// Whether weights sum up to 1 and covariances are symmetric and positive.
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

    /// The mean takes over some error.
    pub fn subtract_mean(&mut self, by: &Error) {
        for member in &mut self.members {
            for (error, by) in member.error.iter_mut().zip(by) {
                *error -= by;
            }
        }
    }
}

/// Keeps a direction of which nothing is known from growing beyond sense.
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

    /// What nothing has been told of is as likely as by [`PRIOR`]; what samples have told stays; what takes no part does not come back.
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
            // Round-off.
            assert!((0..MODELS).all(|i| (weights[i] - PRIOR[i]).abs() <= 1e-15), "{weights:?}");
        }
        // Odds of 3 to 2, of which the priors had 3 to 1.
        let [_, _, third, fourth] = weights([0.0, 0.0, 0.4, 0.6], &BY_INTERVALS);
        assert!((fourth / third / (0.5 * PRIOR[3] / PRIOR[2]) - 1.0).abs() < 1e-14);
        assert_eq!(weights([0.0, 0.0, 0.0, 1.0], &BY_INTERVALS), [0.0, 0.0, 0.0, 1.0]);
    }
}
