//! LU factorisation without row exchanges for small matrices whose symmetric part T is positive definite and outweighs the skew part S:
//! growth is bounded by that of T and S T⁻¹ Sᵀ (Golub and Van Loan, Matrix Computations, third edition, section 4.2.2). Without exchanges
//! every loop has a length that is known to the compiler.

use crate::vector::Vector;

/// A factorised matrix L U with N rows.
#[derive(Clone, Debug)]
pub(super) struct Lu<const N: usize> {
    /// Columns of L below the diagonal, 0 elsewhere.
    lower: [Vector<N>; N],
    /// Rows of U above the diagonal, 0 elsewhere.
    upper: [Vector<N>; N],
    /// Reciprocals of the diagonal of U.
    pivots: Vector<N>,
}

impl<const N: usize> Lu<N> {
    /// Factorises a matrix given by rows. Solutions with a singular matrix are not finite.
    #[inline]
    pub(super) fn new(mut rows: [Vector<N>; N]) -> Self {
        let (mut lower, mut pivots) = ([Vector::ZERO; N], Vector::ZERO);
        for k in 0..N {
            pivots[k] = 1.0 / rows[k][k];
            // Whole rows are subtracted: their entries left of the diagonal are 0 by now.
            rows[k][k] = 0.0;
            let row = rows[k];
            for i in k + 1..N {
                let factor = rows[i][k] * pivots[k];
                lower[k][i] = factor;
                rows[i][k] = 0.0;
                rows[i] = rows[i] - factor * row;
            }
        }
        Self { lower, upper: rows, pivots }
    }

    /// The solution A⁻¹ b.
    #[inline]
    pub(super) fn solve(&self, mut b: Vector<N>) -> Vector<N> {
        for k in 0..N {
            let factor = b[k];
            b = b - factor * self.lower[k];
        }
        let mut x = Vector::ZERO;
        for k in (0..N).rev() {
            x[k] = (b[k] - self.upper[k].dot(&x)) * self.pivots[k];
        }
        x
    }
}

/// The inverse of a well-conditioned matrix, both by rows: cheaper than a factorisation where many right-hand sides follow.
#[inline]
pub(super) fn inverse<const N: usize>(mut rows: [Vector<N>; N]) -> [Vector<N>; N] {
    for k in 0..N {
        let pivot = 1.0 / rows[k][k];
        rows[k][k] = 1.0;
        let row = pivot * rows[k];
        rows[k] = row;
        for i in (0..N).filter(|&i| i != k) {
            let factor = rows[i][k];
            rows[i][k] = 0.0;
            rows[i] = rows[i] - factor * row;
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The matrix is far from symmetric and badly scaled.
    #[test]
    fn solves_what_nalgebra_solves() {
        let rows: [Vector<5>; 5] = std::array::from_fn(|i| {
            Vector::from_fn(|j| {
                let skew = ((3 * i + 5 * j) % 7) as f64 - ((3 * j + 5 * i) % 7) as f64;
                if i == j { 10f64.powi(i as i32) } else { skew }
            })
        });
        let b = Vector::from([1.0, -2.0, 3.0, 0.5, 4.0]);
        let vector = nalgebra::SVector::<f64, 5>::from(*b);
        let matrix = nalgebra::SMatrix::<f64, 5, 5>::from_fn(|i, j| rows[i][j]);
        let expected = matrix.lu().solve(&vector).expect("a regular matrix");
        let by_inverse = Vector::from(inverse(rows).map(|row| row.dot(&b)));
        for solution in [Lu::new(rows).solve(b), by_inverse] {
            for (x, expected) in solution.iter().zip(expected.iter()) {
                // Round-off of a matrix of condition below 1e5.
                assert!((x - expected).abs() < 1e-11 * expected.abs().max(1.0), "{x} {expected}");
            }
        }
    }

    #[test]
    fn a_singular_matrix_gives_nothing_finite() {
        let singular = [Vector::ZERO, Vector::unit(1)];
        assert!(!Lu::new(singular).solve(Vector::from([1.0, 1.0])).is_finite());
    }
}
