//! The linear solve for scenes whose effects couple links through K and C: friction at elbows and tip, contact.
//!
//! Such effects couple the four link angles and the position of link 2. The block A_I of A₀ for these six inner coordinates is full and
//! need not be symmetric; the six outer coordinates keep their masses. The dual (Schur) matrix S = Φ_q A₀⁻¹ Φ_qᵀ + e is then full, 10×10:
//! outer coordinates add 1/m between neighbouring joints, inner coordinates add Φ_I A_I⁻¹ Φ_Iᵀ.

use crate::dynamics::{INNER, INNER_COUNT};
use crate::integrator::Kkt;
use crate::matrix::{Inverse, Lu};
use crate::mechanism::coordinates::{E_X, E_Y, G_X, G_Y, TIP_X, TIP_Y, X, Y};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};
use crate::vector::Vector;

/// Outer coordinates: their rows of A₀ contain only a mass.
const OUTER: [usize; COORDINATES - INNER_COUNT] = [X[0], X[2], X[3], Y[0], Y[2], Y[3]];

/// The two constraint equations that contain each outer coordinate, with its signs in them: x of links 1, 3, 4, then y.
const NEIGHBOURS: [[(usize, f64); 2]; COORDINATES - INNER_COUNT] = [
    [(2 * G_X, 1.0), (2 * E_X, -1.0)],
    [(2 * E_X + 1, 1.0), (TIP_X, -1.0)],
    [(2 * G_X + 1, 1.0), (2 * E_X + 1, -1.0)],
    [(2 * G_Y, 1.0), (2 * E_Y, -1.0)],
    [(2 * E_Y + 1, 1.0), (TIP_Y, -1.0)],
    [(2 * G_Y + 1, 1.0), (2 * E_Y + 1, -1.0)],
];

/// The factorised saddle-point matrix of a five-bar with coupled links.
#[derive(Clone, Debug)]
pub struct Coupled {
    pose: Pose,
    /// Mobilities 1/m of the outer coordinates, 1/kg.
    mobility: [f64; COORDINATES - INNER_COUNT],
    /// A_I⁻¹.
    compliance: Inverse<INNER_COUNT>,
    dual: Lu<MULTIPLIERS>,
}

/// The product Φ_I X, by rows: Φ_I holds the columns of Φ_q for the inner coordinates.
fn phi_inner_times<const K: usize>(pose: &Pose, x: &[Vector<K>; INNER_COUNT]) -> [Vector<K>; MULTIPLIERS] {
    /// Indices of the proximal angles, left and right, among the inner coordinates; the first two are x and y of link 2.
    const INNER_PROXIMAL: [usize; 2] = [2, 5];
    /// Indices of the distal angles, left and right, among the inner coordinates.
    const INNER_DISTAL: [usize; 2] = [3, 4];
    let [a_p, b_p, a_d, sigma_b_d] =
        [pose.a_p, pose.b_p, pose.a_d, pose.sigma_b_d].map(|arm| arm.turned()).map(|arm| [arm.x.to_array(), arm.y.to_array()]);
    let mut product = [Vector::ZERO; MULTIPLIERS];
    for (axis, [ground, elbow, tip]) in [[2 * G_X, 2 * E_X, TIP_X], [2 * G_Y, 2 * E_Y, TIP_Y]].into_iter().enumerate() {
        for leg in [0, 1] {
            let [proximal, distal] = [x[INNER_PROXIMAL[leg]], x[INNER_DISTAL[leg]]];
            product[ground + leg] = -a_p[axis][leg] * proximal;
            product[elbow + leg] = -b_p[axis][leg] * proximal - a_d[axis][leg] * distal;
        }
        let position = x[axis];
        product[elbow] += position;
        let [left, right] = sigma_b_d[axis];
        product[tip] = position + left * x[INNER_DISTAL[0]] + right * x[INNER_DISTAL[1]];
    }
    product
}

fn transposed<const K: usize, const L: usize>(rows: &[Vector<K>; L]) -> [Vector<L>; K] {
    std::array::from_fn(|j| Vector::from_fn(|i| rows[i][j]))
}

impl Coupled {
    /// Factorises for the masses of the outer coordinates and the inner block of A₀, given by columns. Its symmetric part must be positive;
    /// the symmetric part of the dual matrix is then positive too. If values are not finite, the caller's check of the results ends the
    /// step.
    pub fn factor(pose: &Pose, masses: &Coordinates, inner: [Vector<INNER_COUNT>; INNER_COUNT], regularization: f64) -> Self {
        let compliance = Inverse::new(inner, f64::MIN_POSITIVE);
        // Φ_I A_I⁻¹ Φ_Iᵀ is computed from Φ_I A_I⁻ᵀ: the rows of A_I⁻ᵀ are the columns of A_I⁻¹.
        let mut dual = phi_inner_times(pose, &transposed(&phi_inner_times(pose, compliance.columns())));
        let mobility = OUTER.map(|i| 1.0 / masses[i]);
        for (mobility, neighbours) in mobility.into_iter().zip(NEIGHBOURS) {
            for (row, sign) in neighbours {
                for (column, other) in neighbours {
                    dual[row][column] += sign * other * mobility;
                }
            }
        }
        for (i, row) in dual.iter_mut().enumerate() {
            row[i] += regularization;
        }
        Self { pose: *pose, mobility, compliance, dual: Lu::new(dual) }
    }

    /// The product A₀⁻¹ x.
    fn apply_inverse_mass(&self, x: &Coordinates) -> Coordinates {
        let mut result = Coordinates::ZERO;
        for (i, mobility) in OUTER.into_iter().zip(self.mobility) {
            result[i] = mobility * x[i];
        }
        let inner = self.compliance.times(&INNER.map(|i| x[i]).into());
        for (i, value) in INNER.into_iter().zip(&inner) {
            result[i] = *value;
        }
        result
    }
}

impl Kkt<COORDINATES, MULTIPLIERS> for Coupled {
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        let unconstrained = self.apply_inverse_mass(b);
        let y = self.dual.solve(self.pose.phi_q_times(&unconstrained) - *c);
        (unconstrained - self.apply_inverse_mass(&self.pose.phi_q_transposed_times(&y)), y)
    }
}
