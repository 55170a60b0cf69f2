//! The tangent of the cut loop in all unknowns at once. It is used if the iteration leg by leg contracts slowly, because slopes couple the
//! legs or inertias are far apart, and in the fallback stages.
//!
//! With û' = n̂/2 half-way, û' = n̂ at the end, the derivatives s' and c' of the factors, and Δ for the change of w, y and g:
//! ```text
//! Δw = moment(n̂₁ Δω̂ − ω̂ û₁ ΔΔθ),     Δy = moment(n̂₁ ΔΔθ) − Δw − σ(ℓ, L) Δν,     Δg = −Δw − σ(ℓ, L) ΔΛ + slopes of the forces
//! ```

use super::{CUT_UNKNOWNS, CutUnknowns, DISTAL, LAMBDA, MeanSlopes, NU, OpenMotion, OpenResidual, OpenStep};
use crate::dynamics::TipArm;
use crate::effects::Slopes;
use crate::matrix::Inverse;
use crate::mechanism::coordinates::legs_of;
use crate::mechanism::legs::{Legs, Legs2, both};
use crate::vector::Vector;

/// Number of equations and of unknowns: the unknowns of the cut loop and ω̂, in pairs of the legs.
const SIZE: usize = CUT_UNKNOWNS + 4;
/// Pair index of ω̂ among the unknowns, after Δθ, Λ and ν.
const HALF: usize = 4;
/// Pair index of the equations (ν). The equations (f) come first, then the tip's gap and its rate.
const MEAN: usize = 4;
/// Pair indices of the tip's gap and rate among the equations, and of Λ and ν among the unknowns.
const TIP: [usize; 2] = [LAMBDA, NU];

/// Matrix by columns.
struct Matrix([Vector<SIZE>; SIZE]);

impl Matrix {
    /// Adds to the entries of a pair of equations and a pair of unknowns, leg by leg.
    fn add(&mut self, equation: usize, unknown: usize, value: Legs) {
        for (leg, value) in value.to_array().into_iter().enumerate() {
            self.0[2 * unknown + leg][2 * equation + leg] += value;
        }
    }

    /// Adds to the entries of a pair of equations, one per leg, and both components of a force at the tip.
    fn add_tip_column(&mut self, equation: usize, unknown: usize, value: Legs2) {
        for (axis, value) in [value.x, value.y].into_iter().enumerate() {
            for (leg, value) in value.to_array().into_iter().enumerate() {
                self.0[2 * unknown + axis][2 * equation + leg] += value;
            }
        }
    }

    /// Adds to the entries of both components of an equation at the tip and a pair of unknowns, one per leg.
    fn add_tip_row(&mut self, equation: usize, unknown: usize, value: Legs2) {
        for (axis, value) in [value.x, value.y].into_iter().enumerate() {
            for (leg, value) in value.to_array().into_iter().enumerate() {
                self.0[2 * unknown + leg][2 * equation + axis] += value;
            }
        }
    }
}

impl<S: MeanSlopes> OpenStep<'_, S> {
    /// Newton's increments of all unknowns, for slopes of the mean forces and the regularisation e of the tip's closure, 1/kg. The value
    /// of e does not move the root. Increments are not finite if the matrix is singular.
    #[inline(never)]
    pub(super) fn by_whole_tangent(
        &self,
        motion: &OpenMotion,
        balance: &OpenResidual,
        (slopes, arm): (&Slopes, &TipArm),
        regularization: f64,
    ) -> CutUnknowns {
        let OpenMotion { secant, x, half, velocity_defect, ends, gap, rate, .. } = motion;
        let (legs, inertias) = (self.legs, [self.legs.mechanism.inertia_p, self.legs.mechanism.inertia_d]);
        let [own, shared, last] = legs.moment;
        let moments = [[own, shared], [shared, last]];
        let mut matrix = Matrix([Vector::ZERO; SIZE]);
        let (quarter, middle, end) = (both(0.25), secant.middle.along(), secant.end.along());
        for i in 0..2 {
            let (along, across) = (middle[i], middle[i].turned());
            let (s, c, turn) = (secant.sinc[i], secant.cos[i], legs_of(x, i));
            let [slope_s, slope_c] = slopes_of_factors(turn, s, c);
            let spin = half[i] + self.initial_rotations[i];
            let (y, g, length) = (velocity_defect[i], balance.joint_load[i], legs.sigma_length[i]);
            matrix.add(i, i, both(0.5) * s * along.dot(g) - slope_s * across.dot(g));
            matrix.add(i, i, spin * (both(0.5) * slope_s * along.dot(y) + quarter * s * across.dot(y)));
            matrix.add(i, HALF + i, inertias[i] + both(0.5) * s * along.dot(y));
            matrix.add(MEAN + i, i, inertias[i] + slope_c * across.dot(y) - both(0.5) * c * along.dot(y));
            matrix.add(MEAN + i, HALF + i, -inertias[i]);
            let (lever, turning) = (across.scaled(s), along.scaled(both(0.5) * s * spin));
            for j in 0..2 {
                let moment = end[j].scaled(moments[i][j]);
                let (moved, dragged) = (moment.turned(), moment.scaled(half[j]));
                let carried = moved + dragged;
                matrix.add(i, j, turning.dot(carried) - lever.dot(dragged));
                matrix.add(i, HALF + j, lever.dot(moved) - turning.dot(moved));
                matrix.add(MEAN + i, j, c * across.dot(carried));
                matrix.add(MEAN + i, HALF + j, -c * across.dot(moved));
            }
            matrix.add_tip_column(i, TIP[0], lever.scaled(length));
            matrix.add_tip_column(i, TIP[1], turning.scaled(-length));
            matrix.add_tip_column(MEAN + i, TIP[1], across.scaled(-c * length));
            matrix.add_tip_row(TIP[0], i, ends[i]);
            matrix.add_tip_row(TIP[1], HALF + i, ends[i]);
            matrix.add_tip_row(TIP[1], i, end[i].scaled(-length * half[i]));
        }
        self.add_slopes(&mut matrix, motion, slopes, arm);
        for tip in TIP {
            matrix.add(tip, tip, both(-regularization));
        }
        let mut right = Vector::ZERO;
        for (place, left) in [balance.left[0], balance.left[1], Legs::new(*gap), Legs::new(*rate)].into_iter().enumerate() {
            right.set_pair(place, -left);
        }
        // A zero pivot gives increments that are not finite.
        let solution = Inverse::new(matrix.0, 0.0).times(&right);
        CutUnknowns::from_fn(|i| solution[i])
    }

    /// Adds the slopes of the mean forces with respect to Δθ and ω̂, including the slopes by which the joint at the tip couples the legs.
    fn add_slopes(&self, matrix: &mut Matrix, motion: &OpenMotion, slopes: &Slopes, arm: &TipArm) {
        let squared = 0.5 * self.h * self.h;
        for (unknown, weights) in [(0, [squared, 0.0]), (HALF, [0.0, self.h])] {
            for (i, row) in self.inertias_of(motion, slopes, arm, weights).into_iter().enumerate() {
                for (j, value) in row.into_iter().enumerate() {
                    matrix.add(i, unknown + j, value);
                }
            }
            let between = slopes.between_legs(weights);
            for (leg, other) in [(0, 1), (1, 0)] {
                matrix.0[2 * (unknown + DISTAL) + leg][2 * DISTAL + other] += between;
            }
        }
    }
}

/// Derivatives of s = sin(d/2)/(d/2) and of c = cos(d/2) with respect to d.
fn slopes_of_factors(d: Legs, s: Legs, c: Legs) -> [Legs; 2] {
    // For small d the difference c − s cancels, so the series is used.
    let series = d * (d * d * both(1.0 / 480.0) - both(1.0 / 12.0));
    let small = d.abs().simd_lt(both(1e-2));
    [small.select(series, (c - s) / d), both(-0.25) * d * s]
}
