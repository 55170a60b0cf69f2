//! Inverse of a small general matrix. It serves all stages of a step, and multiplication is faster than a solve.

use crate::vector::Vector;

/// Inverse A⁻¹, by columns.
#[derive(Clone, Copy)]
pub(super) struct Inverse<const N: usize>([Vector<N>; N]);

impl<const N: usize> Inverse<N> {
    /// Inverts a matrix given by columns, by Gauss–Jordan elimination with pivoting. A zero pivot becomes `least`, whose products
    /// are so large that no step is accepted.
    #[inline]
    pub(super) fn new(mut columns: [Vector<N>; N], least: f64) -> Self {
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

    /// The product A⁻¹ b.
    #[inline(always)]
    pub(super) fn times(&self, b: &Vector<N>) -> Vector<N> {
        combination(&self.0, b)
    }
}

/// Linear combination Σ bᵢ columnᵢ.
#[inline(always)]
pub(super) fn combination<const N: usize, const K: usize>(columns: &[Vector<N>; K], b: &Vector<K>) -> Vector<N> {
    let mut sum = Vector::ZERO;
    for (column, b) in columns.iter().zip(b) {
        sum += *b * *column;
    }
    sum
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
        // A singular matrix gives a large and finite result.
        let flat = Inverse::new([Vector::<2>::from([1.0, 2.0]); 2], 1e-20).times(&[1.0, 1.0].into());
        assert!(flat.is_finite() && flat.max_norm() > 1e15, "{flat:?}");
    }
}
