//! Directions of the links, and products of J that need no division.

use super::linkage::{Links, Pair};

/// Directions of the links.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// Unit vectors ûᵢ.
    pub(super) directions: [Pair; 4],
    /// Signed lengths sᵢ lᵢ, m.
    pub(super) arm: Links,
}

impl Posture {
    /// Product J x.
    pub(super) fn end_velocity(&self, x: &Links) -> Pair {
        let mut sum = [0.0; 2];
        for i in 0..4 {
            let [u_x, u_y] = self.directions[i];
            sum[0] -= self.arm[i] * u_y * x[i];
            sum[1] += self.arm[i] * u_x * x[i];
        }
        sum
    }

    /// Rows of J with each link's element times a factor.
    pub(super) fn end_rows(&self, factors: &Links) -> [Links; 2] {
        let arm: Links = std::array::from_fn(|i| self.arm[i] * factors[i]);
        [std::array::from_fn(|i| -arm[i] * self.directions[i][1]), std::array::from_fn(|i| arm[i] * self.directions[i][0])]
    }

    /// Rows of −J̇ at link rates `omega`, rad/s.
    pub(super) fn inward_rows(&self, omega: &Links) -> [Links; 2] {
        [0, 1].map(|k| std::array::from_fn(|i| self.arm[i] * omega[i] * self.directions[i][k]))
    }

    /// Components xx, xy, yy of (JJᵀ)⁻¹, 1/m², and the smallest singular value of J over the mean length `length`, m.
    pub(super) fn gram(&self, length: f64) -> ([f64; 3], f64) {
        /// Regularisation of the determinant relative to the mean length: no division by 0 in a vertex.
        const RANK_LOSS: f64 = 1e-20;
        let scale = length * length;
        // Components by n̂ = (−u_y, u_x).
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for ([x, y], l) in self.directions.into_iter().zip(self.arm) {
            let squared = l * l;
            xx += squared * y * y;
            xy -= squared * x * y;
            yy += squared * x * x;
        }
        let (mean, half) = ((xx + yy) / 2.0, (xx - yy) / 2.0);
        let spread = (half * half + xy * xy).sqrt();
        let (a, c) = (xx + RANK_LOSS * scale, yy + RANK_LOSS * scale);
        let determinant = (a * c - xy * xy).max(RANK_LOSS * scale * scale);
        // σ_min² = det/σ_max², without the cancellation of mean − spread.
        let smallest = ((xx * yy - xy * xy).max(0.0) / (mean + spread)).sqrt() / length;
        ([c / determinant, -xy / determinant, a / determinant], smallest)
    }

    /// Product J⁺ r by means of (JJᵀ)⁻¹.
    pub(super) fn least_squares(&self, [xx, xy, yy]: &[f64; 3], [x, y]: Pair) -> Links {
        self.transposed([xx * x + xy * y, xy * x + yy * y])
    }

    /// Displacement of the tip per turn `x` of the links, m.
    pub(super) fn tip_velocity(&self, x: &Links) -> Pair {
        let arm = [0, 1].map(|i| self.arm[i] * x[i]);
        let [p, d] = [self.directions[0], self.directions[1]];
        [-p[1] * arm[0] - d[1] * arm[1], p[0] * arm[0] + d[0] * arm[1]]
    }

    /// −J̇ x for links that turn at ω: Σ sᵢ lᵢ ûᵢ ωᵢ xᵢ.
    pub(super) fn inward(&self, omega: &Links, x: &Links) -> Pair {
        let mut sum = [0.0; 2];
        for i in 0..4 {
            let part = self.arm[i] * omega[i] * x[i];
            sum[0] += part * self.directions[i][0];
            sum[1] += part * self.directions[i][1];
        }
        sum
    }

    /// Product Jᵀ λ.
    pub(super) fn transposed(&self, [x, y]: Pair) -> Links {
        std::array::from_fn(|i| self.arm[i] * (self.directions[i][0] * y - self.directions[i][1] * x))
    }

    /// Products sᵢ lᵢ ûᵢ·λ.
    pub(super) fn along(&self, [x, y]: Pair) -> Links {
        std::array::from_fn(|i| self.arm[i] * (self.directions[i][0] * x + self.directions[i][1] * y))
    }

    /// Cosine of the angle between two links.
    pub(super) fn cosine(&self, i: usize, k: usize) -> f64 {
        let ([x, y], [v, w]) = (self.directions[i], self.directions[k]);
        x * v + y * w
    }

    /// Sine of the angle from one link to another.
    pub(super) fn sine(&self, from: usize, to: usize) -> f64 {
        let ([x, y], [v, w]) = (self.directions[from], self.directions[to]);
        x * w - y * v
    }

    /// Signed distance from a direct singularity, sin(θ₃ − θ₂): its sign is the assembly.
    pub fn side(&self) -> f64 {
        self.sine(1, 2)
    }

    /// Torques on the links per unit of each input (τ₁, τ₂ in N·m, F_x, F_y in N): rows by link.
    pub(super) fn inputs(&self) -> [[f64; 4]; 4] {
        let mut rows = [[0.0; 4]; 4];
        (rows[0][0], rows[3][1]) = (1.0, 1.0);
        for i in [0, 1] {
            rows[i][2] = -self.arm[i] * self.directions[i][1];
            rows[i][3] = self.arm[i] * self.directions[i][0];
        }
        rows
    }
}
