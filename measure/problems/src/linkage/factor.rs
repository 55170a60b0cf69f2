//! The factorised saddle-point matrix: eliminates bodies one by one, then the banded dual matrix S = Φ_q A⁻¹ Φ_qᵀ + e.

use fivebar::integrator::Kkt;

use super::Block;
use super::pose::{Pose, SIGN, Side};
use fivebar::vector::Vector;

/// [A Φ_qᵀ; Φ_q −e] with A of one 3×3 block per body.
pub struct Factor<const N: usize, const M: usize, const W: usize> {
    pose: Pose<M>,
    /// Rows of the inverse of A without zeros: row i belongs to coordinate i, its columns to x, y, θ of the same body.
    inverses: [[f64; 3]; N],
    /// S = L D Lᵀ: row i contains L from column i − W + 1 to i − 1, and 1/D.
    rows: [[f64; W]; M],
}

/// Inverse of a symmetric block; None if eliminating x and y leaves less than `least` of its inertia.
pub(super) fn inverse(a: &Block, least: f64) -> Option<Block> {
    let determinant = a[0][0] * a[1][1] - a[0][1] * a[0][1];
    if !(a[0][0] > 0.0 && determinant > 0.0) {
        return None;
    }
    // Inverse of the upper left block P, and P⁻¹ times the column above the inertia.
    let (xx, xy, yy) = (a[1][1] / determinant, -a[0][1] / determinant, a[0][0] / determinant);
    let column = [xx * a[0][2] + xy * a[1][2], xy * a[0][2] + yy * a[1][2]];
    let inertia = a[2][2] - column[0] * a[0][2] - column[1] * a[1][2];
    if inertia.is_nan() || inertia < least {
        return None;
    }
    let [x, y] = column.map(|c| c / inertia);
    Some([[xx + x * column[0], xy + x * column[1], -x], [xy + y * column[0], yy + y * column[1], -y], [-x, -y, 1.0 / inertia]])
}

impl<const N: usize, const M: usize, const W: usize> Factor<N, M, W> {
    pub(super) fn new(pose: &Pose<M>, inverses: [[f64; 3]; N], regularization: f64) -> Self {
        let mut factor = Self { pose: *pose, inverses, rows: [[0.0; W]; M] };
        for row in 0..M {
            for column in row.saturating_sub(W - 1)..=row {
                factor.rows[row][W - 1 + column - row] = factor.dual(row, column);
            }
            factor.rows[row][W - 1] += regularization;
        }
        factor.eliminate();
        factor
    }

    /// An entry of Φ_q A⁻¹ Φ_qᵀ: a sum over the bodies that both rows share.
    fn dual(&self, row: usize, column: usize) -> f64 {
        let mut sum = 0.0;
        for (first, first_sign) in self.pose.rows[row].iter().zip(SIGN) {
            for (second, second_sign) in self.pose.rows[column].iter().zip(SIGN) {
                if let (Some(first), Some(second)) = (first, second)
                    && first.body == second.body
                {
                    sum += first_sign * second_sign * self.through_body(row % 2, first, column % 2, second);
                }
            }
        }
        sum
    }

    /// (1 at axis, turn at θ) A⁻¹ (1 at other axis, other turn at θ)ᵀ of one body.
    fn through_body(&self, axis: usize, side: &Side, other_axis: usize, other: &Side) -> f64 {
        let [translation, rotation] = [axis, 2].map(|i| {
            let row = &self.inverses[3 * side.body + i];
            row[other_axis] + row[2] * other.turn
        });
        translation + side.turn * rotation
    }

    /// Factorises S as L D Lᵀ in place, without pivoting: S is positive.
    fn eliminate(&mut self) {
        for i in 0..M {
            let first = i.saturating_sub(W - 1);
            let (done, rest) = self.rows.split_at_mut(i);
            let row = &mut rest[0];
            // L D of this row, then L and 1/D.
            for j in first..i {
                let known: f64 = (first..j).filter(|k| k + W > j).map(|k| row[W - 1 + k - i] * done[j][W - 1 + k - j]).sum();
                row[W - 1 + j - i] -= known;
            }
            for j in first..i {
                let scaled = row[W - 1 + j - i];
                row[W - 1 + j - i] = scaled * done[j][W - 1];
                row[W - 1] -= scaled * row[W - 1 + j - i];
            }
            row[W - 1] = 1.0 / row[W - 1];
        }
    }

    fn solve_dual(&self, mut y: Vector<M>) -> Vector<M> {
        for i in 0..M {
            for j in i.saturating_sub(W - 1)..i {
                y[i] -= self.rows[i][W - 1 + j - i] * y[j];
            }
        }
        for (y, row) in y.iter_mut().zip(&self.rows) {
            *y *= row[W - 1];
        }
        for i in (0..M).rev() {
            for j in i.saturating_sub(W - 1)..i {
                y[j] -= self.rows[i][W - 1 + j - i] * y[i];
            }
        }
        y
    }

    /// A⁻¹ b.
    fn bodies(&self, b: &Vector<N>) -> Vector<N> {
        Vector::from_fn(|i| {
            let first = i - i % 3;
            let [x, y, theta] = self.inverses[i];
            x * b[first] + y * b[first + 1] + theta * b[first + 2]
        })
    }
}

impl<const N: usize, const M: usize, const W: usize> Kkt<N, M> for Factor<N, M, W> {
    fn solve(&self, b: &Vector<N>, c: &Vector<M>) -> (Vector<N>, Vector<M>) {
        let free = self.pose.times(&self.bodies(b));
        let y = self.solve_dual(free - *c);
        let held: Vector<N> = self.pose.transposed_times(&y);
        (self.bodies(&(*b - held)), y)
    }
}
