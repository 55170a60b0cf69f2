//! Interface by which force laws hand over their tangents K = −∂Q/∂q and C = −∂Q/∂q̇.

/// Collects the tangents K = −∂Q/∂q and C = −∂Q/∂q̇ of forces.
pub trait Tangents {
    /// Adds K[row][column], N/m, N or N·m/rad by coordinate.
    fn stiffness(&mut self, row: usize, column: usize, value: f64);
    /// Adds C[row][column], N·s/m, N·s or N·m·s/rad by coordinate.
    fn damping(&mut self, row: usize, column: usize, value: f64);
}

/// Dynamic dispatch for callers outside a step, which then share one compiled copy of each effect's tangents.
impl Tangents for &mut dyn Tangents {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        (**self).stiffness(row, column, value);
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        (**self).damping(row, column, value);
    }
}
