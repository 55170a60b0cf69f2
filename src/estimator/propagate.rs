//! Propagation of errors and covariances from one tangent space to another.

use super::bank::{Error, Matrix};
use super::linkage::{Frame, Pair};
use super::transition::{ERRORS, Flow};

/// Index of the first force component in an error.
pub(super) const FORCE: usize = 4;

/// F P Fᵀ, symmetric to the bit, for a transition without feedback of angles and rates on the force.
#[inline(never)]
pub(super) fn propagate_covariance(f: &Matrix, p: &Matrix) -> Matrix {
    let mut half = [[0.0; ERRORS]; ERRORS];
    for i in 0..ERRORS {
        for k in (if i < FORCE { 0 } else { FORCE })..ERRORS {
            let factor = f[i][k];
            for j in 0..ERRORS {
                half[i][j] += factor * p[k][j];
            }
        }
    }
    let mut product = [[0.0; ERRORS]; ERRORS];
    for j in 0..ERRORS {
        for i in j..ERRORS {
            let sum: f64 = (if j < FORCE { 0 } else { FORCE }..ERRORS).map(|k| half[i][k] * f[j][k]).sum();
            product[i][j] = sum;
            product[j][i] = sum;
        }
    }
    product
}

/// Error with each pair of components mapped by `turn`.
#[inline]
pub(super) fn turned(turn: &[Pair; 2], x: &Error) -> Error {
    std::array::from_fn(|i| {
        let [first, second] = turn[i % 2];
        first * x[i - i % 2] + second * x[i - i % 2 + 1]
    })
}

pub(super) fn apply(f: &Matrix, x: &Error) -> Error {
    std::array::from_fn(|i| (0..ERRORS).map(|k| f[i][k] * x[k]).sum())
}

/// Transition matrix between two tangent spaces: derivatives of the flow for angles and rates, and the basis map for the force.
#[inline(never)]
pub(super) fn transition(from: &Frame, to: &Frame, flow: &Flow) -> Matrix {
    let mut f = [[0.0; ERRORS]; ERRORS];
    for k in 0..ERRORS {
        let (turned, quickened) = flow.column(k);
        let (angles, rates) = (to.coordinates(&turned), to.coordinates(&quickened));
        for i in 0..2 {
            f[i][k] = angles[i];
            f[2 + i][k] = rates[i];
        }
    }
    turn_force(&mut f, from.basis_map_to(to));
    f
}

/// Transition matrix without knowledge of the forces: angles follow the rates.
#[cold]
#[inline(never)]
pub(super) fn straight(from: &Frame, to: &Frame, h: f64) -> Matrix {
    let turned = from.basis_map_to(to);
    let mut f = [[0.0; ERRORS]; ERRORS];
    for i in 0..2 {
        for k in 0..2 {
            f[i][k] = turned[i][k];
            f[2 + i][2 + k] = turned[i][k];
            f[i][2 + k] = h * turned[i][k];
        }
    }
    turn_force(&mut f, turned);
    f
}

/// Transition matrix transferred to neighbouring tangent spaces: `onto` maps errors to its start, `back` from its end.
#[inline(never)]
pub(super) fn between_frames(f: &Matrix, onto: &[Pair; 2], back: &[Pair; 2]) -> Matrix {
    let transposed = [[onto[0][0], onto[1][0]], [onto[0][1], onto[1][1]]];
    let half = f.map(|row| turned(&transposed, &row));
    std::array::from_fn(|i| {
        let ([first, second], pair) = (back[i % 2], i - i % 2);
        std::array::from_fn(|k| first * half[pair][k] + second * half[pair + 1][k])
    })
}

fn turn_force(f: &mut Matrix, turned: [Pair; 2]) {
    for i in 0..2 {
        for k in 0..2 {
            f[4 + i][4 + k] = turned[i][k];
        }
    }
}
