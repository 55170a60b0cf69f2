//! Collectors of the tangents K = −∂Q/∂q and C = −∂Q/∂q̇ of forces, weighted for a step of h seconds: h/2 C + h²/4 K. There is one
//! collector for each linear solve.

use nalgebra::SMatrix;

use crate::effects::Tangents;
use crate::mechanism::coordinates::{THETA, X, Y};
use crate::mechanism::{COORDINATES, Coordinates};

/// Tangents of scenes without coupled links: diagonal entries of the link angles only.
#[derive(Clone, Copy, Debug)]
pub struct DiagonalTangents {
    half_step: f64,
    /// Weighted tangents h/2 C + h²/4 K, kg·m².
    pub weighted: Coordinates,
}

/// Number of coordinates that effects may couple.
pub const INNER_COUNT: usize = 6;

/// Inner coordinates, those that effects may couple: the position of link 2, on which forces on the tip act, and all link angles.
pub const INNER: [usize; INNER_COUNT] = [X[1], Y[1], THETA[0], THETA[1], THETA[2], THETA[3]];

/// Index of each coordinate in [`INNER`]; [`INNER_COUNT`] for coordinates that are not inner.
pub(super) const INNER_INDEX: [usize; COORDINATES] = {
    let mut place = [INNER_COUNT; COORDINATES];
    let mut i = 0;
    while i < INNER_COUNT {
        place[INNER[i]] = i;
        i += 1;
    }
    place
};

/// Tangents of scenes whose effects couple links.
#[derive(Clone, Copy, Debug)]
pub struct CoupledTangents {
    half_step: f64,
    /// Weighted tangents h/2 C + h²/4 K of the coordinates [`INNER`].
    pub weighted: SMatrix<f64, INNER_COUNT, INNER_COUNT>,
}

impl CoupledTangents {
    /// None yet, for a step of h seconds.
    pub fn new(h: f64) -> Self {
        Self { half_step: h / 2.0, weighted: SMatrix::zeros() }
    }
}

impl Tangents for CoupledTangents {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        self.weighted[(INNER_INDEX[row], INNER_INDEX[column])] += self.half_step * self.half_step * value;
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        self.weighted[(INNER_INDEX[row], INNER_INDEX[column])] += self.half_step * value;
    }
}

/// Tangents without a structure.
#[derive(Clone, Copy, Debug)]
pub struct FullTangents {
    half_step: f64,
    /// Weighted tangents h/2 C + h²/4 K.
    pub weighted: SMatrix<f64, COORDINATES, COORDINATES>,
}

impl DiagonalTangents {
    /// None yet, for a step of h seconds.
    #[inline]
    pub fn new(h: f64) -> Self {
        Self { half_step: h / 2.0, weighted: Coordinates::ZERO }
    }

    #[inline]
    fn add(&mut self, row: usize, column: usize, value: f64) {
        // The assertion costs nothing where row and column are constants.
        assert!(row == column && THETA.contains(&row), "an effect that couples links must say so");
        self.weighted[row] += value;
    }
}

impl Tangents for DiagonalTangents {
    #[inline]
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        self.add(row, column, self.half_step * self.half_step * value);
    }

    #[inline]
    fn damping(&mut self, row: usize, column: usize, value: f64) {
        self.add(row, column, self.half_step * value);
    }
}

impl FullTangents {
    /// None yet, for a step of h seconds.
    pub fn new(h: f64) -> Self {
        Self { half_step: h / 2.0, weighted: SMatrix::zeros() }
    }
}

impl Tangents for FullTangents {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        self.weighted[(row, column)] += self.half_step * self.half_step * value;
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        self.weighted[(row, column)] += self.half_step * value;
    }
}
