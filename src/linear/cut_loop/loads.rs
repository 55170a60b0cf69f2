//! Tangents of loads in the turns of the links.

use super::{normals, scaled};
use crate::effects::Tangents;
use crate::mechanism::coordinates::{D_THETA, D_X, D_Y, P_THETA, P_X};
use crate::mechanism::legs::{Legs, Legs2};
use crate::mechanism::secant::StepDirections;

/// Tangents of loads over a step as moments of inertia of each leg: by rows (proximal, distal) of momentum and columns of Δθ and ω̂, which
/// change together. What couples the legs is left out: Newton's method converges a little more slowly.
pub struct LegTangents<'a> {
    pub(super) directions: &'a StepDirections,
    /// Of the proximal and of the distal links, from the joints of either link to the centre of mass.
    pub(super) arms: [[Legs; 2]; 2],
    /// ½h² of K and h of C.
    pub(super) weights: [f64; 2],
    pub(super) inertias: [[[f64; 2]; 2]; 2],
}

impl LegTangents<'_> {
    /// How far a coordinate moves by turns of its leg's links, with their normals at the end, or in the middle, shortened.
    #[inline(always)]
    fn levers(&self, coordinate: usize, normals: [Legs2; 2]) -> [f64; 2] {
        let (kind, leg) = (coordinate / 2, coordinate % 2);
        match kind {
            P_THETA => [1.0, 0.0],
            D_THETA => [0.0, 1.0],
            _ => {
                let arms = self.arms[usize::from(kind == D_X || kind == D_Y)];
                let along = |link: usize| {
                    let normal = normals[link];
                    let component = if kind == P_X || kind == D_X { normal.x } else { normal.y };
                    (arms[link] * component).to_array()[leg]
                };
                [along(0), along(1)]
            }
        }
    }

    #[inline(always)]
    fn add(&mut self, [row, column]: [usize; 2], value: f64) {
        let leg = row % 2;
        if column % 2 != leg {
            return;
        }
        let rows = self.levers(row, scaled(normals(self.directions.middle), self.directions.sinc));
        let columns = self.levers(column, normals(self.directions.end));
        for (inertias, row) in self.inertias.iter_mut().zip(rows) {
            for (inertia, column) in inertias.iter_mut().zip(columns) {
                inertia[leg] += row * value * column;
            }
        }
    }
}

impl Tangents for LegTangents<'_> {
    #[inline(always)]
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        self.add([row, column], self.weights[0] * value);
    }

    #[inline(always)]
    fn damping(&mut self, row: usize, column: usize, value: f64) {
        self.add([row, column], self.weights[1] * value);
    }
}
