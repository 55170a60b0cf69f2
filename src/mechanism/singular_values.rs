//! Singular values of Φ_q, a 10×12 matrix: only the smallest, for an output, or all with their vectors, for derivatives. The smallest comes
//! from bisection of a tridiagonal matrix, all values from one-sided Jacobi rotations; nalgebra's decomposition would add 30 kB.

use super::{Coordinates, MULTIPLIERS, Multipliers, Pose};
use crate::vector::Vector;

/// Largest |cosine| of the angle between two rows that count as orthogonal: round-off of a scalar product.
const ORTHOGONALITY_TOLERANCE: f64 = 4.0 * f64::EPSILON;

/// Largest number of Jacobi sweeps. Convergence is quadratic; six are usual.
const LARGEST_SWEEP_COUNT: usize = 30;

/// A singular value σ of a matrix A with its singular vectors u and v: Aᵀ u = σ v.
#[derive(Clone, Copy, Debug)]
pub struct SingularValue {
    /// Singular value σ.
    pub value: f64,
    /// Left singular vector u, of length 1.
    pub left: Multipliers,
    /// Right singular vector v: of length 1, or 0 if σ = 0.
    pub right: Coordinates,
}

impl Pose {
    /// All singular values of Φ_q (rows in m, columns in m and rad).
    pub fn singular_values(&self) -> [SingularValue; MULTIPLIERS] {
        singular_values(self.rows_of_phi_q())
    }

    /// Smallest singular value of Φ_q (rows in m, columns in m and rad).
    pub fn smallest_singular_value(&self) -> f64 {
        smallest_singular_value(self.rows_of_phi_q())
    }

    /// Rows of Φ_q.
    fn rows_of_phi_q(&self) -> [Coordinates; MULTIPLIERS] {
        std::array::from_fn(|i| self.phi_q_transposed_times(&Multipliers::unit(i)))
    }
}

/// All singular values of the matrix with these rows, unsorted. One-sided Jacobi rotations act on pairs of rows until all rows are
/// orthogonal; then the rows are σ v (Golub and Van Loan, Matrix Computations, third edition, section 8.6.3).
fn singular_values(mut rows: [Coordinates; MULTIPLIERS]) -> [SingularValue; MULTIPLIERS] {
    let mut left: [Multipliers; MULTIPLIERS] = std::array::from_fn(Multipliers::unit);
    for _ in 0..LARGEST_SWEEP_COUNT {
        let mut are_orthogonal = true;
        for i in 0..MULTIPLIERS {
            for j in i + 1..MULTIPLIERS {
                let [x, y] = [rows[i], rows[j]];
                let (xx, xy, yy) = (x.dot(&x), x.dot(&y), y.dot(&y));
                if xy.abs() <= ORTHOGONALITY_TOLERANCE * (xx * yy).sqrt() {
                    continue;
                }
                are_orthogonal = false;
                // Two angles make the rows orthogonal; the smaller one is used.
                let cotangent_of_twice = (yy - xx) / (2.0 * xy);
                let tangent = 1.0_f64.copysign(cotangent_of_twice)
                    / (cotangent_of_twice.abs() + (1.0 + cotangent_of_twice * cotangent_of_twice).sqrt());
                let cos = 1.0 / (1.0 + tangent * tangent).sqrt();
                let sin = tangent * cos;
                (rows[i], rows[j]) = (cos * x - sin * y, sin * x + cos * y);
                let [x, y] = [left[i], left[j]];
                (left[i], left[j]) = (cos * x - sin * y, sin * x + cos * y);
            }
        }
        if are_orthogonal {
            break;
        }
    }
    std::array::from_fn(|i| {
        let value = rows[i].norm();
        let right = if value > 0.0 { rows[i] / value } else { Coordinates::ZERO };
        SingularValue { value, left: left[i], right }
    })
}

/// Smallest singular value of the matrix with these rows, accurate to the round-off of the largest. This takes some 50,000 instructions
/// less than all values with their vectors.
///
/// Householder reflections from both sides give a bidiagonal matrix (Golub and Van Loan, Matrix Computations, third edition, section
/// 5.4.3). Its elements, with a zero diagonal, form a tridiagonal matrix with the eigenvalues ±σ. Bisection counts the eigenvalues below a
/// bound by Sturm's sequence (sections 8.5.2 and 8.6.1).
fn smallest_singular_value(mut rows: [Coordinates; MULTIPLIERS]) -> f64 {
    let mut high = rows.iter().map(Coordinates::norm).fold(f64::INFINITY, f64::min);
    let precision = f64::EPSILON * high;
    // Squared elements of the bidiagonal matrix: each diagonal element, then its off-diagonal neighbour.
    let mut squares = [0.0; 2 * MULTIPLIERS];
    for k in 0..MULTIPLIERS {
        let (done, below) = rows.split_at_mut(k + 1);
        let across = Coordinates::from_fn(|j| if j < k { 0.0 } else { done[k][j] });
        squares[2 * k] = across.dot(&across);
        if let Some((mirror, scale)) = reflection(across, k, squares[2 * k]) {
            for row in &mut *below {
                *row = *row - scale * row.dot(&mirror) * mirror;
            }
        }
        let down = Multipliers::from_fn(|i| if i <= k { 0.0 } else { below[i - k - 1][k] });
        squares[2 * k + 1] = down.dot(&down);
        if let Some((mirror, scale)) = reflection(down, k + 1, squares[2 * k + 1]) {
            let weights = &mirror[k + 1..];
            let sum = below.iter().zip(weights).fold(Coordinates::ZERO, |sum, (row, &weight)| sum + weight * *row);
            for (row, weight) in below.iter_mut().zip(weights) {
                *row = *row - scale * weight * sum;
            }
        }
    }
    let mut low = 0.0;
    loop {
        let middle = low + (high - low) / 2.0;
        if middle <= low || middle >= high || high - low <= precision {
            return middle;
        }
        let mut below = 0;
        let mut pivot = -middle;
        for square in &squares[..2 * MULTIPLIERS - 1] {
            below += u32::from(pivot < 0.0);
            // A pivot of 0 is replaced by the smallest positive normal number.
            pivot = -middle - square / if pivot.abs() < f64::MIN_POSITIVE { f64::MIN_POSITIVE } else { pivot };
        }
        below += u32::from(pivot < 0.0);
        if below as usize > MULTIPLIERS { high = middle } else { low = middle }
    }
}

/// Vector u and factor s of the Householder reflection 1 − s u uᵀ that maps a vector onto its axis `place`. `square` is the square of the
/// vector's length. `None` if the length is 0 or the place is outside the vector.
fn reflection<const N: usize>(mut vector: Vector<N>, place: usize, square: f64) -> Option<(Vector<N>, f64)> {
    let element = *vector.get(place)?;
    let length = square.sqrt().copysign(element);
    vector[place] += length;
    (square > 0.0).then(|| (vector, 1.0 / (length * vector[place])))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Arbitrary rows of size 1; the last is nearly a sum of two others.
    fn rows(rest: f64) -> [Coordinates; MULTIPLIERS] {
        let mut rows: [Coordinates; MULTIPLIERS] = std::array::from_fn(|i| {
            Coordinates::from_fn(|j| f64::from((7 * i * i + 3 * j * (i + 2) + j * j) as u32 % 23) / 11.0 - 1.0)
        });
        rows[MULTIPLIERS - 1] = rows[0] - rows[3] + rest * rows[MULTIPLIERS - 1];
        rows
    }

    #[test]
    fn agree_with_nalgebra_and_satisfy_their_equations() {
        for rest in [1.0, 1e-6, 0.0] {
            let rows = rows(rest);
            let found = singular_values(rows);
            let matrix = nalgebra::SMatrix::<f64, MULTIPLIERS, { super::super::COORDINATES }>::from_fn(|i, j| rows[i][j]);
            let mut values = found.map(|of| of.value);
            values.sort_by(|a, b| b.total_cmp(a));
            // nalgebra sorts its values; the tolerance is round-off of the largest value, about 6.
            for (value, expected) in values.iter().zip(matrix.singular_values().iter()) {
                assert!((value - expected).abs() < 1e-14, "{value} {expected}");
            }
            assert!((smallest_singular_value(rows) - values[MULTIPLIERS - 1]).abs() < 1e-14);
            for SingularValue { value, left, right } in found {
                let product = (0..MULTIPLIERS).fold(Coordinates::ZERO, |sum, i| sum + left[i] * rows[i]);
                assert!((product - value * right).norm() < 1e-14, "{value}");
                assert!((left.norm() - 1.0).abs() < 1e-14);
                assert!((rest == 0.0 && value < 1e-14) || (right.norm() - 1.0).abs() < 1e-14);
            }
        }
    }

    /// A small row next to large rows has a small singular value with full relative accuracy.
    #[test]
    fn small_values_keep_their_digits() {
        let mut rows: [Coordinates; MULTIPLIERS] = std::array::from_fn(Coordinates::unit);
        rows[1] = 1e-12 * Coordinates::from_fn(|j| if j < 2 { 1.0 } else { 0.0 });
        let smallest = singular_values(rows).map(|of| of.value).into_iter().fold(f64::INFINITY, f64::min);
        // Gram's determinant of the first two rows is 1e-24, and their larger singular value is 1 + 5e-25.
        assert!((smallest / 1e-12 - 1.0).abs() < 1e-15, "{smallest:e}");
        assert!((smallest_singular_value(rows) - smallest).abs() < 1e-16);
        rows[0] = Coordinates::ZERO;
        assert_eq!(smallest_singular_value(rows), 0.0);
        assert_eq!(singular_values(rows).map(|of| of.value).into_iter().fold(f64::INFINITY, f64::min), 0.0);
    }
}
