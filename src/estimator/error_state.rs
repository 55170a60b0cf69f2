//! Error state of the filters on the tangent basis N: two components of the angles, two of the rates, two of the unknown force; and what becomes
//! of its covariance P by a transition, by a sample and by another basis. Every covariance is symmetric to the bit. Behind it stand the parameters that
//! may be learned.

use std::ops::Range;

use nalgebra::{Matrix2, SMatrix, SVector};

/// Number of error components: two of the angles, two of the rates, two of the unknown force.
pub const ERRORS: usize = 6;
/// Index of the first rate in an error.
pub(super) const RATE: usize = 2;
/// Index of the first force component in an error.
pub(super) const FORCE: usize = 4;

/// Error state: two angles, rad, two rates, rad/s, two components of the unknown force, N·m.
pub type Error = SVector<f64, ERRORS>;
/// Covariance or transition matrix of the error state.
pub type Matrix = SMatrix<f64, ERRORS, ERRORS>;

/// Number of parameters that may be learned.
pub const LEARNED: usize = 18;
/// Number of loads, the first: masses, payload and friction.
pub const LOADS: usize = 11;
/// Number of lengths and mounting angles, behind the loads.
pub const GEOMETRY: usize = LEARNED - LOADS;
/// Logarithms of the factors of the masses of links 1 to 4, inertias along with them.
pub const MASSES: Range<usize> = 0..4;
/// Mass of the payload, kg.
pub const PAYLOAD: usize = 4;
/// Coefficients of viscous friction in joints 1 to 5, N·m·s/rad.
pub const VISCOUS: Range<usize> = 5..10;
/// Logarithm of the factor of dry friction in all joints.
pub const DRY: usize = 10;
/// Lengths of links 1 to 4 and of the base: errors of the parameters, m.
pub const LENGTHS: Range<usize> = LOADS..LOADS + 5;
/// Mounting angles of the encoders, rad, on which servos close.
pub const OFFSETS: Range<usize> = LENGTHS.end..LEARNED;
/// Values of the parameters: logarithms, kg, N·m·s/rad, m, rad.
pub type Learned = SVector<f64, LEARNED>;

/// F P Fᵀ + Q, symmetric to the bit.
pub(super) fn transformed(f: &Matrix, p: &Matrix, noise: impl FnOnce(Matrix) -> Matrix) -> Matrix {
    let mut product = noise(f * p * f.transpose());
    product.fill_upper_triangle_with_lower_triangle();
    product
}

/// Turns the tangent basis of errors, by columns: their angles, rates and force change alike.
pub(super) fn turn_errors<const C: usize>(turn: &Matrix2<f64>, errors: &mut SMatrix<f64, ERRORS, C>) {
    for pair in (0..ERRORS).step_by(2) {
        let mut errors = errors.fixed_rows_mut::<2>(pair);
        errors.copy_from(&(turn * &errors));
    }
}

/// Turns the tangent basis of a covariance, symmetric to the bit.
pub(super) fn turn_covariance(turn: &Matrix2<f64>, covariance: &mut Matrix) {
    turn_errors(turn, covariance);
    covariance.transpose_mut();
    turn_errors(turn, covariance);
    covariance.fill_upper_triangle_with_lower_triangle();
}

/// Measurement update of a covariance, P − P Hᵀ H P/S, by `column`, P Hᵀ, and the variance S of the sample: symmetric to the bit.
pub(super) fn reduce<const N: usize>(covariance: &mut SMatrix<f64, N, N>, column: &SVector<f64, N>, variance: f64) {
    reduce_of(covariance, column, variance, N);
}

/// Measurement update in which errors from a number on are considered alone, as constants that stay as uncertain as they are (Schmidt 1966).
pub(super) fn reduce_of<const N: usize>(
    covariance: &mut SMatrix<f64, N, N>,
    column: &SVector<f64, N>,
    variance: f64,
    considered: usize,
) {
    let taken = column / variance.sqrt();
    for (k, of) in covariance.data.0.iter_mut().enumerate() {
        let take = |of: &mut [f64]| of.iter_mut().zip(&taken).for_each(|(of, by)| *of -= by * taken[k]);
        // The whole column has a length that the compiler knows.
        if k < considered { take(of) } else { take(&mut of[..considered]) }
    }
    for i in 0..considered {
        // A variance may turn negative by round-off only.
        covariance[(i, i)] = covariance[(i, i)].max(f64::EPSILON * taken[i] * taken[i]);
    }
}

/// Whether a stored matrix is possible as a covariance: symmetric to the bit, no variance below 0, no correlation beyond 1 but by round-off.
pub(super) fn is_covariance<const N: usize>(p: &SMatrix<f64, N, N>) -> bool {
    *p == p.transpose() && (0..N).all(|i| p[(i, i)] >= 0.0 && (0..i).all(|k| is_correlation(p[(i, k)], p[(i, i)], p[(k, k)])))
}

/// Whether a stored covariance is possible beside two variances.
pub(super) fn is_correlation(covariance: f64, one: f64, other: f64) -> bool {
    covariance * covariance <= 1.01 * one * other
}

/// Gives the force a covariance of its own, (N·m)², uncorrelated with the motion.
pub(super) fn isolate_force(covariance: &mut Matrix, own: &Matrix2<f64>) {
    covariance.fixed_rows_mut::<2>(FORCE).fill(0.0);
    covariance.fixed_columns_mut::<2>(FORCE).fill(0.0);
    covariance.fixed_view_mut::<2, 2>(FORCE, FORCE).copy_from(own);
}
