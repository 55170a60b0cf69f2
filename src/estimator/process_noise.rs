//! Process noise: covariance that white torques and a random walk of the unknown force add over time.

use super::bank::Matrix;
use super::linkage::{Frame, Linkage, dot};
use super::transition::ERRORS;

/// Covariances of the error state (angles rad, rates rad/s, force in torque scales, on the tangent basis) added in h seconds: `white` by a
/// white torque of intensity 1 (N·m)²·s, `walk` by a random walk of the unknown force of intensity 1 (N·m)²/s.
pub(super) struct ProcessNoise {
    pub(super) white: Matrix,
    pub(super) walk: Matrix,
}

impl ProcessNoise {
    /// Process noise of h seconds at a posture.
    pub(super) fn new(linkage: &Linkage, at: &Frame, h: f64) -> Self {
        let [first, second] = at.basis;
        let (m_first, m_second) = (linkage.mass_times(at, &first), linkage.mass_times(at, &second));
        let (a, b, c) = (dot(&first, &m_first), dot(&first, &m_second), dot(&second, &m_second));
        let determinant = a * c - b * b;
        // Mobility (NᵀMN)⁻¹ and its square.
        let (a, b, c) = (c / determinant, -b / determinant, a / determinant);
        let mobility = [[a, b], [b, c]];
        let squared = [[a * a + b * b, b * (a + c)], [b * (a + c), b * b + c * c]];
        let (mut white, mut walk) = ([[0.0; ERRORS]; ERRORS], [[0.0; ERRORS]; ERRORS]);
        for i in 0..2 {
            for k in 0..2 {
                let w = squared[i][k];
                // Integrals of white acceleration, and of an acceleration that is a random walk.
                white[2 + i][2 + k] = w * h;
                white[i][2 + k] = w * h * h / 2.0;
                white[2 + i][k] = w * h * h / 2.0;
                white[i][k] = w * h * h * h / 3.0;
                walk[2 + i][2 + k] = w * h * h * h / 3.0;
                walk[i][2 + k] = w * h * h * h * h / 8.0;
                walk[2 + i][k] = w * h * h * h * h / 8.0;
                walk[i][k] = w * h * h * h * h * h / 20.0;
                walk[2 + i][4 + k] = mobility[i][k] * h * h / 2.0;
                walk[4 + i][2 + k] = mobility[i][k] * h * h / 2.0;
                walk[i][4 + k] = mobility[i][k] * h * h * h / 6.0;
                walk[4 + i][k] = mobility[i][k] * h * h * h / 6.0;
            }
            walk[4 + i][4 + i] = h;
        }
        Self { white, walk }
    }
}
