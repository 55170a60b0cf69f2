//! Factorised saddle-point systems in the link angles: 2×2 blocks M⁻¹ per leg, and the 2×2 Schur complement of the closure.

use super::{ANGLES, Angles, CLOSURES, DISTAL, PROXIMAL};
use crate::integrator::Kkt;
use crate::mechanism::Pose;
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, both, sum};
use crate::simulation::inertia::{Inertia, Mass};
use crate::vector::Vector;

/// Factorised saddle-point matrix: M⁻¹ of each leg, and the inverse of the Schur complement S = Φ_q M⁻¹ Φ_qᵀ + e.
#[derive(Clone, Copy)]
pub struct Factor {
    mobility: Mass,
    /// M⁻¹ Φ_qᵀ of the proximal and the distal links: accelerations per unit force at the tip.
    by_tip: [Legs2; 2],
    /// Components xx, xy, yy of S⁻¹.
    dual: [f64; 3],
}

impl Factor {
    #[inline]
    pub(super) fn new(inertia: &Inertia, pose: &Pose, [p, d]: [Legs2; 2], regularization: f64) -> Self {
        let mobility = inertia.inverse(pose);
        let on_p =
            Legs2 { x: mobility.proximal * p.x + mobility.coupling * d.x, y: mobility.proximal * p.y + mobility.coupling * d.y };
        let on_d = Legs2 { x: mobility.coupling * p.x + mobility.distal * d.x, y: mobility.coupling * p.y + mobility.distal * d.y };
        let xx = sum(p.x * on_p.x + d.x * on_d.x) + regularization;
        let xy = sum(p.x * on_p.y + d.x * on_d.y);
        let yy = sum(p.y * on_p.y + d.y * on_d.y) + regularization;
        let reciprocal = 1.0 / (xx * yy - xy * xy);
        Self { mobility, by_tip: [on_p, on_d], dual: [yy * reciprocal, xy * reciprocal, xx * reciprocal] }
    }

    /// Product S⁻¹ x.
    #[inline(always)]
    fn dual_times(&self, [x, y]: [f64; 2]) -> Vector<CLOSURES> {
        let [xx, xy, yy] = self.dual;
        [xx * x - xy * y, yy * y - xy * x].into()
    }

    /// Product M⁻¹ Φ_qᵀ λ.
    #[inline(always)]
    fn by_tip_times(&self, &[x, y]: &[f64; 2]) -> Angles {
        let [p, d] = self.by_tip;
        let mut moved = Angles::ZERO;
        set_legs(&mut moved, PROXIMAL, p.x * both(x) + p.y * both(y));
        set_legs(&mut moved, DISTAL, d.x * both(x) + d.y * both(y));
        moved
    }
}

/// Sums over both legs of two quantities per leg.
#[inline(always)]
pub(super) fn sums([x, y]: [Legs; 2]) -> Legs {
    let ([x_left, x_right], [y_left, y_right]) = (x.to_array(), y.to_array());
    Legs::new([x_left, y_left]) + Legs::new([x_right, y_right])
}

/// Product of a 2 × 4 matrix, stored by links, with the link quantities `x`: Φ_q v, or (M⁻¹ Φ_qᵀ)ᵀ b.
#[inline]
pub(super) fn at_tip([p, d]: &[Legs2; 2], x: &Angles) -> Vector<CLOSURES> {
    let (on_p, on_d) = (legs_of(x, PROXIMAL), legs_of(x, DISTAL));
    sums([p.x * on_p + d.x * on_d, p.y * on_p + d.y * on_d]).to_array().into()
}

impl Kkt<ANGLES, CLOSURES> for Factor {
    #[inline]
    fn solve(&self, b: &Angles, c: &Vector<CLOSURES>) -> (Angles, Vector<CLOSURES>) {
        let lambda = self.dual_times(*(at_tip(&self.by_tip, b) - *c));
        (self.mobility.times(b) - self.by_tip_times(&lambda), lambda)
    }

    #[inline]
    fn correction(&self, c: &Vector<CLOSURES>) -> Angles {
        self.by_tip_times(&self.dual_times(**c))
    }
}
