//! Belief about a motion: the unknown force, and a bank of filters for the errors of motion and force on the tangent space at the motion.
//!
//! The bank has interacting multiple models: four filters with different process noises run in parallel, each with its own mean and
//! covariance of the errors of one common estimate, and are mixed by their likelihoods (Blom and Bar-Shalom, IEEE Trans. Automatic Control
//! 33 (1988) 780). The models differ in the random walk of the unknown force, in the intensity of a white torque, and in the errors of the
//! links' masses.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, Matrix4};

use super::error_state::{
    ERRORS, Error, FORCE, MOVING, Matrix, READINGS, Transition, bound_variances, combine, independent, is_covariance,
    isolate_force, move_covariance, move_errors, reduce, turn_covariance, turn_errors,
};
use super::flow::unit_forces;
use super::propagation::ProcessNoise;
use super::stored;
use super::tangent::{Frame, LinkState, Linkage, Links, MEASURED, Pair, wrapped};
use super::tuning::{
    CAUSE_MODEL, Intensities, LARGEST_ANGLE_VARIANCES, LARGEST_RATE, LARGEST_RATE_VARIANCE, LEAST_LIKELIHOOD, LIKELY_MODELS,
    MODELS, NEGLIGIBLE_PROBABILITY, TAKEN_AS_KNOWN,
};

/// Unknown force, and the filters for errors of force and motion. The motion is stored elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Belief {
    /// Unknown force as motor torques, N·m, and a tip force, N: the smallest inputs that have its effect.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    pub force: Links,
    /// Bank of errors of the motion and the force.
    pub bank: Bank,
}

impl Belief {
    /// No unknown force, with these variances of angles, rad², rates, rad²/s², and force, (N·m)².
    pub(super) fn new(variances: [f64; 3]) -> Self {
        Self { force: Links::zeros(), bank: Bank::new(variances) }
    }

    /// Unknown force on the tangent basis, N·m.
    pub fn tangent_force(&self, at: &Frame) -> Pair {
        on_basis(at, &self.force)
    }

    /// Injects the mean error into a motion and the force. Returns the error, the map between the tangent bases and the new frame; `None`,
    /// with nothing changed, if the loop cannot be closed or the motion would be too fast.
    pub(super) fn inject_error(
        &mut self,
        linkage: &Linkage,
        from: &Frame,
        motion: &mut LinkState,
    ) -> Option<(Error, Matrix2<f64>, Frame)> {
        let mut error = self.bank.mean();
        // Persistent errors of the encoders remain in the bank.
        error.fixed_rows_mut::<2>(READINGS).fill(0.0);
        let [a, b, c, d, ..]: [f64; ERRORS] = error.into();
        let (corrected, to) = linkage.displaced(from, motion, [a, b, c, d])?;
        if corrected.fastest() >= LARGEST_RATE {
            return None;
        }
        *motion = corrected;
        self.force = unit_forces(linkage, from) * (self.tangent_force(from) + error.fixed_rows::<2>(FORCE));
        let turn = from.basis_map_to(&to);
        self.bank.subtract_mean(&error);
        self.bank.change_basis(&turn);
        Some((error, turn, to))
    }

    /// Mean and covariance of the errors after a `change` of the force on the tangent basis, N·m. The new force has the covariance of a
    /// quiet model and no correlation with the motion.
    pub(super) fn with_force(&self, change: &Pair) -> (Error, Matrix) {
        let (mut error, mut covariance) = self.bank.moments();
        let certain = self.bank.members[CAUSE_MODEL].covariance.fixed_view::<2, 2>(FORCE, FORCE).into_owned();
        error.fixed_rows_mut::<2>(FORCE).copy_from(change);
        isolate_force(&mut covariance, &certain);
        (error, covariance)
    }

    /// Whether a stored belief about a motion is possible: closed loop, finite force, sound bank.
    pub(super) fn is_sound(&self, linkage: &Linkage, motion: &LinkState) -> bool {
        linkage.is_closed(motion) && self.force.iter().all(|x| x.is_finite()) && self.bank.is_sound()
    }
}

/// Generalised force of inputs on the tangent basis, N·m.
pub(super) fn on_basis(at: &Frame, force: &Links) -> Pair {
    at.basis.tr_mul(&(at.by_inputs() * force))
}

/// Model of the bank: probability, and error relative to the common estimate.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Member {
    /// Probability of the model.
    pub weight: f64,
    /// Mean of the error state.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    pub error: Error,
    /// Covariance of the error state.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    pub covariance: Matrix,
}

/// Bank of models for the errors of the motion and the unknown force.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Bank {
    /// One model per process noise.
    pub members: [Member; MODELS],
}

/// Innovation of one encoder sample.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    /// Measured minus expected angle, rad.
    pub residual: f64,
    /// Derivative H of the measured angle with respect to the error state, as a column.
    pub row: Error,
    /// Variance R of the measurement, rad².
    pub noise: f64,
}

impl Innovation {
    /// Innovation of an encoder's sample about a motion, by the measured angle, rad, the noise, rad², and the standard deviation of the
    /// persistent error, rad.
    pub(super) fn new(motion: &LinkState, at: &Frame, encoder: usize, angle: f64, [noise, persistent]: [f64; 2]) -> Self {
        Self { residual: wrapped(angle - motion.theta[MEASURED[encoder]]), row: at.row(encoder), noise }
            .with_persistent_error(encoder, persistent)
    }

    /// The same innovation with a persistent error of this standard deviation, rad.
    pub(super) fn with_persistent_error(mut self, encoder: usize, persistent: f64) -> Self {
        self.row[READINGS + encoder] = persistent;
        self
    }
}

/// Prediction of a sample by each model.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    pub(super) weights: [f64; MODELS],
    /// Residual, rad, its variance S = H P Hᵀ + R, rad², and P Hᵀ, for each model.
    pub(super) each: [(f64, f64, Error); MODELS],
    /// Variance of the part of the innovation that is not white, rad²; used only to compare the models.
    pub(super) lasting: f64,
}

impl Prediction {
    /// Mean, rad, and variance, rad², of the innovation in the mixture.
    pub(super) fn mixture_moments(&self) -> (f64, f64) {
        let models = || self.weights.iter().zip(&self.each);
        let mean: f64 = models().map(|(weight, (residual, ..))| weight * residual).sum();
        let spread = |residual: f64| (residual - mean) * (residual - mean);
        let variance = models().map(|(weight, (residual, variance, _))| weight * (variance + spread(*residual))).sum();
        (mean, variance)
    }

    /// Normalised innovation squared of the mixture.
    pub fn nis(&self) -> f64 {
        self.nis_with_less(0.0)
    }

    /// Normalised innovation squared of the mixture, with the noise reduced by `excess`, rad².
    pub(super) fn nis_with_less(&self, excess: f64) -> f64 {
        let (mean, variance) = self.mixture_moments();
        mean * mean / (variance - excess)
    }

    /// Normalised innovation squared of the loudest model, which has the largest process noise. `excess`, rad², reduces the noise of the
    /// sample.
    pub fn nis_of_loudest_model(&self, excess: f64) -> f64 {
        let (residual, variance, _) = self.each[MODELS - 1];
        residual * residual / (variance - excess)
    }

    /// Log-likelihood of the innovation in a normal distribution with the moments of the mixture, up to a constant.
    pub(super) fn log_likelihood(&self) -> f64 {
        log_likelihood(self.nis(), self.mixture_moments().1)
    }
}

/// Log-likelihood of an innovation up to a constant: −½ (NIS + ln of the variance).
fn log_likelihood(nis: f64, variance: f64) -> f64 {
    -0.5 * (nis + libm::log(variance))
}

impl Bank {
    /// Models of non-zero probability.
    fn active_members(&mut self) -> impl Iterator<Item = &mut Member> {
        self.members.iter_mut().filter(|member| member.weight > 0.0)
    }

    /// Transforms all errors to another tangent basis: `turn` maps angles, rates and force.
    pub fn change_basis(&mut self, turn: &Matrix2<f64>) {
        for member in self.active_members() {
            turn_errors(turn, &mut member.error);
            turn_covariance(turn, &mut member.covariance);
        }
    }

    /// Time update: mixing of the models, transition F, process noise. `scales` are the torque scale, N·m, the inertia torques, N·m, and an
    /// additional random walk of the unknown force, N·m/√s. A model persists with the probability `stay` (`persistence`); otherwise a
    /// model drawn from `priors` replaces it.
    pub fn predict(&mut self, f: &Transition, noise: &ProcessNoise, scales: [f64; 3], stay: f64, priors: &[f64; MODELS]) {
        let end = |j, member: &mut Member| bound(j, member, |_, _| ());
        self.predict_with(f, noise, (&TAKEN_AS_KNOWN, scales), (stay, priors), end);
    }

    /// Time update with the probability `stay` that a model persists; `end` runs on each model after the prediction and bounds it.
    pub(super) fn predict_with(
        &mut self,
        f: &Transition,
        noise: &ProcessNoise,
        (intensities, scales): (&Intensities, [f64; 3]),
        (stay, priors): (f64, &[f64; MODELS]),
        mut end: impl FnMut(usize, &mut Member),
    ) {
        let (mean, all) = self.moments();
        for (j, member) in self.members.iter_mut().enumerate() {
            let Mixing { weight, own, any } = Mixing::new(member.weight, stay, priors[j]);
            member.weight = weight;
            if weight == 0.0 {
                continue;
            }
            let off = (member.error - mean) * (own * any).sqrt();
            combine(&mut member.covariance, own, (any, &all), (&off, &off));
            let [white, walk] = intensities.of_model(j, scales);
            member.error = member.error * own + mean * any;
            move_errors(f, noise.kept, &mut member.error);
            move_covariance(f, noise.kept, &mut member.covariance, |moved| noise.add_to(moved, [white, walk]));
            end(j, member);
        }
    }

    /// Replaces the priors `model_prior`, which the probabilities contain, by [`LIKELY_MODELS`]. The evidence of the samples remains.
    pub(super) fn reset_priors(&mut self, model_prior: &[f64; MODELS]) {
        for (member, (prior, model_prior)) in self.members.iter_mut().zip(LIKELY_MODELS.iter().zip(model_prior)) {
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

    /// Mean error of the mixture.
    pub fn mean(&self) -> Error {
        self.members.iter().map(|member| member.error * member.weight).sum()
    }

    /// Mean and covariance of the mixture.
    pub fn moments(&self) -> (Error, Matrix) {
        let mean = self.mean();
        let mut all = Matrix::zeros();
        for Member { weight, error, covariance } in self.members.iter().filter(|member| member.weight >= NEGLIGIBLE_PROBABILITY) {
            let off = (error - mean) * weight.sqrt();
            combine(&mut all, 1.0, (*weight, covariance), (&off, &off));
        }
        (mean, all)
    }

    /// Measurement update of all models by a sample, with gain K = P Hᵀ/S, and of their probabilities by the likelihoods.
    pub fn update(&mut self, expected: &Prediction) {
        let mut likelihood = [f64::NEG_INFINITY; MODELS];
        for ((member, (residual, variance, column)), likelihood) in self.members.iter_mut().zip(&expected.each).zip(&mut likelihood)
        {
            if member.weight == 0.0 {
                continue;
            }
            let compared = variance + expected.lasting;
            *likelihood = log_likelihood(residual * residual / compared, compared);
            member.error += column * (residual / variance);
            reduce(&mut member.covariance, column, *variance);
        }
        let largest = likelihood.into_iter().fold(f64::NEG_INFINITY, f64::max);
        for (member, likelihood) in self.members.iter_mut().zip(likelihood) {
            member.weight *= libm::exp(likelihood - largest).max(LEAST_LIKELIHOOD);
        }
        self.normalise();
    }

    /// Subtracts from the mean errors the part `by` that has been added to the common estimate.
    pub fn subtract_mean(&mut self, by: &Error) {
        for member in &mut self.members {
            member.error -= by;
        }
    }

    /// Whether probabilities sum up to 1 and covariances are symmetric and positive.
    pub(super) fn is_sound(&self) -> bool {
        let sum: f64 = self.members.iter().map(|member| member.weight).sum();
        (sum - 1.0).abs() < 1e-9
            && self.members.iter().all(|Member { weight, error, covariance }| {
                *weight >= 0.0 && error.iter().all(|x| x.is_finite()) && is_covariance(covariance)
            })
    }

    /// Bank with prior probabilities, zero mean, and these variances of angles, rad², rates, rad²/s², and force, (N·m)².
    pub fn new(variances: [f64; 3]) -> Self {
        let covariance = independent(variances);
        Self { members: LIKELY_MODELS.map(|weight| Member { weight, error: Error::zeros(), covariance }) }
    }

    /// Transforms all errors on the tangent basis by a matrix F: means to F e, covariances to F P Fᵀ.
    pub fn transform(&mut self, f: &Transition) {
        for member in self.active_members() {
            move_errors(f, 1.0, &mut member.error);
            move_covariance(f, 1.0, &mut member.covariance, |_| ());
        }
    }

    /// Inflates the variances of angles, rad², rates, rad²/s², and force, (N·m)².
    pub fn inflate(&mut self, variances: [f64; 3]) {
        for member in &mut self.members {
            for i in 0..MOVING {
                member.covariance[(i, i)] += variances[i / 2];
            }
        }
    }

    /// Adds a covariance of angles and rates to all models.
    pub(super) fn add(&mut self, covariance: &Matrix4<f64>) {
        for member in self.active_members() {
            let mut motion = member.covariance.fixed_view_mut::<4, 4>(0, 0);
            motion += covariance;
        }
    }

    /// Bank with these probabilities, and with the moments of this mixture in all models.
    pub fn with_priors(&self, priors: [f64; MODELS]) -> Self {
        let (error, covariance) = self.moments();
        Self { members: priors.map(|weight| Member { weight, error, covariance }) }
    }

    /// Bank in which the force has zero mean error, this variance, (N·m)², and no correlation with the motion.
    pub fn with_force(&self, variance: f64) -> Self {
        let mut bank = *self;
        for Member { error, covariance, .. } in &mut bank.members {
            error.fixed_rows_mut::<2>(FORCE).fill(0.0);
            isolate_force(covariance, &Matrix2::from_diagonal_element(variance));
        }
        bank
    }

    /// Expected variance rate of the unknown force at the present probabilities, 1/s, relative to the squared torque scale.
    pub fn walk(&self) -> f64 {
        self.members.iter().zip(TAKEN_AS_KNOWN.force_walk).map(|(member, walk)| member.weight * walk).sum()
    }

    /// Second moments of the error about the estimate, including its mean.
    pub fn covariance(&self) -> Matrix {
        let (mean, covariance) = self.moments();
        covariance + mean * mean.transpose()
    }

    /// Covariance of the force about zero error, (N·m)²: a block of [`Self::covariance`], computed alone to save 1,700 instructions per
    /// sample.
    pub fn force_covariance(&self) -> Matrix2<f64> {
        self.members
            .iter()
            .map(|Member { weight, error, covariance }| {
                let force: Pair = error.fixed_rows::<2>(FORCE).into();
                (covariance.fixed_view::<2, 2>(FORCE, FORCE) + force * force.transpose()) * *weight
            })
            .sum()
    }

    /// Prediction of a sample by each model.
    pub fn prediction(&self, sample: &Innovation) -> Prediction {
        let each = self.members.each_ref().map(|Member { weight, error, covariance }| {
            if *weight == 0.0 {
                return (0.0, 1.0, Error::zeros());
            }
            let column = covariance * sample.row;
            (sample.residual - sample.row.dot(error), sample.row.dot(&column) + sample.noise, column)
        });
        Prediction { weights: self.members.map(|member| member.weight), each, lasting: 0.0 }
    }
}

/// Shares of a model's own moments and of the mixture's moments in a time update.
#[derive(Clone, Copy)]
pub(super) struct Mixing {
    /// Probability.
    pub(super) weight: f64,
    /// Share of the model's own moments.
    pub(super) own: f64,
    /// Share of the mixture's moments.
    pub(super) any: f64,
}

impl Mixing {
    /// Shares of a model of this probability: either it persists, or any model switches to it. If its new probability is 0, the shares are
    /// NaN.
    pub(super) fn new(weight: f64, stay: f64, prior: f64) -> Self {
        let (own, any) = (weight * stay, (1.0 - stay) * prior);
        let weight = own + any;
        Self { weight, own: own / weight, any: any / weight }
    }
}

/// Probability that a model persists for h seconds if it lasts for `switch_time`, s, on average.
pub(super) fn persistence(h: f64, switch_time: f64) -> f64 {
    libm::exp(-h / switch_time)
}

impl Intensities {
    /// Process noise of model j: spectral density of the white torque, (N·m)²·s, and variance rate of the unknown force, (N·m)²/s. `scale`:
    /// torque scale, N·m; `inertia`: inertia torques, N·m; `further`: additional random walk of the force, N·m/√s.
    pub(super) fn of_model(&self, j: usize, [scale, inertia, further]: [f64; 3]) -> [f64; 2] {
        let walk = scale * scale * self.force_walk[j] + inertia * inertia * self.mass_walk[j] + further * further;
        [scale * scale * self.white_torque[j], walk]
    }
}

/// Bounds the errors of model j and their variances; `also` as in [`bound_variances`].
pub(super) fn bound(j: usize, Member { error, covariance, .. }: &mut Member, also: impl FnMut(usize, f64)) {
    let largest = [LARGEST_ANGLE_VARIANCES[j], LARGEST_RATE_VARIANCE];
    for i in 0..FORCE {
        let most = largest[i / 2].sqrt();
        error[i] = error[i].clamp(-most, most);
    }
    bound_variances(covariance, largest, also);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::tuning::{BY_INTERVALS, BY_NOISE};

    /// With the priors reset, a bank without samples has the probabilities [`LIKELY_MODELS`]; evidence of samples remains; probabilities of
    /// 0 remain 0.
    #[test]
    fn forecasts_are_of_what_is_likely() {
        let weights = |priors: [f64; MODELS], model_prior: &[f64; MODELS]| {
            let mut bank = Bank::new([1.0; 3]).with_priors(priors);
            bank.reset_priors(model_prior);
            assert!(bank.is_sound());
            bank.members.map(|member| member.weight)
        };
        for model_prior in [LIKELY_MODELS, BY_NOISE, BY_INTERVALS] {
            let weights = weights(model_prior, &model_prior);
            // Tolerance: round-off.
            assert!((0..MODELS).all(|i| (weights[i] - LIKELY_MODELS[i]).abs() <= 1e-15), "{weights:?}");
        }
        // Odds of 3 to 2 under priors of 3 to 1.
        let [_, _, third, fourth] = weights([0.0, 0.0, 0.4, 0.6], &BY_INTERVALS);
        assert!((fourth / third / (0.5 * LIKELY_MODELS[3] / LIKELY_MODELS[2]) - 1.0).abs() < 1e-14);
        assert_eq!(weights([0.0, 0.0, 0.0, 1.0], &BY_INTERVALS), [0.0, 0.0, 0.0, 1.0]);
    }
}
