//! The general linear solve: for scenes whose effects couple links through K and C (friction at elbows and tip, contact).

use nalgebra::{Const, LU, SMatrix, SVector};

use crate::integrator::{Failure, Kkt};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};

const SIZE: usize = COORDINATES + MULTIPLIERS;

/// The saddle-point matrix as a whole, factorised with row exchanges: A₀ may be full and unsymmetric.
#[derive(Clone, Debug)]
pub struct Coupled {
    lu: LU<f64, Const<SIZE>, Const<SIZE>>,
}

impl Coupled {
    /// Factorises for any A₀; [`Failure::IndefiniteTangent`] where the matrix is singular.
    pub fn factor(pose: &Pose, a0: &SMatrix<f64, COORDINATES, COORDINATES>, softness: f64) -> Result<Self, Failure> {
        let phi_q = pose.phi_q();
        let mut matrix = SMatrix::<f64, SIZE, SIZE>::zeros();
        matrix.fixed_view_mut::<COORDINATES, COORDINATES>(0, 0).copy_from(a0);
        matrix.fixed_view_mut::<MULTIPLIERS, COORDINATES>(COORDINATES, 0).copy_from(&phi_q);
        matrix.fixed_view_mut::<COORDINATES, MULTIPLIERS>(0, COORDINATES).copy_from(&phi_q.transpose());
        for i in COORDINATES..SIZE {
            matrix[(i, i)] = -softness;
        }
        let lu = matrix.lu();
        if lu.is_invertible() { Ok(Self { lu }) } else { Err(Failure::IndefiniteTangent) }
    }
}

impl Kkt<COORDINATES, MULTIPLIERS> for Coupled {
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        let mut xy = SVector::<f64, SIZE>::zeros();
        xy.fixed_rows_mut::<COORDINATES>(0).copy_from_slice(b);
        xy.fixed_rows_mut::<MULTIPLIERS>(COORDINATES).copy_from_slice(c);
        // `factor` has made sure that the matrix is invertible.
        self.lu.solve_mut(&mut xy);
        (std::array::from_fn(|i| xy[i]), std::array::from_fn(|i| xy[COORDINATES + i]))
    }
}
