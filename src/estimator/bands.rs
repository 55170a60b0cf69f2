//! Uncertainty of the estimate: standard deviations, covariance of the tip, equivalent motor torques.

use nalgebra::{Matrix4, Vector4};

use super::{Constants, Estimator, Links, Pair, wrapped};

impl Estimator {
    /// Standard deviations of the angles, rad, and rates, rad/s, of links 1 to 4.
    pub fn sigmas(&self, constants: &Constants) -> [Links; 2] {
        if let Some(sigmas) = self.forecast.sigmas(&self.track) {
            return sigmas;
        }
        let frame = constants.linkage.frame(&self.track.theta);
        let covariance = self.track.covariance();
        let sigma = |link: usize, first: usize| {
            let [x, y] = frame.basis.map(|direction| direction[link]);
            let variance = x * x * covariance[first][first]
                + 2.0 * x * y * covariance[first][first + 1]
                + y * y * covariance[first + 1][first + 1];
            variance.max(0.0).sqrt()
        };
        [std::array::from_fn(|link| sigma(link, 0)), std::array::from_fn(|link| sigma(link, 2))]
    }

    /// Normalised estimation error squared of angles and rates against a true motion: 4 on average for a consistent covariance.
    pub fn nees(&self, constants: &Constants, theta: &Links, omega: &Links) -> f64 {
        let frame = constants.linkage.frame(&self.track.theta);
        let angles = frame.coordinates(&std::array::from_fn(|i| wrapped(theta[i] - self.track.theta[i])));
        let rates = frame.coordinates(&std::array::from_fn(|i| omega[i] - self.track.omega[i]));
        let covariance = self.track.covariance();
        let p = Matrix4::from_fn(|i, k| covariance[i][k]);
        let error = Vector4::new(angles[0], angles[1], rates[0], rates[1]);
        p.cholesky().map_or(f64::INFINITY, |factor| error.dot(&factor.solve(&error)))
    }

    /// Covariance of the tip, m²: xx, xy, yy.
    pub fn tip_covariance(&self, constants: &Constants) -> [f64; 3] {
        let frame = constants.linkage.frame(&self.track.theta);
        let by_lengths = frame.tip_by_lengths(constants.parameters.sigma0_length);
        let known = self.forecast.tip_covariance(&self.track, &constants.linkage).unwrap_or_else(|| {
            let covariance = self.track.covariance();
            let tip = frame.tip();
            let element = |i: usize, k: usize| {
                (0..2).map(|a| (0..2).map(|b| tip[i][a] * covariance[a][b] * tip[k][b]).sum::<f64>()).sum::<f64>()
            };
            [element(0, 0), element(0, 1), element(1, 1)]
        });
        std::array::from_fn(|i| known[i] + by_lengths[i])
    }

    /// Motor torques equivalent to the unknown force, N·m, with their standard deviations; see `Track::motor_torques`.
    pub fn motor_torques(&self, constants: &Constants) -> Option<(Pair, Pair)> {
        self.track.motor_torques(&constants.linkage.frame(&self.track.theta))
    }
}
