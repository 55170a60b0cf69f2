//! Scoring of a normal distribution of the tip against the true tip: its 95 % ellipse, and proper scores, the smaller the better (Gneiting
//! and Raftery, J. American Statistical Association 102 (2007) 359). Also a forecast without a model of the machine.

use std::f64::consts::{FRAC_2_SQRT_PI, PI};

/// χ² of two degrees of freedom at 95 %.
pub const ELLIPSE: f64 = 5.991;

/// Squared Mahalanobis distance of an error, m, with the covariance (xx, xy, yy), m².
fn squared_distance([xx, xy, yy]: [f64; 3], [dx, dy]: [f64; 2]) -> f64 {
    (dx * dx * yy - 2.0 * dx * dy * xy + dy * dy * xx) / (xx * yy - xy * xy)
}

/// Whether the 95 % ellipse of a covariance, m², contains an error, m.
pub fn holds(covariance: [f64; 3], off: [f64; 2]) -> bool {
    squared_distance(covariance, off) <= ELLIPSE
}

/// Half-width of the 95 % ellipse of a covariance, m², along its longer axis, m.
pub fn half_width([xx, xy, yy]: [f64; 3]) -> f64 {
    let largest = (xx + yy) / 2.0 + ((xx - yy) / 2.0).hypot(xy);
    (ELLIPSE * largest.max(0.0)).sqrt()
}

/// Logarithmic score, −ln of the density per m² at the truth, and CRPS, m; both are means over both axes.
pub type Scores = [f64; 2];

/// Scores of a normal distribution with the covariance (xx, xy, yy), m², for an error of its mean, m.
pub fn scores(covariance: [f64; 3], off: [f64; 2]) -> Scores {
    let ([xx, xy, yy], [dx, dy]) = (covariance, off);
    let (determinant, squared) = (xx * yy - xy * xy, squared_distance(covariance, off));
    let crps = |off: f64, variance: f64| {
        let off = off / (2.0 * variance).sqrt();
        let size = FRAC_2_SQRT_PI * ((-off * off).exp() - 0.5f64.sqrt()) + 2.0 * off * libm::erf(off);
        (variance / 2.0).sqrt() * size
    };
    [squared / 2.0 + (2.0 * PI).ln() + determinant.ln() / 2.0, (crps(dx, xx) + crps(dy, yy)) / 2.0]
}

/// Mean scores of errors, m, under their best-fitting normal distribution (with their mean square); for methods without a band.
pub fn in_hindsight(errors: &[[f64; 2]]) -> Scores {
    let variance = errors.iter().flatten().map(|off| off * off).sum::<f64>() / (2 * errors.len()) as f64;
    mean(errors.iter().map(|off| scores([variance, 0.0, variance], *off)))
}

/// Mean of scores.
pub fn mean(all: impl Iterator<Item = Scores>) -> Scores {
    let (sum, count) = all.fold(([0.0; 2], 0.0), |([a, b], count), [c, d]| ([a + c, b + d], count + 1.0));
    sum.map(|sum| sum / count)
}

/// Kalman filter of a tip with constant velocity and white acceleration.
#[derive(Clone, Copy, Debug, Default)]
pub struct ConstantVelocity {
    /// Position, m, and rate, m/s, of both axes.
    axes: [[f64; 2]; 2],
    /// Covariance of position and rate of each axis; `None` before the first sample.
    covariance: Option<[f64; 3]>,
}

/// White acceleration, m²/s³: some metres per squared second for a tenth of a second.
const ACCELERATION: f64 = 10.0;

impl ConstantVelocity {
    /// Uses a sample of the tip, h seconds after the last one, with variance `noise`, m².
    pub fn receive(&mut self, seen: [f64; 2], noise: f64, h: f64) {
        let Some([xx, xv, vv]) = self.covariance else {
            *self = Self { axes: seen.map(|x| [x, 0.0]), covariance: Some([noise, 0.0, 1.0]) };
            return;
        };
        let q = ACCELERATION * h;
        let [xx, xv, vv] = [xx + 2.0 * xv * h + vv * h * h + q * h * h / 3.0, xv + vv * h + q * h / 2.0, vv + q];
        let gain = [xx, xv].map(|covariance| covariance / (xx + noise));
        for ([x, v], seen) in self.axes.iter_mut().zip(seen) {
            let residual = seen - (*x + *v * h);
            (*x, *v) = (*x + *v * h + gain[0] * residual, *v + gain[1] * residual);
        }
        self.covariance = Some([xx - gain[0] * xx, xv - gain[0] * xv, vv - gain[1] * xv]);
    }

    /// Predicted tip some seconds ahead, m.
    pub fn ahead(&self, seconds: f64) -> [f64; 2] {
        self.axes.map(|[x, v]| x + v * seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scores of the standard normal distribution at its mean are ln 2π and √(2/π) − 1/√π; far off, CRPS is the distance less 1/√π; all to
    /// round-off.
    #[test]
    fn normal_scores_are_known() {
        let standard = |off: f64| scores([1.0, 0.0, 1.0], [off; 2]);
        let [log, crps] = standard(0.0);
        assert!((log - (2.0 * PI).ln()).abs() < 1e-14 && (crps - ((2.0 / PI).sqrt() - 1.0 / PI.sqrt())).abs() < 1e-14);
        assert!((standard(10.0)[1] - (10.0 - 1.0 / PI.sqrt())).abs() < 1e-13);
    }

    /// The 95 % ellipse of variances 4 and 1 has half-widths of two and one standard deviations times √χ², also in rotated axes.
    #[test]
    fn ellipses_hold_what_they_reach() {
        let (one, two) = (ELLIPSE.sqrt(), 2.0 * ELLIPSE.sqrt());
        assert!(holds([4.0, 0.0, 1.0], [0.999 * two, 0.0]) && !holds([4.0, 0.0, 1.0], [1.001 * two, 0.0]));
        assert!(holds([4.0, 0.0, 1.0], [0.0, 0.999 * one]) && !holds([4.0, 0.0, 1.0], [0.0, 1.001 * one]));
        // Rotated by 45 degrees.
        let turned = [2.5, 1.5, 2.5];
        assert!((half_width(turned) - two).abs() < 1e-12 && (half_width([1.0, 0.0, 1.0]) - one).abs() < 1e-12);
        assert!(holds(turned, [0.999 * two / 2f64.sqrt(); 2]) && !holds(turned, [1.001 * two / 2f64.sqrt(); 2]));
    }

    /// The filter predicts a tip with constant velocity.
    #[test]
    fn straight_motion_is_predicted() {
        let (mut filter, h) = (ConstantVelocity::default(), 1e-3);
        (0..1000).for_each(|k| filter.receive([0.1 + 0.5 * h * f64::from(k), -0.2], 1e-12, h));
        let [x, y] = filter.ahead(0.5);
        // The initial rate error has decayed to round-off.
        assert!((x - (0.1 + 0.5 * (999.0 * h + 0.5))).abs() < 1e-9 && (y + 0.2).abs() < 1e-9, "{x} {y}");
    }
}
