//! Interacting multiple models: four process noises side by side, each with its own error about one mean, mixed by how well each tells
//! the samples (Blom and Bar-Shalom, IEEE Trans. Automatic Control 33 (1988) 780).
//!
//! The error has six elements: angles and rates on the tangent basis N, and the unknown force on the same basis. What the models differ in
//! is how fast the unknown force may change, and how much white torque there is.

use borsh::{BorshDeserialize, BorshSerialize};

use super::linkage::{Frame, Linkage, Pair};
use super::process_noise::ProcessNoise;
use super::transition::{ERRORS, Flow};

/// Number of models.
pub const MODELS: usize = 4;

/// An error.
pub type Error = [f64; ERRORS];
/// A covariance or a transition.
pub type Matrix = [Error; ERRORS];

/// Squared change of the unknown force per second, in units of the squared torque scale.
const FORCE_WALK: [f64; MODELS] = [4e-4, 0.04, 4.0, 4000.0];
/// White torque on every link, s, in units of the squared torque scale.
const WHITE_TORQUE: [f64; MODELS] = [4e-7, 4e-7, 4e-5, 4e-3];
/// What a model that is left is followed by.
const PRIOR: [f64; MODELS] = [0.45, 0.45, 0.095, 0.005];
/// A model never becomes less likely than this in one sample.
const LEAST_LIKELIHOOD: f64 = 1e-12;
/// Variances that say that nothing is known, rad² and rad²/s².
const UNKNOWN: [f64; 2] = [0.3, 1e4];
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

/// F P Fᵀ, symmetric to the bit.
#[inline(never)]
pub fn sandwich(f: &Matrix, p: &Matrix) -> Matrix {
    let mut half = [[0.0; ERRORS]; ERRORS];
    for i in 0..ERRORS {
        for k in 0..ERRORS {
            let factor = f[i][k];
            for j in 0..ERRORS {
                half[i][j] += factor * p[k][j];
            }
        }
    }
    let mut product = [[0.0; ERRORS]; ERRORS];
    for i in 0..ERRORS {
        for j in 0..=i {
            let sum: f64 = (0..ERRORS).map(|k| half[i][k] * f[j][k]).sum();
            product[i][j] = sum;
            product[j][i] = sum;
        }
    }
    product
}

fn apply(f: &Matrix, x: &Error) -> Error {
    std::array::from_fn(|i| (0..ERRORS).map(|k| f[i][k] * x[k]).sum())
}

/// The transition of the errors from one tangent space to another: what the flow makes of angles and rates, and the turned basis of the
/// unknown force.
#[inline(never)]
pub fn transition(from: &Frame, to: &Frame, flow: &Flow) -> Matrix {
    let mut f = [[0.0; ERRORS]; ERRORS];
    for k in 0..ERRORS {
        let (turned, quickened) = flow.column(k);
        let (angles, rates) = (to.coordinates(&turned), to.coordinates(&quickened));
        for i in 0..2 {
            f[i][k] = angles[i];
            f[2 + i][k] = rates[i];
        }
    }
    turn_force(&mut f, from.carried_to(to));
    f
}

/// The same in a time in which nothing can be said of the forces: angles follow the rates.
#[inline(never)]
pub fn straight(from: &Frame, to: &Frame, h: f64) -> Matrix {
    let turned = from.carried_to(to);
    let mut f = [[0.0; ERRORS]; ERRORS];
    for i in 0..2 {
        for k in 0..2 {
            f[i][k] = turned[i][k];
            f[2 + i][2 + k] = turned[i][k];
            f[i][2 + k] = h * turned[i][k];
        }
    }
    turn_force(&mut f, turned);
    f
}

fn turn_force(f: &mut Matrix, turned: [Pair; 2]) {
    for i in 0..2 {
        for k in 0..2 {
            f[4 + i][4 + k] = turned[i][k];
        }
    }
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
    pub fn carry(&mut self, f: &Matrix) {
        for member in &mut self.members {
            member.error = apply(f, &member.error);
            member.covariance = sandwich(f, &member.covariance);
        }
    }

    /// Mixes the models as they may have changed in h seconds, moves them, and adds what each expects of the process. `switch_time`, s, is
    /// how long a model stays.
    #[inline(never)]
    pub fn predict(&mut self, linkage: &Linkage, (at, f): (&Frame, &Matrix), scale: f64, (h, switch_time): (f64, f64)) {
        let stay = libm::exp(-h / switch_time);
        let before = self.members;
        let noise = ProcessNoise::new(linkage, at, h);
        for (j, member) in self.members.iter_mut().enumerate() {
            let mut shares: [f64; MODELS] =
                std::array::from_fn(|i| before[i].weight * (if i == j { stay } else { 0.0 } + (1.0 - stay) * PRIOR[j]));
            let weight: f64 = shares.iter().sum();
            shares = shares.map(|share| share / weight);
            let (error, covariance) = mixture(&before, &shares);
            *member = Member { weight, error: apply(f, &error), covariance: sandwich(f, &covariance) };
            let (white, walk) = (scale * scale * WHITE_TORQUE[j], scale * scale * FORCE_WALK[j]);
            for i in 0..ERRORS {
                for k in 0..ERRORS {
                    member.covariance[i][k] += white * noise.white[i][k] + walk * noise.walk[i][k];
                }
            }
            bound(&mut member.covariance);
        }
    }

    /// The motion may be another one, by these variances of angles and rates; what is known of the forces stays.
    pub fn unsettle(&mut self, variances: Pair) {
        for member in &mut self.members {
            for i in 0..4 {
                member.covariance[i][i] += variances[i / 2];
            }
        }
    }

    /// The same where next to nothing is known of the force but its variance, and which model holds.
    #[cold]
    pub fn with_force(&self, variance: f64) -> Self {
        let mut bank = *self;
        for (member, weight) in bank.members.iter_mut().zip(PRIOR) {
            member.weight = weight;
            for i in 4..ERRORS {
                member.error[i] = 0.0;
                member.covariance[i] = [0.0; ERRORS];
                member.covariance.iter_mut().for_each(|row| row[i] = 0.0);
                member.covariance[i][i] = variance;
            }
        }
        bank
    }

    /// The force may be another one, by this variance.
    pub fn unsettle_force(&mut self, variance: f64) {
        for member in &mut self.members {
            for i in 4..ERRORS {
                member.covariance[i][i] += variance;
            }
        }
    }

    /// By how much the unknown force's variance grows while the models stay as likely as they are, in the squared units of `scale` per second.
    pub fn walk(&self, scale: f64) -> f64 {
        scale * scale * self.members.iter().zip(FORCE_WALK).map(|(member, walk)| member.weight * walk).sum::<f64>()
    }

    /// Mean and covariance of all models together.
    #[inline(never)]
    pub fn moments(&self) -> (Error, Matrix) {
        mixture(&self.members, &self.members.map(|member| member.weight))
    }

    /// What a sample would say: NIS and variance of the residual, with all models together.
    #[inline(never)]
    pub fn surprise(&self, sample: &Innovation) -> (f64, f64) {
        let (error, covariance) = self.moments();
        let (_, variance) = projected(&covariance, sample);
        let residual = sample.residual - along(&sample.row, &error);
        (residual * residual / variance, variance)
    }

    /// The residual in units of what the model that allows for most would expect.
    pub fn least_surprise(&self, sample: &Innovation) -> f64 {
        let wildest = &self.members[MODELS - 1];
        let (_, variance) = projected(&wildest.covariance, sample);
        let residual = sample.residual - along(&sample.row, &wildest.error);
        residual * residual / variance
    }

    /// Corrects all models by a sample, and their weights by how likely each had made it.
    #[inline(never)]
    pub fn update(&mut self, sample: &Innovation) {
        let mut likelihood = [0.0; MODELS];
        for (member, likelihood) in self.members.iter_mut().zip(&mut likelihood) {
            let (column, variance) = projected(&member.covariance, sample);
            let residual = sample.residual - along(&sample.row, &member.error);
            *likelihood = -0.5 * (residual * residual / variance + libm::log(variance));
            for i in 0..ERRORS {
                member.error[i] += column[i] * (residual / variance);
                for k in 0..=i {
                    let less = member.covariance[i][k] - column[i] * column[k] / variance;
                    member.covariance[i][k] = less;
                    member.covariance[k][i] = less;
                }
                // What the sample tells cannot be more than everything, but for round-off.
                let own = &mut member.covariance[i][i];
                *own = own.max(f64::EPSILON * column[i] * column[i] / variance);
            }
        }
        let largest = likelihood.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let mut sum = 0.0;
        for (member, likelihood) in self.members.iter_mut().zip(likelihood) {
            member.weight *= libm::exp(likelihood - largest).max(LEAST_LIKELIHOOD);
            sum += member.weight;
        }
        for member in &mut self.members {
            member.weight /= sum;
        }
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
    pub fn recentre(&mut self, by: &Error) {
        for member in &mut self.members {
            for (error, by) in member.error.iter_mut().zip(by) {
                *error -= by;
            }
        }
    }
}

/// Mean and covariance of members with shares that sum up to 1.
#[inline(never)]
fn mixture(members: &[Member; MODELS], shares: &[f64; MODELS]) -> (Error, Matrix) {
    let mean: Error = std::array::from_fn(|i| members.iter().zip(shares).map(|(member, share)| share * member.error[i]).sum());
    let mut covariance = [[0.0; ERRORS]; ERRORS];
    for (member, share) in members.iter().zip(shares) {
        if *share < NEGLIGIBLE {
            continue;
        }
        let off: Error = std::array::from_fn(|i| member.error[i] - mean[i]);
        for i in 0..ERRORS {
            for k in 0..ERRORS {
                covariance[i][k] += share * (member.covariance[i][k] + off[i] * off[k]);
            }
        }
    }
    (mean, covariance)
}

/// P hᵀ, and h P hᵀ + R.
#[inline(never)]
fn projected(covariance: &Matrix, sample: &Innovation) -> (Error, f64) {
    let column: Error = std::array::from_fn(|i| along(&sample.row, &covariance[i]));
    (column, along(&sample.row, &column) + sample.noise)
}

fn along(row: &Error, x: &Error) -> f64 {
    row.iter().zip(x).map(|(a, b)| a * b).sum()
}

/// Keeps a direction of which nothing is known from growing beyond sense.
#[inline(never)]
fn bound(covariance: &mut Matrix) {
    for i in 0..4 {
        let most = UNKNOWN[i / 2];
        if covariance[i][i] > most {
            let factor = (most / covariance[i][i]).sqrt();
            for k in 0..ERRORS {
                covariance[i][k] *= factor;
                covariance[k][i] *= factor;
            }
        }
    }
}
