//! Uncertainty of the estimate: standard deviations, covariance of the tip, equivalent motor torques.

use nalgebra::{Matrix2, SMatrix, Vector4};

use super::belief::{Bank, Belief, Member};
use super::error_state::{FORCE, GEOMETRY};
use super::filter::Known;
use super::forecast::Forecast;
use super::hypotheses::Alternative;
use super::tangent::{Frame, LinkState, Links, Pair, wrapped};
use super::tuning::{LEAST_SIGMA, LEAST_TORQUE_DETERMINANT, MODELS};
use super::{Estimator, Machine};

/// cos² and sin² of eight angles, evenly spaced over a quarter turn.
const DIRECTIONS: [[f64; 2]; 8] = [
    [0.9903926402016152, 0.009607359798384785],
    [0.9157348061512726, 0.08426519384872737],
    [0.7777851165098011, 0.22221488349019888],
    [0.5975451610080642, 0.4024548389919359],
    [0.4024548389919359, 0.5975451610080642],
    [0.22221488349019888, 0.7777851165098011],
    [0.08426519384872737, 0.9157348061512726],
    [0.009607359798384785, 0.9903926402016152],
];
/// Upper bound of the 95 % radius, in standard deviations of the widest model along its widest axis: slightly more than √(−2 ln 0.05).
const WIDEST: f64 = 2.5;
/// Bisections of the radius: its error is 1e-9 of the upper bound.
const BISECTIONS: usize = 30;

impl Estimator {
    /// The belief about the motion, with the errors by commands that are unknown.
    pub(super) fn with_commands(&self) -> Belief {
        let mut belief = self.filter.belief;
        if let Some(covariance) = self.forecast.by_commands() {
            belief.bank.add(covariance);
        }
        belief
    }

    /// Standard deviations of the angles, rad, and rates, rad/s, of links 1 to 4 about a motion. While the assembly of the start is in
    /// doubt, both assemblies have equal weight.
    pub fn sigmas(&self, machine: &Machine, motion: &LinkState) -> [Links; 2] {
        let own = |motion: &LinkState, known: Known, forecast: Option<&Forecast>| {
            let frame = machine.linkage.frame(&motion.theta);
            let by_points = forecast.and_then(|forecast| forecast.sigmas(motion, &frame));
            let [angles, rates] = by_points.unwrap_or_else(|| sigmas(&frame, known.belief));
            let added = by_geometry(machine, (motion, &frame), known, (&frame.basis, &frame.links_by_geometry()));
            let added = mixed(&known.belief.bank, &added);
            [Links::from_fn(|i, _| (angles[i] * angles[i] + added[(i, i)]).max(0.0).sqrt()), rates]
        };
        let belief = self.with_commands();
        let known = own(motion, Known { belief: &belief, ..self.filter.known() }, Some(&self.forecast));
        let Some(other) = self.doubt.other() else { return known };
        let off = [(other.motion.theta - motion.theta).map(wrapped), other.motion.omega - motion.omega];
        let beside = own(&other.motion, Known::of(&other.belief), None);
        let of_both = |known: f64, beside: f64, off: f64| ((known * known + beside * beside + off * off) / 2.0).sqrt();
        [0, 1].map(|k| Links::from_fn(|i, _| of_both(known[k][i], beside[k][i], off[k][i])))
    }

    /// Normalised estimation error squared of angles and rates against a true motion: 4 on average for a consistent covariance.
    pub fn nees(&self, machine: &Machine, motion: &LinkState, truth: &LinkState) -> f64 {
        let frame = machine.linkage.frame(&motion.theta);
        let angles = frame.basis.tr_mul(&(truth.theta - motion.theta).map(wrapped));
        let rates = frame.basis.tr_mul(&(truth.omega - motion.omega));
        let error = Vector4::new(angles[0], angles[1], rates[0], rates[1]);
        let covariance = self.with_commands().bank.covariance().fixed_view::<4, 4>(0, 0).into_owned();
        covariance.cholesky().map_or(f64::INFINITY, |factor| error.dot(&factor.solve(&error)))
    }

    /// Covariance of the tip about the tip of a motion, m². While the assembly of the start is in doubt, both assemblies have equal weight.
    pub fn tip_covariance(&self, machine: &Machine, motion: &LinkState) -> Matrix2<f64> {
        let of_models = |motion: &LinkState, known: Known| -> Matrix2<f64> {
            tip_of_models(machine, motion, known).iter().map(|(weight, about)| about * *weight).sum()
        };
        let by_models = || of_models(motion, Known { belief: &self.with_commands(), ..self.filter.known() });
        let by_points = self.forecast.tip_covariance(motion, &machine.linkage).map(|about| {
            let frame = machine.linkage.frame(&motion.theta);
            let added = tip_by_geometry(machine, (motion, &frame), self.filter.known());
            about + mixed(&self.filter.belief.bank, &added)
        });
        // Together with learned geometry, sigma points may give a covariance that is not positive definite.
        let known = by_points.filter(|about| about.trace() > 0.0 && about.determinant() > 0.0).unwrap_or_else(by_models);
        let Some(other) = self.doubt.other() else { return known };
        let apart = tip_apart(machine, motion, &other.motion);
        (known + of_models(&other.motion, Known::of(&other.belief)) + apart * apart.transpose()) / 2.0
    }

    /// Radius of a circle about the tip, m, that contains the true tip with a probability of 95 %: the quantile of a mixture of normal
    /// distributions, one per model. While the assembly of the start is in doubt, the circle contains the tip in either assembly. The
    /// radius is at most the diameter of the tip's reach.
    pub fn tip_radius(&self, machine: &Machine, motion: &LinkState) -> f64 {
        let radius = |motion: &LinkState, known: Known| {
            let models = tip_of_models(machine, motion, known).map(|(weight, about)| {
                let (mean, half) = ((about[(0, 0)] + about[(1, 1)]) / 2.0, (about[(0, 0)] - about[(1, 1)]) / 2.0);
                let apart = (half * half + about[(0, 1)] * about[(0, 1)]).sqrt();
                (weight, Pair::new(mean + apart, (mean - apart).max(0.0)))
            });
            radius_of_95_percent(&models)
        };
        let beside = |other: &Alternative| {
            tip_apart(machine, motion, &other.motion).norm() + radius(&other.motion, Known::of(&other.belief))
        };
        let own = radius(motion, Known { belief: &self.with_commands(), ..self.filter.known() });
        own.max(self.doubt.other().map_or(0.0, beside)).min(machine.linkage.widest_reach())
    }

    /// Motor torques equivalent to the unknown force, N·m, with their standard deviations; `None` close to a direct singularity, because
    /// the motors cannot exert the force there.
    pub fn motor_torques(&self, machine: &Machine, motion: &LinkState) -> Option<([f64; 2], [f64; 2])> {
        let frame = machine.linkage.frame(&motion.theta);
        // Torques τ of the motors have the effect N_Mᵀ τ on the tangent basis.
        let effect = frame.motors().transpose();
        let inverse = effect.try_inverse().filter(|_| effect.determinant().abs() >= LEAST_TORQUE_DETERMINANT)?;
        let covariance = inverse * self.filter.belief.bank.covariance().fixed_view::<2, 2>(FORCE, FORCE) * inverse.transpose();
        let sigma = covariance.diagonal().map(|variance| variance.max(0.0).sqrt());
        Some(((inverse * self.filter.belief.tangent_force(&frame)).into(), sigma.into()))
    }
}

/// Standard deviations of the angles, rad, and rates, rad/s, of links 1 to 4 in a belief.
pub(super) fn sigmas(frame: &Frame, belief: &Belief) -> [Links; 2] {
    let covariance = belief.bank.covariance();
    [0, 2].map(|first| {
        let variances = frame.basis * covariance.fixed_view::<2, 2>(first, first) * frame.basis.transpose();
        variances.diagonal().map(|variance| variance.max(0.0).sqrt())
    })
}

/// Moments of the mixture, by the moments of each model.
fn mixed<const R: usize>(bank: &Bank, moments: &[SMatrix<f64, R, R>; MODELS]) -> SMatrix<f64, R, R> {
    moments.iter().zip(&bank.members).map(|(moments, member)| moments * member.weight).sum()
}

/// Extra second moments of a quantity due to errors of lengths and encoders, for each model. `by_error` and `by_parameters` are the
/// derivatives of the quantity with respect to errors of the motion, and to lengths and mounting angles. Lengths and mounting angles that
/// are not learned act at constant readings of the encoders, and so do the errors of the encoders' discs and scales, which are never
/// learned.
fn by_geometry<const R: usize>(
    machine: &Machine,
    (motion, frame): (&LinkState, &Frame),
    known: Known,
    (by_error, by_parameters): (&SMatrix<f64, R, 2>, &SMatrix<f64, R, GEOMETRY>),
) -> [SMatrix<f64, R, R>; MODELS] {
    let parameters = &machine.parameters;
    if known.learning.is_none() && parameters.has_exact_geometry() {
        return [SMatrix::zeros(); MODELS];
    }
    let by_encoders = by_error * frame.holding();
    let variances = Matrix2::from_diagonal(&parameters.variances_of_encoders(&motion.theta).into());
    let while_held = by_parameters + by_error * frame.held_by_geometry();
    let moved = while_held * SMatrix::from_diagonal(&machine.unlearned_geometry());
    let further = by_encoders * variances * by_encoders.transpose() + moved * moved.transpose();
    known.added_moments(by_error, [by_parameters, &while_held]).map(|added| added + further)
}

/// Extra second moments of the tip due to errors of lengths and encoders, for each model, m².
fn tip_by_geometry(machine: &Machine, at: (&LinkState, &Frame), known: Known) -> [Matrix2<f64>; MODELS] {
    let frame = at.1;
    by_geometry(machine, at, known, (&frame.tip(), &frame.tip_by_geometry()))
}

/// Probability of each model, and second moments of its tip about the tip of the motion, m².
fn tip_of_models(machine: &Machine, motion: &LinkState, known: Known) -> [(f64, Matrix2<f64>); MODELS] {
    let frame = machine.linkage.frame(&motion.theta);
    let (tip, added) = (frame.tip(), tip_by_geometry(machine, (motion, &frame), known));
    // If motors are coaxial and links of known length lie folded, the tip stays on the motor axis at any motor angle, and its variance
    // would be 0.
    let least = Matrix2::from_diagonal_element((LEAST_SIGMA * machine.linkage.length).powi(2));
    std::array::from_fn(|j| {
        let Member { weight, error, covariance } = &known.belief.bank.members[j];
        let off: Pair = tip * error.fixed_rows::<2>(0);
        (*weight, tip * covariance.fixed_view::<2, 2>(0, 0) * tip.transpose() + off * off.transpose() + added[j] + least)
    })
}

/// Vector from the tip of one motion to the tip of another, m.
fn tip_apart(machine: &Machine, from: &LinkState, to: &LinkState) -> Pair {
    machine.linkage.tip(&to.theta) - machine.linkage.tip(&from.theta)
}

/// Radius that contains 95 % of a mixture of normal distributions with one centre, m. Each model has a probability and variances along both
/// principal axes, m².
fn radius_of_95_percent(models: &[(f64, Pair)]) -> f64 {
    // Mean over directions of the whitened error; in each direction its square has an exponential distribution.
    let within = |radius: f64| -> f64 {
        let part = |(weight, variances): &(f64, Pair)| {
            let beyond = DIRECTIONS.map(|direction| {
                let variance = variances.dot(&Pair::from(direction)).max(f64::MIN_POSITIVE);
                libm::exp(-radius * radius / (2.0 * variance))
            });
            weight * (1.0 - beyond.iter().sum::<f64>() / beyond.len() as f64)
        };
        models.iter().map(part).sum()
    };
    let largest = models.iter().map(|(_, variances)| variances[0]).fold(0.0, f64::max);
    let [mut low, mut high] = [0.0, WIDEST * largest.sqrt()];
    for _ in 0..BISECTIONS {
        let middle = (low + high) / 2.0;
        if within(middle) < 0.95 {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Circles and lines have the exact radius; a loud model with a probability below 5 % hardly widens the circle.
    #[test]
    fn radii_hold_95_percent() {
        let radius = |models: &[(f64, [f64; 2])]| {
            radius_of_95_percent(&models.iter().map(|(weight, variances)| (*weight, (*variances).into())).collect::<Vec<_>>())
        };
        // Expected are quantiles of the Rayleigh, half-normal and Rayleigh distributions. The tolerances allow for the bisection, for the
        // eight directions on a line, and for the loud model.
        for (models, expected, tolerance) in [
            (&[(1.0, [4.0, 4.0])][..], 2.0 * (-2.0 * 0.05_f64.ln()).sqrt(), 1e-8),
            (&[(1.0, [1.0, 0.0])], 1.959964, 1e-3),
            (&[(0.99, [1.0, 1.0]), (0.01, [1e12, 1e12])], (-2.0 * (0.04_f64 / 0.99).ln()).sqrt(), 1e-2),
        ] {
            assert!((radius(models) / expected - 1.0).abs() < tolerance, "{models:?}: {} {expected}", radius(models));
        }
    }
}
