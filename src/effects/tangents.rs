//! Where forces put their tangents.

/// Takes the tangents K = −∂Q/∂q and C = −∂Q/∂q̇ of forces.
pub trait Tangents {
    /// Adds K[row][column], N/m, N or N·m/rad by coordinate.
    fn stiffness(&mut self, row: usize, column: usize, value: f64);
    /// Adds C[row][column], N·s/m, N·s or N·m·s/rad by coordinate.
    fn damping(&mut self, row: usize, column: usize, value: f64);
}

/// For places that are not in a step: the tangents of each effect are one piece of code for all of them.
impl Tangents for &mut dyn Tangents {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        (**self).stiffness(row, column, value);
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        (**self).damping(row, column, value);
    }
}
