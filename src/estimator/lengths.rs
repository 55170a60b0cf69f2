//! Effect of uncertain lengths on motor angles and tip: a persistent error.

use nalgebra::{Matrix2, Matrix2x5};

use super::constants::{MOTOR_REGULARIZATION, NEAR_VERTEX};
use super::tangent::{CLOSURE_SIGNS, Frame, Links, MEASURED, Pair};

impl Frame {
    /// Variances of the motor angles, rad², by a standard deviation `sigma` of all lengths, m: the loop closes by J⁺.
    pub(super) fn motors_by_lengths(&self, sigma: f64) -> [f64; 2] {
        if sigma == 0.0 {
            return [0.0; 2];
        }
        let turned = self.turned_by_lengths();
        MEASURED.map(|link| turned.iter().map(|turned| (sigma * turned[link]).powi(2)).sum())
    }

    /// Covariance of the tip, m², by a standard deviation `sigma` of all lengths, m, while encoders hold the motors as far as possible.
    pub(super) fn tip_by_lengths(&self, sigma: f64) -> Matrix2<f64> {
        if sigma == 0.0 {
            return Matrix2::zeros();
        }
        let motors = self.motors();
        // Regularised, the matrix is positive definite.
        let squared = motors.tr_mul(&motors) + Matrix2::identity() * MOTOR_REGULARIZATION;
        let holding = squared.try_inverse().unwrap_or_default() * motors.transpose();
        self.turned_by_lengths()
            .iter()
            .enumerate()
            .map(|(link, turned)| {
                let held = turned - self.basis * (holding * Pair::new(turned[MEASURED[0]], turned[MEASURED[1]]));
                let moved = self.tip_by_links() * held;
                let moved = if link < 2 { moved + self.directions.column(link) } else { moved };
                moved * moved.transpose() * (sigma * sigma)
            })
            .sum()
    }

    /// Turns of the links by the length of each link and of the base: −J⁺ of the closure gap, damped next to a vertex, where J⁺ grows without
    /// bound and says nothing of finite lengths.
    fn turned_by_lengths(&self) -> [Links; 5] {
        let part = (self.smallest / NEAR_VERTEX).min(1.0);
        let mut gaps = Matrix2x5::zeros();
        for (i, sign) in CLOSURE_SIGNS.into_iter().enumerate() {
            gaps.set_column(i, &(self.directions.column(i) * sign));
        }
        gaps[(0, 4)] = -1.0;
        std::array::from_fn(|i| self.least_squares(gaps.column(i).into()) * (-part * part))
    }
}
