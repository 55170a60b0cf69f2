//! Distance to direct, inverse and constraint singularities; assembly and working modes (`docs/vertices.md`, "Singularities").
//!
//! Differentiating |Q − A_i|² = const for the tip Q and the elbows A_i gives J_x ẋ = J_q θ̇, with rows (Q − A_i) in J_x. In link directions
//! det J_x = l₂ l₃ û₂ × û₃ and det J_q = Π l_P l_D û_P × û_D.

use super::{Assembly, Geometry, Pose};
use crate::scalar::Scalar;

/// Threshold of a singularity: for a determinant relative to its largest value, and for the smallest singular value of Φ_q in its own unit.
/// Condition numbers above 1000 count as singular.
const SINGULARITY_THRESHOLD: f64 = 1e-3;

/// Kind of the gravest singularity near a posture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SingularityKind {
    /// Regular posture.
    None,
    /// |det J_x| below 1e-3 of its largest possible value: distal links in line.
    Direct,
    /// |det J_q| below 1e-3 of its largest possible value: a leg stretched or folded.
    Inverse,
    /// Direct and inverse at once.
    Combined,
    /// The smallest singular value of Φ_q is below 1e-3: the constraints lose rank, with all links near one line through the motors.
    Constraint,
}

/// Determinants and singular values of the Jacobians J_x and J_q, and the assembly and working modes, which follow from their signs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jacobians<T = f64> {
    /// det J_x, m².
    pub det_jx: T,
    /// det J_q, m⁴.
    pub det_jq: T,
    /// Smallest singular value of J_x, m.
    pub sigma_jx: T,
    /// Smallest singular value of J_q, m².
    pub sigma_jq: T,
    /// Assembly mode of the posture: the sign of det J_x.
    pub assembly: Assembly,
    /// Working mode: whether the left and the right elbow bend counter-clockwise.
    pub working: [bool; 2],
}

/// Distance to the singularities, and the modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Singularity {
    /// Determinants and modes.
    pub jacobians: Jacobians,
    /// Smallest singular value of Φ_q (rows in m, columns in m and rad).
    pub sigma_phi: f64,
    /// Kind of the gravest singularity near the posture.
    pub kind: SingularityKind,
}

impl Pose {
    /// Signs of the configuration, one bit for each negative value: det J_x (assembly mode), then the bend of the left and of the right
    /// elbow (working mode). A changed bit means that the motion passed a direct or an inverse singularity.
    pub fn configuration_signs(&self) -> u8 {
        let [tip, left, right] = self.sines();
        u8::from(tip < 0.0) | u8::from(left < 0.0) << 1 | u8::from(right < 0.0) << 2
    }

    /// Relative event indicators: each changes sign when a mode changes or the threshold of a direct or inverse singularity is crossed.
    pub fn configuration_indicators(&self) -> [f64; 5] {
        let [tip, left, right] = self.sines();
        [tip, left, right, tip.abs() - SINGULARITY_THRESHOLD, (left * right).abs() - SINGULARITY_THRESHOLD]
    }

    /// Sines of three angles: between the distal links, and at the left and the right elbow.
    pub fn sines(&self) -> [f64; 3] {
        let ([x2, x3], [y2, y3]) = (self.u_d.x.to_array(), self.u_d.y.to_array());
        let [left, right] = self.u_p.cross(self.u_d).to_array();
        [x2 * y3 - y2 * x3, left, right]
    }
}

impl Pose {
    /// Directions û of links 1 to 4.
    pub fn directions(&self) -> [[f64; 2]; 4] {
        let [p_x, p_y, d_x, d_y] = [self.u_p.x, self.u_p.y, self.u_d.x, self.u_d.y].map(|x| x.to_array());
        [[p_x[0], p_y[0]], [d_x[0], d_y[0]], [d_x[1], d_y[1]], [p_x[1], p_y[1]]]
    }
}

/// Event indicator that changes sign at the threshold of a constraint singularity, in the unit of σ.
pub fn rank_indicator(sigma_phi: f64) -> f64 {
    sigma_phi - SINGULARITY_THRESHOLD
}

impl Geometry {
    /// Determinants, smallest singular values and modes from the directions û of links 1 to 4.
    pub fn jacobians<T: Scalar>(&self, directions: [[T; 2]; 4]) -> Jacobians<T> {
        let [p1, l2, l3, p4] = self.lengths();
        let sine = |from: usize, to: usize| {
            let ([x, y], [x_to, y_to]) = (directions[from], directions[to]);
            x * y_to - y * x_to
        };

        let det_jx = sine(1, 2) * (l2 * l3);
        // Since σ_max σ_min = |det| and σ_max² + σ_min² = l₂² + l₃², σ_min has no cancellation near a singularity.
        let trace = l2 * l2 + l3 * l3;
        let det = det_jx.magnitude(l2 * l3);
        let spread = ((-det * 2.0 + trace) * (det * 2.0 + trace)).root(trace * trace);
        let sigma_max = ((spread + trace) / 2.0).sqrt();

        let (left, right) = (sine(0, 1) * (p1 * l2), sine(3, 2) * (p4 * l3));
        Jacobians {
            det_jx,
            det_jq: left * right,
            sigma_jx: det / sigma_max,
            sigma_jq: T::smallest([left.magnitude(p1 * l2), right.magnitude(p4 * l3)]),
            assembly: if det_jx.value() >= 0.0 { Assembly::Plus } else { Assembly::Minus },
            working: [left, right].map(|bend| bend.value() >= 0.0),
        }
    }

    /// Kind of the gravest singularity, from the Jacobians and the smallest singular value of Φ_q.
    pub fn singularity_kind(&self, jacobians: &Jacobians, sigma_phi: f64) -> SingularityKind {
        let [p1, l2, l3, p4] = self.lengths();
        let direct = jacobians.det_jx.abs() < SINGULARITY_THRESHOLD * l2 * l3;
        let inverse = jacobians.det_jq.abs() < SINGULARITY_THRESHOLD * p1 * l2 * p4 * l3;
        match (direct, inverse) {
            _ if sigma_phi < SINGULARITY_THRESHOLD => SingularityKind::Constraint,
            (true, true) => SingularityKind::Combined,
            (true, false) => SingularityKind::Direct,
            (false, true) => SingularityKind::Inverse,
            (false, false) => SingularityKind::None,
        }
    }
}
