//! Tangents of forces in the rotations of the links, for the cut loop.

use super::{normals, scaled};
use crate::effects::Tangents;
use crate::mechanism::coordinates::{D_THETA, D_X, D_Y, P_THETA, P_X};
use crate::mechanism::legs::{Legs, Legs2};
use crate::mechanism::secant::StepDirections;

/// Tangents of mean forces over a step as moments of inertia of each leg, kg·m²: rows (proximal, distal) of (f), columns of Δθ and ω̂,
/// whose increments are equal. Entries that couple the legs are left out, so that Newton's method converges a little more slowly.
pub struct LegTangents<'a> {
    /// Directions of the links over the step.
    pub(super) directions: &'a StepDirections,
    /// Arms to the centre of mass of the proximal and of the distal links, along each link of the leg, m.
    pub(super) arms: [[Legs; 2]; 2],
    /// Weights ½h² of K, s², and h of C, s.
    pub(super) weights: [f64; 2],
    /// Sum of the tangents by rows and columns (proximal, distal) and by legs, kg·m².
    pub(super) inertias: [[[f64; 2]; 2]; 2],
}

impl LegTangents<'_> {
    /// Derivatives of a coordinate by the angles of its leg's links, given the normals of the links, m or 1.
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
