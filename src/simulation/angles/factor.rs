//! The saddle-point systems of the link angles, 2×2 in each leg.

use super::{ANGLES, Angles, CLOSURES, DISTAL, PROXIMAL};
use crate::integrator::Kkt;
use crate::mechanism::Pose;
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, both, sum};
use crate::simulation::inertia::{Inertia, Mass};
use crate::vector::Vector;

/// The factorised saddle-point matrix: M⁻¹ of each leg, and the inverse of S = Φ_q M⁻¹ Φ_qᵀ + e, 2×2 for both.
#[derive(Clone, Copy)]
pub struct Factor {
    mobility: Mass,
    phi_q: [Legs2; 2],
    /// Inverse of S: xx, xy, yy.
    dual: [f64; 3],
}

impl Factor {
    /// S is computed times both determinants of M, so that its division need not wait for that of M⁻¹.
    #[inline]
    pub(super) fn new(inertia: &Inertia, pose: &Pose, [p, d]: [Legs2; 2], regularization: f64) -> Self {
        let (adjugate, determinant) = inertia.adjugate(pose);
        let [left, right] = determinant.to_array();
        let (others, both_determinants) = (Legs::new([right, left]), left * right);
        let times = |p: Legs, d: Legs| [adjugate.proximal * p + adjugate.coupling * d, adjugate.coupling * p + adjugate.distal * d];
        let ([px, dx], [py, dy]) = (times(p.x, d.x), times(p.y, d.y));
        let regularization = both_determinants * regularization;
        let xx = sum(others * (p.x * px + d.x * dx)) + regularization;
        let xy = sum(others * (p.x * py + d.x * dy));
        let yy = sum(others * (p.y * py + d.y * dy)) + regularization;
        let scale = both_determinants / (xx * yy - xy * xy);
        let mobility = adjugate.scaled(both(1.0) / determinant);
        Self { mobility, phi_q: [p, d], dual: [yy * scale, -xy * scale, xx * scale] }
    }
}

/// Φ_q v.
#[inline]
pub(super) fn end_velocity([p, d]: &[Legs2; 2], v: &Angles) -> Vector<CLOSURES> {
    let (w_p, w_d) = (legs_of(v, PROXIMAL), legs_of(v, DISTAL));
    [sum(p.x * w_p + d.x * w_d), sum(p.y * w_p + d.y * w_d)].into()
}

impl Kkt<ANGLES, CLOSURES> for Factor {
    #[inline]
    fn solve(&self, b: &Angles, c: &Vector<CLOSURES>) -> (Angles, Vector<CLOSURES>) {
        let unconstrained = self.mobility.times(b);
        let [x, y] = *(end_velocity(&self.phi_q, &unconstrained) - *c);
        let [xx, xy, yy] = self.dual;
        let (x, y) = (xx * x + xy * y, xy * x + yy * y);
        let [p, d] = self.phi_q;
        let mut force = Angles::ZERO;
        set_legs(&mut force, PROXIMAL, p.x * both(x) + p.y * both(y));
        set_legs(&mut force, DISTAL, d.x * both(x) + d.y * both(y));
        (unconstrained - self.mobility.times(&force), [x, y].into())
    }
}
