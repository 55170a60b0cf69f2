//! Distance to the singularities, and their kinds (`docs/method.md`, "Singularities").
//!
//! From |Q − A_i|² = const, with A_i the elbows: J_x ẋ = J_q θ̇, rows (Q − A_i) of J_x. In link directions
//! det J_x = l₂ l₃ û₂ × û₃ and det J_q = Π l_P l_D û_P × û_D.

use super::legs::{Legs, Legs2};
use super::{Assembly, Mechanism, Pose};

/// Relative size of a determinant, and absolute size of the smallest singular value of Φ_q, that counts as singular.
const NEAR: f64 = 1e-3;

/// The gravest singularity within reach.
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
    /// The smallest singular value of Φ_q below 1e-3: the constraints lose rank, all links near one line through the motors.
    Constraint,
}

/// The Jacobians of the closed loop, and the modes that their signs are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jacobians {
    /// det J_x, m².
    pub det_jx: f64,
    /// det J_q, m⁴.
    pub det_jq: f64,
    /// Smallest singular value of J_x, m.
    pub sigma_jx: f64,
    /// Smallest singular value of J_q, m².
    pub sigma_jq: f64,
    /// Side on which the tip lies now: the sign of det J_x.
    pub assembly: Assembly,
    /// Whether the left and the right leg bend counter-clockwise.
    pub working: [bool; 2],
}

/// Distance to the singularities, and the modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Singularity {
    /// What costs little.
    pub jacobians: Jacobians,
    /// Smallest singular value of Φ_q (rows in m, columns in m and rad).
    pub sigma_phi: f64,
    /// The gravest singularity within reach.
    pub kind: SingularityKind,
}

#[inline(always)]
fn cross(a: Legs2, b: Legs2) -> Legs {
    a.x * b.y - a.y * b.x
}

impl Pose {
    /// The signs that tell modes apart, a bit for each that is negative: det J_x (assembly), bend of the left and right leg (working
    /// mode). A bit that changes is a direct or inverse singularity passed.
    #[inline(always)]
    pub fn modes(&self) -> u8 {
        let ([x2, x3], [y2, y3]) = (self.u_d.x.to_array(), self.u_d.y.to_array());
        let [left, right] = cross(self.u_p, self.u_d).to_array();
        u8::from(x2 * y3 - y2 * x3 < 0.0) | u8::from(left < 0.0) << 1 | u8::from(right < 0.0) << 2
    }
}

impl Mechanism {
    /// Determinants, smallest singular values and modes at a pose.
    pub fn jacobians(&self, pose: &Pose) -> Jacobians {
        let [p1, l2, l3, p4] = self.geometry.links.map(|link| link.length);

        let ([x2, x3], [y2, y3]) = (pose.u_d.x.to_array(), pose.u_d.y.to_array());
        let det_jx = l2 * l3 * (x2 * y3 - y2 * x3);
        // σ_max σ_min = |det|, σ_max² + σ_min² = l₂² + l₃²: no cancellation in σ_min near a singularity.
        let trace = l2 * l2 + l3 * l3;
        let sigma_max = ((trace + ((trace - 2.0 * det_jx.abs()) * (trace + 2.0 * det_jx.abs())).max(0.0).sqrt()) / 2.0).sqrt();

        let bend = cross(pose.u_p, pose.u_d).to_array();
        let (left, right) = (p1 * l2 * bend[0], p4 * l3 * bend[1]);

        Jacobians {
            det_jx,
            det_jq: left * right,
            sigma_jx: det_jx.abs() / sigma_max,
            sigma_jq: left.abs().min(right.abs()),
            assembly: if det_jx >= 0.0 { Assembly::Plus } else { Assembly::Minus },
            working: bend.map(|bend| bend >= 0.0),
        }
    }

    /// All of it: the singular values of Φ_q cost some twenty times what the Jacobians do.
    pub fn singularity(&self, pose: &Pose) -> Singularity {
        let jacobians = self.jacobians(pose);
        let [p1, l2, l3, p4] = self.geometry.links.map(|link| link.length);
        let sigma_phi = pose.phi_q().singular_values().min();
        let direct = jacobians.det_jx.abs() < NEAR * l2 * l3;
        let inverse = jacobians.det_jq.abs() < NEAR * p1 * l2 * p4 * l3;
        let kind = match (direct, inverse) {
            _ if sigma_phi < NEAR => SingularityKind::Constraint,
            (true, true) => SingularityKind::Combined,
            (true, false) => SingularityKind::Direct,
            (false, true) => SingularityKind::Inverse,
            (false, false) => SingularityKind::None,
        };
        Singularity { jacobians, sigma_phi, kind }
    }
}
