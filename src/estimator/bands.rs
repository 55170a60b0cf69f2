//! Uncertainty of the estimate: standard deviations, covariance of the tip, equivalent motor torques.

use nalgebra::{Matrix2, Vector4};

use super::bank::FORCE;
use super::constants::LEAST_TORQUE_DETERMINANT;
use super::tangent::{LinkState, Links, wrapped};
use super::{Constants, Estimator};

impl Estimator {
    /// Standard deviations of the angles, rad, and rates, rad/s, of links 1 to 4 about a motion.
    pub fn sigmas(&self, constants: &Constants, motion: &LinkState) -> [Links; 2] {
        if let Some(sigmas) = self.forecast.sigmas(motion) {
            return sigmas;
        }
        let (frame, covariance) = (constants.linkage.frame(&motion.theta), self.belief.bank.covariance());
        [0, 2].map(|first| {
            let variances = frame.basis * covariance.fixed_view::<2, 2>(first, first) * frame.basis.transpose();
            variances.diagonal().map(|variance| variance.max(0.0).sqrt())
        })
    }

    /// Normalised estimation error squared of angles and rates against a true motion: 4 on average for a consistent covariance.
    pub fn nees(&self, constants: &Constants, motion: &LinkState, truth: &LinkState) -> f64 {
        let frame = constants.linkage.frame(&motion.theta);
        let angles = frame.basis.tr_mul(&(truth.theta - motion.theta).map(wrapped));
        let rates = frame.basis.tr_mul(&(truth.omega - motion.omega));
        let error = Vector4::new(angles[0], angles[1], rates[0], rates[1]);
        let covariance = self.belief.bank.covariance().fixed_view::<4, 4>(0, 0).into_owned();
        covariance.cholesky().map_or(f64::INFINITY, |factor| error.dot(&factor.solve(&error)))
    }

    /// Covariance of the tip, m².
    pub fn tip_covariance(&self, constants: &Constants, motion: &LinkState) -> Matrix2<f64> {
        let frame = constants.linkage.frame(&motion.theta);
        let known = self.forecast.tip_covariance(motion, &constants.linkage).unwrap_or_else(|| {
            let (covariance, tip) = (self.belief.bank.covariance(), frame.tip());
            tip * covariance.fixed_view::<2, 2>(0, 0) * tip.transpose()
        });
        known + frame.tip_by_geometry(&constants.parameters)
    }

    /// Motor torques equivalent to the unknown force, N·m, with their standard deviations; `None` close to a direct singularity, where
    /// motors cannot exert it.
    pub fn motor_torques(&self, constants: &Constants, motion: &LinkState) -> Option<([f64; 2], [f64; 2])> {
        let frame = constants.linkage.frame(&motion.theta);
        // Torques τ of the motors have the effect N_Mᵀ τ on the tangent basis.
        let effect = frame.motors().transpose();
        let inverse = effect.try_inverse().filter(|_| effect.determinant().abs() >= LEAST_TORQUE_DETERMINANT)?;
        let covariance = inverse * self.belief.bank.covariance().fixed_view::<2, 2>(FORCE, FORCE) * inverse.transpose();
        let sigma = covariance.diagonal().map(|variance| variance.max(0.0).sqrt());
        Some(((inverse * self.belief.tangent_force(&frame)).into(), sigma.into()))
    }
}
