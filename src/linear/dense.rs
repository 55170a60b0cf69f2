//! The general linear solve, LU with row exchanges, for links with so little inertia that the structured eliminations lose digits.

use nalgebra::{Const, LU, SMatrix, SVector};

use crate::integrator::Kkt;
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};

const SIZE: usize = COORDINATES + MULTIPLIERS;

/// The factorised saddle-point matrix [A₀ Φ_qᵀ; Φ_q −e], 22×22; A₀ may be full and unsymmetric.
#[derive(Clone, Debug)]
pub struct Dense {
    lu: LU<f64, Const<SIZE>, Const<SIZE>>,
}

impl Dense {
    /// Factorises for any A₀ with a positive definite symmetric part: with e > 0 the matrix is then regular.
    #[inline(never)]
    pub fn factor(pose: &Pose, a0: &SMatrix<f64, COORDINATES, COORDINATES>, regularization: f64) -> Self {
        let phi_q = pose.phi_q();
        let mut matrix = SMatrix::<f64, SIZE, SIZE>::zeros();
        matrix.fixed_view_mut::<COORDINATES, COORDINATES>(0, 0).copy_from(a0);
        matrix.fixed_view_mut::<MULTIPLIERS, COORDINATES>(COORDINATES, 0).copy_from(&phi_q);
        matrix.fixed_view_mut::<COORDINATES, MULTIPLIERS>(0, COORDINATES).copy_from(&phi_q.transpose());
        for i in COORDINATES..SIZE {
            matrix[(i, i)] = -regularization;
        }
        Self { lu: matrix.lu() }
    }
}

impl Kkt<COORDINATES, MULTIPLIERS> for Dense {
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        let mut xy = SVector::<f64, SIZE>::zeros();
        xy.fixed_rows_mut::<COORDINATES>(0).copy_from_slice(&b[..]);
        xy.fixed_rows_mut::<MULTIPLIERS>(COORDINATES).copy_from_slice(&c[..]);
        // If extreme values made the matrix singular, the caller's check for finite results ends the step.
        if !self.lu.solve_mut(&mut xy) {
            xy.fill(f64::NAN);
        }
        (Coordinates::from_fn(|i| xy[i]), Multipliers::from_fn(|i| xy[COORDINATES + i]))
    }
}
