//! Error state of the filters: two components of the angles, two of the rates and two of the unknown force on the tangent basis N, and the
//! persistent errors of both encoders. The errors of learned parameters come after these errors. The functions here transform the
//! covariance P by a transition, a sample or a change of basis; each result is symmetric to the bit.
//!
//! A persistent error of a reading, due to lengths, mounting and discs, is a Gauss–Markov process b with variance 1 in units of its
//! standard deviation s. In h seconds it keeps the part φ = τ/(τ + h), which is exp(−h/τ) to first order (Bryson and Ho, *Applied Optimal
//! Control*, 1975, section 12.4):
//!
//! ```text
//! y = H x + s b + v        b' = φ b + w        w ~ N(0, 1 − φ²)
//! ```

use std::ops::Range;

use nalgebra::{Matrix2, SMatrix, SVector};

use crate::vector::Vector;

/// Number of error components on the tangent basis: two of the angles, two of the rates, two of the unknown force.
pub const MOVING: usize = 6;
/// Number of error components.
pub const ERRORS: usize = 8;
/// Index of the first rate in an error.
pub(super) const RATE: usize = 2;
/// Index of the first force component in an error.
pub(super) const FORCE: usize = 4;
/// Index of the persistent error of the first encoder in an error.
pub(super) const READINGS: usize = MOVING;

/// Error state: two angles, rad, two rates, rad/s, two components of the unknown force, N·m, and the persistent errors of both encoders in
/// units of their standard deviations.
pub type Error = SVector<f64, ERRORS>;
/// Covariance of the error state.
pub type Matrix = SMatrix<f64, ERRORS, ERRORS>;
/// Transition matrix of the errors on the tangent basis, or their covariance.
pub type Transition = SMatrix<f64, MOVING, MOVING>;

/// Number of parameters that may be learned.
pub const LEARNED: usize = 18;
/// Number of loads, which come first: masses, payload and friction.
pub const LOADS: usize = 11;
/// Number of lengths and mounting angles, which come after the loads.
pub const GEOMETRY: usize = LEARNED - LOADS;
/// Logarithms of the factors of the masses of links 1 to 4; inertias have the same factors.
pub const MASSES: Range<usize> = 0..4;
/// Mass of the payload, kg.
pub const PAYLOAD: usize = 4;
/// Coefficients of viscous friction in joints 1 to 5, N·m·s/rad.
pub const VISCOUS: Range<usize> = 5..10;
/// Logarithm of the factor of dry friction in all joints.
pub const DRY: usize = 10;
/// Lengths of links 1 to 4 and of the base: errors of the parameters, m.
pub const LENGTHS: Range<usize> = LOADS..LOADS + 5;
/// Mounting angles of the encoders, rad; servos close their loops on the encoders.
pub const OFFSETS: Range<usize> = LENGTHS.end..LEARNED;
/// Values of the parameters: logarithms, kg, N·m·s/rad, m, rad.
pub type Learned = SVector<f64, LEARNED>;

/// Propagates errors, one per column, by a transition F; persistent errors keep the part `kept`. A force moves angles and rates; only the
/// change of basis changes the force itself.
pub(super) fn move_errors<const C: usize>(f: &Transition, kept: f64, errors: &mut SMatrix<f64, ERRORS, C>) {
    let (of_motion, of_force) = columns(f);
    for column in &mut errors.data.0 {
        let motion = (1..FORCE).fold(column[0] * of_motion[0], |sum, k| sum + column[k] * of_motion[k]);
        let force = column[FORCE] * of_force[0] + column[FORCE + 1] * of_force[1];
        column[..MOVING].copy_from_slice(&*force);
        column[..FORCE].iter_mut().zip(&*motion).for_each(|(error, by)| *error += by);
        column[READINGS..].iter_mut().for_each(|error| *error *= kept);
    }
}

/// Columns of a transition with respect to angles and rates, which do not change the force, and with respect to the force.
fn columns(f: &Transition) -> ([Vector<FORCE>; FORCE], [Vector<MOVING>; 2]) {
    let of_motion = std::array::from_fn(|k| Vector::from_fn(|i| f[(i, k)]));
    (of_motion, std::array::from_fn(|k| f.data.0[FORCE + k].into()))
}

/// Propagates a covariance by a transition F and the process noise; persistent errors keep the part `kept`.
pub(super) fn move_covariance(f: &Transition, kept: f64, covariance: &mut Matrix, noise: impl FnOnce(&mut Matrix)) {
    move_errors(f, kept, covariance);
    let half: [Vector<MOVING>; MOVING] = std::array::from_fn(|k| Vector::from_fn(|i| covariance[(i, k)]));
    for (j, column) in covariance.data.0[..MOVING].iter_mut().enumerate() {
        let by_force = f[(j, FORCE)] * half[FORCE] + f[(j, FORCE + 1)] * half[FORCE + 1];
        let moved = if j < FORCE { (0..FORCE).fold(by_force, |sum, k| sum + f[(j, k)] * half[k]) } else { by_force };
        column[..MOVING].copy_from_slice(&*moved);
    }
    for (k, column) in covariance.data.0.iter_mut().enumerate().skip(READINGS) {
        column.iter_mut().for_each(|of| *of *= kept);
        column[k] += 1.0 - kept * kept;
    }
    noise(covariance);
    covariance.fill_lower_triangle_with_upper_triangle();
}

/// matrix ← own·matrix + part·other + x yᵀ; symmetric to the bit if all three terms are.
pub(super) fn combine<const R: usize, const C: usize>(
    matrix: &mut SMatrix<f64, R, C>,
    own: f64,
    (part, other): (f64, &SMatrix<f64, R, C>),
    (x, y): (&SVector<f64, R>, &SVector<f64, C>),
) {
    let [x] = x.data.0.map(Vector::from);
    for ((column, other), y) in matrix.data.0.iter_mut().zip(&other.data.0).zip(y) {
        *column = (own * Vector::from(*column) + part * Vector::from(*other) + *y * x).into();
    }
}

/// Turns the tangent basis of errors, one per column: the same map turns angles, rates and force.
pub(super) fn turn_errors<const R: usize, const C: usize>(turn: &Matrix2<f64>, errors: &mut SMatrix<f64, R, C>) {
    for pair in (0..MOVING).step_by(2) {
        let mut errors = errors.fixed_rows_mut::<2>(pair);
        errors.copy_from(&(turn * &errors));
    }
}

/// Turns the tangent basis of a covariance.
pub(super) fn turn_covariance(turn: &Matrix2<f64>, covariance: &mut Matrix) {
    for i in (0..MOVING).step_by(2) {
        for k in (i..ERRORS).step_by(2) {
            let mut block = covariance.fixed_view_mut::<2, 2>(i, k);
            let turned = turn * &block;
            block.copy_from(&if k < MOVING { turned * turn.transpose() } else { turned });
        }
    }
    covariance.fill_lower_triangle_with_upper_triangle();
}

/// Measurement update of a covariance, P − P Hᵀ H P/S, by `column`, P Hᵀ, and the variance S of the sample.
pub(super) fn reduce<const N: usize>(covariance: &mut SMatrix<f64, N, N>, column: &SVector<f64, N>, variance: f64) {
    let taken = Vector::from(column.data.0[0]) / variance.sqrt();
    for (k, of) in covariance.data.0.iter_mut().enumerate() {
        *of = (Vector::from(*of) - taken[k] * taken).into();
        // A variance may turn negative by round-off only.
        of[k] = of[k].max(f64::EPSILON * taken[k] * taken[k]);
    }
}

/// Measurement update of a covariance if the errors from `first` on are corrected by only a part of their gain: their own covariance
/// decreases by `share` of the full reduction.
pub(super) fn reduce_in_part<const N: usize>(
    covariance: &mut SMatrix<f64, N, N>,
    column: &SVector<f64, N>,
    variance: f64,
    (first, share): (usize, f64),
) {
    let taken = Vector::from(column.data.0[0]) / variance.sqrt();
    for (k, of) in covariance.data.0.iter_mut().enumerate() {
        let mut less = taken[k] * taken;
        if k >= first {
            less[first..].iter_mut().for_each(|of| *of *= share);
        }
        *of = (Vector::from(*of) - less).into();
        // A variance may turn negative by round-off only.
        of[k] = of[k].max(f64::EPSILON * taken[k] * taken[k]);
    }
}

/// Bounds the variances of angles, rad², and of rates, rad²/s², in unobserved directions; correlations remain. Larger variances would take
/// digits from small ones. `also` gets the index and the factor of each error that is scaled.
pub(super) fn bound_variances<const N: usize>(
    covariance: &mut SMatrix<f64, N, N>,
    largest: [f64; 2],
    mut also: impl FnMut(usize, f64),
) {
    for i in 0..FORCE {
        let (variance, most) = (covariance[(i, i)], largest[i / 2]);
        if variance > most {
            let factor = (most / variance).sqrt();
            covariance.row_mut(i).scale_mut(factor);
            covariance.column_mut(i).scale_mut(factor);
            also(i, factor);
        }
    }
}

/// Whether a stored matrix is possible as a covariance: symmetric to the bit, no negative variance, no correlation beyond 1 except for
/// round-off.
pub(super) fn is_covariance<const N: usize>(p: &SMatrix<f64, N, N>) -> bool {
    *p == p.transpose() && (0..N).all(|i| p[(i, i)] >= 0.0 && (0..i).all(|k| is_correlation(p[(i, k)], p[(i, i)], p[(k, k)])))
}

/// Whether a stored covariance is possible with these two variances.
pub(super) fn is_correlation(covariance: f64, one: f64, other: f64) -> bool {
    covariance * covariance <= 1.01 * one * other
}

/// Covariance of independent errors with these variances of angles, rad², rates, rad²/s², and force, (N·m)².
pub(super) fn independent([angles, rates, force]: [f64; 3]) -> Matrix {
    Matrix::from_diagonal(&Error::from_fn(|i, _| [angles, rates, force, 1.0][i / 2]))
}

/// Replaces the covariance of the force by `own`, (N·m)², without correlation with the motion.
pub(super) fn isolate_force(covariance: &mut Matrix, own: &Matrix2<f64>) {
    covariance.fixed_rows_mut::<2>(FORCE).fill(0.0);
    covariance.fixed_columns_mut::<2>(FORCE).fill(0.0);
    covariance.fixed_view_mut::<2, 2>(FORCE, FORCE).copy_from(own);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A transition in which angles and rates do not change the force.
    fn transition() -> Transition {
        Transition::from_fn(|i, k| if i >= FORCE && k < FORCE { 0.0 } else { libm::sin((3 * i + 7 * k + 1) as f64) })
    }

    /// The moved covariance is F P Fᵀ + Q with the full F of eight errors, although the code skips the zeros of F.
    #[test]
    fn covariances_move_by_the_whole_transition() {
        let (f, kept) = (transition(), 0.7);
        let root = Matrix::from_fn(|i, k| libm::cos((5 * i + 3 * k) as f64));
        let before = root * root.transpose();
        let mut whole = Matrix::identity() * kept;
        whole.fixed_view_mut::<MOVING, MOVING>(0, 0).copy_from(&f);
        let mut expected = whole * before * whole.transpose();
        (READINGS..ERRORS).for_each(|i| expected[(i, i)] += 1.0 - kept * kept);
        let mut moved = before;
        move_covariance(&f, kept, &mut moved, |_| ());
        // Tolerance: round-off of sums of 64 products.
        assert!((moved - expected).amax() < 1e-13 * expected.amax() && moved == moved.transpose(), "{moved} {expected}");
        let mut errors = root;
        move_errors(&f, kept, &mut errors);
        assert!((errors - whole * root).amax() < 1e-13 * root.amax() * MOVING as f64);
    }

    /// Readings with a common persistent error determine the position of an axis only to that error, but its movement far better.
    #[test]
    fn persistent_errors_do_not_average_out() {
        let (error, noise) = (2e-3, 1e-5);
        let mut row = Error::zeros();
        (row[0], row[READINGS]) = (1.0, error);
        let mut covariance = independent([1.0, 0.0, 0.0]);
        for _ in 0..100 {
            let column = covariance * row;
            reduce(&mut covariance, &column, row.dot(&column) + noise * noise);
            move_covariance(&Transition::identity(), 0.999, &mut covariance, |_| ());
        }
        let (of_angle, of_reading) = (covariance[(0, 0)].sqrt(), row.dot(&(covariance * row)).sqrt());
        // A hundred samples last for a tenth of the correlation time, a thousand samples; between two samples the error changes by
        // √(2/1000) of its standard deviation.
        assert!(of_angle > 0.9 * error && of_angle < error, "{of_angle}");
        assert!(of_reading < 0.05 * error, "{of_reading}");
    }
}
