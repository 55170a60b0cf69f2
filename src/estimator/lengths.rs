//! What lengths that are not known exactly do to the angles of the motors and to the tip: an error that stays.

use super::linkage::{CLOSURE_SIGNS, Frame, Links, MEASURED, NEAR_VERTEX, Pair};

impl Frame {
    /// Variances of the angles of the motors, rad², where lengths have a standard deviation, m: the loop closes by J⁺.
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

    /// Covariance of the tip, m²: xx, xy, yy, where lengths have a standard deviation, m, and encoders hold the motors as far as they can.
    pub(super) fn tip_by_lengths(&self, sigma: f64) -> [f64; 3] {
        /// In the squares of how motors turn with N: where they hardly do, the tip moves by J⁺ alone.
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

    /// J⁺ r; next to a vertex, where J⁺ grows without bound and says nothing of finite lengths, less of it.
    fn closing(&self, gap: Pair) -> Links {
        let part = (self.smallest / NEAR_VERTEX).min(1.0);
        self.least_squares(gap).map(|angle| part * part * angle)
    }

    /// By how much the loop opens with the length of each link and with the base's.
    fn gaps_by_length(&self) -> [Pair; 5] {
        let [first, second, third, fourth] =
            std::array::from_fn(|i| self.directions[i].map(|component| CLOSURE_SIGNS[i] * component));
        [first, second, third, fourth, [-1.0, 0.0]]
    }
}
