//! Effect of uncertain lengths and mounting angles of the encoders on motor angles and tip. The uncertainty is a persistent error, or the
//! parameters are learned.

use nalgebra::{Matrix2, Matrix2x5, Matrix4x5, SMatrix, SVector};

use super::error_state::GEOMETRY;
use super::tangent::{CLOSURE_SIGNS, Frame, MEASURED};
use super::tuning::{MOTOR_REGULARIZATION, NEAR_VERTEX};

/// Lengths of the closed loop: four links and the base.
pub(super) const LENGTH_COUNT: usize = 5;

impl Frame {
    /// Variances of the measured motor angles, rad², if each length has an error with this standard deviation, m. J⁺ closes the loop for
    /// other lengths.
    pub(super) fn motors_by_lengths(&self, length: f64) -> [f64; 2] {
        if length == 0.0 {
            return [0.0; 2];
        }
        let turned = self.turned_by_lengths();
        MEASURED.map(|link| length * length * turned.row(link).norm_squared())
    }

    /// Derivatives of the tangent coordinates with respect to the motor angles, as far as the motors determine them.
    pub(super) fn holding(&self) -> Matrix2<f64> {
        let motors = self.motors();
        // Regularised, the matrix is positive definite.
        let squared = motors.tr_mul(&motors) + Matrix2::identity() * MOTOR_REGULARIZATION;
        squared.try_inverse().unwrap_or_default() * motors.transpose()
    }

    /// ∂tip/∂length, dimensionless, with `turned`, the derivatives of the link angles.
    fn tip_by_lengths(&self, turned: &Matrix4x5<f64>) -> Matrix2x5<f64> {
        let mut moved = self.tip_by_links() * turned;
        let mut of_left_leg = moved.fixed_columns_mut::<2>(0);
        of_left_leg += self.directions.fixed_columns::<2>(0);
        moved
    }

    /// Derivatives of the angles of links 1 to 4 with respect to lengths and mounting angles, at constant tangent coordinates.
    pub(crate) fn links_by_geometry(&self) -> SMatrix<f64, 4, GEOMETRY> {
        self.turned_by_lengths().fixed_resize(0.0)
    }

    /// Derivatives of both readings with respect to lengths and mounting angles.
    pub(crate) fn readings_by_geometry(&self) -> [SVector<f64, GEOMETRY>; 2] {
        let turned = self.links_by_geometry();
        [0, 1].map(|i| {
            let mut row = turned.row(MEASURED[i]).transpose();
            row[LENGTH_COUNT + i] = 1.0;
            row
        })
    }

    /// Derivatives of the tip, m, with respect to lengths and mounting angles.
    pub(crate) fn tip_by_geometry(&self) -> SMatrix<f64, 2, GEOMETRY> {
        self.tip_by_lengths(&self.turned_by_lengths()).fixed_resize(0.0)
    }

    /// Derivatives of the tangent coordinates with respect to lengths and mounting angles at constant readings, as far as the motors
    /// determine them.
    pub(super) fn held_by_geometry(&self) -> SMatrix<f64, 2, GEOMETRY> {
        self.holding() * -SMatrix::from_columns(&self.readings_by_geometry()).transpose()
    }

    /// Derivatives of the link angles with respect to the lengths of links and base: −J⁺ of the closure gap. The derivatives are damped
    /// next to a vertex, because J⁺ is unbounded there and does not describe finite errors of the lengths.
    pub(super) fn turned_by_lengths(&self) -> Matrix4x5<f64> {
        let part = (self.smallest / NEAR_VERTEX).min(1.0);
        let mut gaps = Matrix2x5::zeros();
        for (i, sign) in CLOSURE_SIGNS.into_iter().enumerate() {
            gaps.set_column(i, &(self.directions.column(i) * sign));
        }
        gaps[(0, 4)] = -1.0;
        self.jacobian().tr_mul(&(self.inverse_gram * gaps)) * (-part * part)
    }
}
