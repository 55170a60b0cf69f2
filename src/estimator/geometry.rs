//! Effect of uncertain lengths and mounting angles of the encoders on motor angles and tip: a persistent error.

use nalgebra::{Matrix2, Matrix2x5};

use super::Parameters;
use super::constants::{MOTOR_REGULARIZATION, NEAR_VERTEX};
use super::tangent::{CLOSURE_SIGNS, Frame, Links, MEASURED, Pair};

impl Frame {
    /// Variances of the motor angles that the encoders show, rad²: the loop closes by J⁺ for lengths that are off, and mounting angles add.
    pub(super) fn motors_by_geometry(&self, parameters: &Parameters) -> [f64; 2] {
        let &Parameters { sigma0_length: length, sigma0_offset: offset, .. } = parameters;
        if length == 0.0 {
            return [offset * offset; 2];
        }
        let turned = self.turned_by_lengths();
        MEASURED.map(|link| offset * offset + turned.iter().map(|turned| (length * turned[link]).powi(2)).sum::<f64>())
    }

    /// Covariance of the tip, m², by lengths and mounting angles, while encoders hold the motors as far as possible.
    pub(super) fn tip_by_geometry(&self, parameters: &Parameters) -> Matrix2<f64> {
        let &Parameters { sigma0_length: length, sigma0_offset: offset, .. } = parameters;
        if length == 0.0 && offset == 0.0 {
            return Matrix2::zeros();
        }
        let motors = self.motors();
        // Regularised, the matrix is positive definite.
        let squared = motors.tr_mul(&motors) + Matrix2::identity() * MOTOR_REGULARIZATION;
        let holding = squared.try_inverse().unwrap_or_default() * motors.transpose();
        let by_motors = self.tip() * holding;
        let by_lengths = self.turned_by_lengths().into_iter().enumerate().map(|(link, turned)| {
            let moved = self.tip_by_links() * turned - by_motors * Pair::new(turned[MEASURED[0]], turned[MEASURED[1]]);
            let moved = if link < 2 { moved + self.directions.column(link) } else { moved };
            moved * moved.transpose()
        });
        by_lengths.sum::<Matrix2<f64>>() * (length * length) + by_motors * by_motors.transpose() * (offset * offset)
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
