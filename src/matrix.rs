//! Small matrices: the inverse of a general matrix, for when multiplication is faster than several solves, and the LU factors of a matrix
//! with a positive symmetric part.

use crate::vector::Vector;

/// Inverse A⁻¹, by columns.
#[derive(Clone, Copy, Debug)]
pub struct Inverse<const N: usize>([Vector<N>; N]);

impl<const N: usize> Inverse<N> {
    /// Inverts a matrix given by columns, by Gauss–Jordan elimination with pivoting. A zero pivot becomes `least`; the products are then so
    /// large that no step is accepted.
    pub fn new(mut columns: [Vector<N>; N], least: f64) -> Self {
        let mut inverse: [Vector<N>; N] = std::array::from_fn(Vector::unit);
        for k in 0..N {
            let mut largest = k;
            for i in k + 1..N {
                if columns[i][k].abs() > columns[largest][k].abs() {
                    largest = i;
                }
            }
            columns.swap(k, largest);
            inverse.swap(k, largest);
            let pivot = if columns[k][k] == 0.0 { least } else { columns[k][k] };
            columns[k] = (1.0 / pivot) * columns[k];
            inverse[k] = (1.0 / pivot) * inverse[k];
            for i in 0..N {
                if i != k {
                    let factor = columns[i][k];
                    columns[i] = columns[i] - factor * columns[k];
                    inverse[i] = inverse[i] - factor * inverse[k];
                }
            }
        }
        Self(inverse)
    }

    /// Columns of A⁻¹.
    #[inline(always)]
    pub fn columns(&self) -> &[Vector<N>; N] {
        &self.0
    }

    /// The product A⁻¹ b.
    #[inline(always)]
    pub fn times(&self, b: &Vector<N>) -> Vector<N> {
        combination(&self.0, b)
    }
}

/// Linear combination Σ bᵢ columnᵢ.
#[inline(always)]
pub fn combination<const N: usize, const K: usize>(columns: &[Vector<N>; K], b: &Vector<K>) -> Vector<N> {
    let mut sum = Vector::ZERO;
    for (column, b) in columns.iter().zip(b) {
        sum += *b * *column;
    }
    sum
}

/// Factors L U of a matrix with N rows whose symmetric part T is positive and outweighs the skew-symmetric part S.
///
/// Such a matrix needs no row exchanges: growth is bounded by the growth of T and S T⁻¹ Sᵀ (Golub and Van Loan, Matrix Computations, third
/// edition, section 4.2.2). Without exchanges every loop has a length known to the compiler.
#[derive(Clone, Debug)]
pub struct Lu<const N: usize> {
    /// Columns of L below the diagonal, 0 elsewhere.
    lower: [Vector<N>; N],
    /// Rows of U above the diagonal, 0 elsewhere.
    upper: [Vector<N>; N],
    /// Reciprocals of the diagonal of U.
    pivots: Vector<N>,
}

impl<const N: usize> Lu<N> {
    /// Factorises a matrix given by rows. If it is singular, the solutions are not finite.
    pub fn new(mut rows: [Vector<N>; N]) -> Self {
        let (mut lower, mut pivots) = ([Vector::ZERO; N], Vector::ZERO);
        for k in 0..N {
            pivots[k] = 1.0 / rows[k][k];
            // Whole rows are used: the entries left of the diagonal are already 0.
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

    /// Returns A⁻¹ b.
    pub fn solve(&self, mut b: Vector<N>) -> Vector<N> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_times_its_inverse_is_1() {
        // The first pivot is 0, and the matrix is far from symmetric.
        let columns: [Vector<4>; 4] =
            [[0.0, 3.0, -1.0, 2.0], [1e3, 0.5, 2.0, 1.0], [-2.0, 7.0, 1e-2, 4.0], [1.0, -3.0, 5.0, 0.25]].map(Vector::from);
        let inverse = Inverse::new(columns, 1e-300);
        for i in 0..4 {
            let x = Vector::from_fn(|j| (i + 2 * j) as f64 - 3.0);
            let back = inverse.times(&combination(&columns, &x));
            // Round-off times the condition number, about 1e3.
            assert!((back - x).max_norm() < 1e-12, "{back:?}");
        }
        // A singular matrix gives a large but finite result.
        let flat = Inverse::new([Vector::<2>::from([1.0, 2.0]); 2], 1e-20).times(&[1.0, 1.0].into());
        assert!(flat.is_finite() && flat.max_norm() > 1e15, "{flat:?}");
    }

    /// The matrix is far from symmetric and badly scaled.
    #[test]
    fn solutions_agree_with_nalgebra() {
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
        let columns = std::array::from_fn(|j| Vector::from_fn(|i| rows[i][j]));
        let by_inverse = Inverse::new(columns, 0.0).times(&b);
        for solution in [Lu::new(rows).solve(b), by_inverse] {
            for (x, expected) in solution.iter().zip(expected.iter()) {
                // Round-off for a condition number below 1e5.
                assert!((x - expected).abs() < 1e-11 * expected.abs().max(1.0), "{x} {expected}");
            }
        }
    }

    #[test]
    fn a_singular_matrix_gives_no_finite_solution() {
        let singular = [Vector::ZERO, Vector::unit(1)];
        assert!(!Lu::new(singular).solve(Vector::from([1.0, 1.0])).is_finite());
    }
}
