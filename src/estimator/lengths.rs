//! Effect of uncertain lengths on motor angles and tip: a persistent error.

use super::linkage::{CLOSURE_SIGNS, Frame, Links, MEASURED, NEAR_VERTEX, Pair};

impl Frame {
    /// Variances of the motor angles, rad², by a standard deviation `sigma` of all lengths, m: the loop closes by J⁺.
    pub(super) fn motors_by_lengths(&self, sigma: f64) -> Pair {
        if sigma == 0.0 {
            return [0.0; 2];
        }
        let mut variances = [0.0; 2];
        for gap in self.gaps_by_length() {
            let turned = self.closing(gap);
            for (variance, link) in variances.iter_mut().zip(MEASURED) {
                *variance += sigma * sigma * turned[link] * turned[link];
            }
        }
        variances
    }

    /// Covariance of the tip, m²: xx, xy, yy, by a standard deviation `sigma` of all lengths, m, while encoders hold the motors as far as
    /// possible.
    pub(super) fn tip_by_lengths(&self, sigma: f64) -> [f64; 3] {
        /// Regularisation of the squared effect of the tangent basis N on the motor angles: where the motors hardly turn along N, the tip moves by
        /// the pseudo-inverse J⁺ of the closure alone.
        const MOTOR_REGULARIZATION: f64 = 0.01;
        if sigma == 0.0 {
            return [0.0; 3];
        }
        let [[a, b], [c, d]] = self.basis.map(|direction| MEASURED.map(|link| direction[link]));
        let (xx, xy, yy) = (a * a + b * b + MOTOR_REGULARIZATION, a * c + b * d, c * c + d * d + MOTOR_REGULARIZATION);
        let determinant = xx * yy - xy * xy;
        let mut sum = [0.0; 3];
        for (link, gap) in self.gaps_by_length().into_iter().enumerate() {
            let back = self.closing(gap).map(|angle| -angle);
            let off = MEASURED.map(|motor| back[motor]);
            let [p, q] = [a * off[0] + b * off[1], c * off[0] + d * off[1]];
            let held = self.tangent([(yy * p - xy * q) / determinant, (xx * q - xy * p) / determinant]);
            let turned = std::array::from_fn(|i| back[i] - held[i]);
            let mut moved = self.tip_velocity(&turned);
            if link < 2 {
                moved = [0, 1].map(|k| moved[k] + self.directions[link][k]);
            }
            let [x, y] = moved.map(|x| sigma * x);
            sum = [sum[0] + x * x, sum[1] + x * y, sum[2] + y * y];
        }
        sum
    }

    /// Closing turn J⁺ r, damped next to a vertex, where J⁺ grows without bound and says nothing of finite lengths.
    fn closing(&self, gap: Pair) -> Links {
        let part = (self.smallest / NEAR_VERTEX).min(1.0);
        self.least_squares(gap).map(|angle| part * part * angle)
    }

    /// Derivatives of the closure gap with respect to the length of each link and of the base.
    fn gaps_by_length(&self) -> [Pair; 5] {
        let [first, second, third, fourth] =
            std::array::from_fn(|i| self.directions[i].map(|component| CLOSURE_SIGNS[i] * component));
        [first, second, third, fourth, [-1.0, 0.0]]
    }
}
