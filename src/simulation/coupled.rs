//! The linear solve for scenes whose effects couple links through K and C: friction at elbows and tip, contact.
//!
//! What they couple are the four link angles and the position of link 2: six inner coordinates with a full block of A₀, which need
//! not be symmetric. The six outer ones keep their masses. The dual (Schur) matrix S = Φ_q A₀⁻¹ Φ_qᵀ + e is then full, 10×10:
//! outer coordinates add 1/m between neighbouring joints, inner ones Φ_I A_I⁻¹ Φ_Iᵀ.

use nalgebra::{Const, LU, SMatrix, SVector};

use crate::effects::tangents::{INNER, INNERS};
use crate::integrator::{Failure, Kkt};
use crate::mechanism::coordinates::{E_X, E_Y, G_X, G_Y, TIP_X, TIP_Y, X, Y};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};

/// Coordinates whose rows of A₀ hold nothing but a mass.
const OUTER: [usize; COORDINATES - INNERS] = [X[0], X[2], X[3], Y[0], Y[2], Y[3]];

/// The two constraint equations that each of them is in, and its signs there: x of links 1, 3, 4, then y.
const NEIGHBOURS: [[(usize, f64); 2]; COORDINATES - INNERS] = [
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
    /// 1/m of the outer coordinates.
    mobility: [f64; COORDINATES - INNERS],
    /// A_I⁻¹.
    compliance: SMatrix<f64, INNERS, INNERS>,
    dual: LU<f64, Const<MULTIPLIERS>, Const<MULTIPLIERS>>,
}

/// Columns of Φ_q that belong to the inner coordinates.
fn inner_columns(pose: &Pose) -> SMatrix<f64, MULTIPLIERS, INNERS> {
    let mut columns = SMatrix::zeros();
    for (column, [elbow, tip]) in [[2 * E_X, TIP_X], [2 * E_Y, TIP_Y]].into_iter().enumerate() {
        columns[(elbow, column)] = 1.0;
        columns[(tip, column)] = 1.0;
    }
    let turned =
        [pose.a_p, pose.b_p, pose.a_d, pose.sigma_b_d].map(|arm| arm.turned()).map(|arm| [arm.x.to_array(), arm.y.to_array()]);
    let [a_p, b_p, a_d, sigma_b_d] = turned;
    for (leg, [proximal, distal]) in [[2, 3], [5, 4]].into_iter().enumerate() {
        for (axis, [ground, elbow, tip]) in [[2 * G_X, 2 * E_X, TIP_X], [2 * G_Y, 2 * E_Y, TIP_Y]].into_iter().enumerate() {
            columns[(ground + leg, proximal)] = -a_p[axis][leg];
            columns[(elbow + leg, proximal)] = -b_p[axis][leg];
            columns[(elbow + leg, distal)] = -a_d[axis][leg];
            columns[(tip, distal)] = sigma_b_d[axis][leg];
        }
    }
    columns
}

impl Coupled {
    /// Factorises for the masses of the outer coordinates and the block of A₀ of the inner ones, whose symmetric part is positive.
    pub fn factor(pose: &Pose, masses: &Coordinates, inner: SMatrix<f64, INNERS, INNERS>, softness: f64) -> Result<Self, Failure> {
        // A block with a positive symmetric part is regular: only values that are not finite make it fail.
        let compliance = inner.try_inverse().ok_or(Failure::NotFinite)?;
        let columns = inner_columns(pose);
        let mut dual = columns * compliance * columns.transpose();
        let mobility = OUTER.map(|i| 1.0 / masses[i]);
        for (mobility, neighbours) in mobility.into_iter().zip(NEIGHBOURS) {
            for (row, sign) in neighbours {
                for (column, other) in neighbours {
                    dual[(row, column)] += sign * other * mobility;
                }
            }
        }
        for i in 0..MULTIPLIERS {
            dual[(i, i)] += softness;
        }
        Ok(Self { pose: *pose, mobility, compliance, dual: dual.lu() })
    }

    /// A₀⁻¹ x.
    fn yielded(&self, x: &Coordinates) -> Coordinates {
        let mut result = [0.0; COORDINATES];
        for (i, mobility) in OUTER.into_iter().zip(self.mobility) {
            result[i] = mobility * x[i];
        }
        let inner = self.compliance * SVector::from(INNER.map(|i| x[i]));
        for (i, value) in INNER.into_iter().zip(inner.iter()) {
            result[i] = *value;
        }
        result
    }
}

impl Kkt<COORDINATES, MULTIPLIERS> for Coupled {
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        let unconstrained = self.yielded(b);
        let velocity = self.pose.phi_q_times(&unconstrained);
        let mut y = SVector::<f64, MULTIPLIERS>::from_fn(|i, _| velocity[i] - c[i]);
        // Where extreme values have made it singular all the same, the caller's check for finite results ends the step.
        if !self.dual.solve_mut(&mut y) {
            y.fill(f64::NAN);
        }
        let y: Multipliers = y.into();
        let pull = self.yielded(&self.pose.phi_q_transposed_times(&y));
        (std::array::from_fn(|i| unconstrained[i] - pull[i]), y)
    }
}
