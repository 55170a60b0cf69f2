//! Φ_q of a posture as a sparse matrix.

use super::{End, Planar};
use fivebar::vector::Vector;

/// Contribution of one end of a joint to a row of Φ_q, if the end is on a body: ±1 at x or y of the body, ±`turn` at its θ. The sign is +
/// for the first end, − for the second.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    pub(super) body: usize,
    /// Component of the arm from the centre of mass to the joint: x in even rows, y in odd ones, m.
    pub(super) arm: f64,
    /// Its derivative with respect to θ, m.
    pub(super) turn: f64,
}

/// Signs of the two ends in Φ = first − second.
pub(super) const SIGN: [f64; 2] = [1.0, -1.0];

/// The rows of Φ_q.
#[derive(Clone, Copy, Debug)]
pub struct Pose<const M: usize> {
    pub(super) rows: [[Option<Side>; 2]; M],
}

impl<const M: usize> Pose<M> {
    pub(super) fn new(joints: &[[End; 2]], q: &[f64]) -> Self {
        let mut rows = [[None; 2]; M];
        for (joint, ends) in joints.iter().enumerate() {
            for (trig_base, end) in ends.iter().enumerate() {
                if let End::Body(body, at) = *end {
                    let arm = rotated(at, q[3 * body + 2]);
                    let turn = quarter_turn(arm);
                    for axis in 0..2 {
                        rows[2 * joint + axis][trig_base] = Some(Side { body, arm: arm[axis], turn: turn[axis] });
                    }
                }
            }
        }
        Self { rows }
    }

    /// Sum over the sides of each row.
    fn per_row(&self, term: impl Fn(usize, &Side) -> f64) -> Vector<M> {
        Vector::from_fn(|row| {
            let terms = self.rows[row].iter().zip(SIGN);
            terms.filter_map(|(side, sign)| side.as_ref().map(|side| sign * term(row, side))).sum()
        })
    }

    /// Φ_q v.
    pub(super) fn times<const N: usize>(&self, v: &Vector<N>) -> Vector<M> {
        self.per_row(|row, side| v[3 * side.body + row % 2] + side.turn * v[3 * side.body + 2])
    }

    /// Φ̇_q v at velocity v: arms turn about the centre of mass.
    pub(super) fn dot_times<const N: usize>(&self, v: &Vector<N>) -> Vector<M> {
        self.per_row(|_, side| {
            let omega = v[3 * side.body + 2];
            -omega * omega * side.arm
        })
    }

    /// Φ_qᵀ λ.
    pub(super) fn transposed_times<const N: usize>(&self, lambda: &Vector<M>) -> Vector<N> {
        let mut product = Vector::ZERO;
        for (row, (mode, lambda)) in self.rows.iter().zip(lambda).enumerate() {
            for (side, sign) in mode.iter().zip(SIGN) {
                if let Some(side) = side {
                    product[3 * side.body + row % 2] += sign * lambda;
                    product[3 * side.body + 2] += sign * side.turn * lambda;
                }
            }
        }
        product
    }

    /// The diagonal of ∂(Φ_qᵀλ)/∂q, its only nonzero entries: ∓ arm · λ at θ, N m.
    pub(super) fn geometric_stiffness<const N: usize>(&self, lambda: &Vector<M>) -> Vector<N> {
        let mut diagonal = Vector::ZERO;
        for (mode, lambda) in self.rows.iter().zip(lambda) {
            for (side, sign) in mode.iter().zip(SIGN) {
                if let Some(side) = side {
                    diagonal[3 * side.body + 2] -= sign * side.arm * lambda;
                }
            }
        }
        diagonal
    }
}

/// A vector in body axes at angle θ, converted to ground axes.
pub(crate) fn rotated([x, y]: Planar, theta: f64) -> Planar {
    let (sin, cos) = theta.sin_cos();
    [cos * x - sin * y, sin * x + cos * y]
}

/// Turned by +90°.
pub(super) fn quarter_turn([x, y]: Planar) -> Planar {
    [-y, x]
}
