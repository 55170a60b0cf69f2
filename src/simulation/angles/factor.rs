//! The saddle-point systems of the link angles, 2×2 in each leg.

use super::{ANGLES, Angles, CLOSURES, DISTAL, PROXIMAL};
use crate::integrator::Kkt;
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, both};
use crate::simulation::inertia::{Coupling, Inertia};
use crate::vector::Vector;

/// The factorised saddle-point matrix. The angle of each proximal link is measured in units of 1/√P, with P the first entry of M, so that
/// M = [1 χ; χ D] with the columns p and d of Φ_q; and it is eliminated: with δ = D − χ² and e = d − χ p, what is left of D and d,
/// S = Φ_q M⁻¹ Φ_qᵀ + e 1 = Σ (p pᵀ + e eᵀ/δ) + e 1.
#[derive(Clone, Copy)]
pub struct Factor {
    /// χ, 1/δ and 1/√P.
    along: Legs,
    mobility: Legs,
    per_root: Legs,
    /// p and e/δ.
    by_tip: [Legs2; 2],
    /// S: its diagonal exchanged, yy and xx; xy in both; and 1 over its determinant in both.
    exchanged: Legs,
    beside: Legs,
    reciprocal: Legs,
}

/// The sums over both legs of two numbers of each.
#[inline(always)]
pub(super) fn sums([x, y]: [Legs; 2]) -> Legs {
    let ([x_left, x_right], [y_left, y_right]) = (x.to_array(), y.to_array());
    Legs::new([x_left, y_left]) + Legs::new([x_right, y_right])
}

/// One and the other exchanged.
#[inline(always)]
fn exchanged(x: Legs) -> Legs {
    let [one, other] = x.to_array();
    Legs::new([other, one])
}

impl Factor {
    /// From the coupling of the links and the columns of Φ_q, that of each proximal link by √P.
    #[inline(always)]
    pub(super) fn new(inertia: &Inertia, coupling: &Coupling, [p, d]: [Legs2; 2], regularization: f64) -> Self {
        let &Coupling { along, remainder, .. } = coupling;
        let mobility = both(1.0) / remainder;
        let e = Legs2 { x: d.x - along * p.x, y: d.y - along * p.y };
        let on_e = e.scaled(mobility);
        let diagonal = sums([p.x * p.x + e.x * on_e.x, p.y * p.y + e.y * on_e.y]) + both(regularization);
        let beside = p.x * p.y + e.x * on_e.y;
        let (exchanged, beside) = (exchanged(diagonal), beside + exchanged(beside));
        let reciprocal = both(1.0) / (diagonal * exchanged - beside * beside);
        Self { along, mobility, per_root: inertia.per_root, by_tip: [p, on_e], exchanged, beside, reciprocal }
    }

    /// S⁻¹ x.
    #[inline(always)]
    fn dual_times(&self, x: Legs) -> Legs {
        (self.exchanged * x - self.beside * exchanged(x)) * self.reciprocal
    }

    /// q̈ and λ from torques, those on the proximal links by √P; `lacking` says of how the tips would move apart what the closure lacks.
    #[inline(always)]
    pub(super) fn accelerated(&self, [on_p, on_d]: [Legs; 2], lacking: impl FnOnce([Legs; 2]) -> Legs) -> (Angles, [f64; 2]) {
        let [p, e] = &self.by_tip;
        let on_e = on_d - self.along * on_p;
        let lambda = self.dual_times(lacking([p.x * on_p + e.x * on_e, p.y * on_p + e.y * on_e])).to_array();
        let [x, y] = lambda.map(both);
        (self.moved([on_p - (p.x * x + p.y * y), self.mobility * on_e - (e.x * x + e.y * y)]), lambda)
    }

    /// The angles of which the proximal ones, in their units, are to be freed of what they share with the distal ones.
    #[inline(always)]
    fn moved(&self, [p, e]: [Legs; 2]) -> Angles {
        let mut moved = Angles::ZERO;
        set_legs(&mut moved, PROXIMAL, (p - self.along * e) * self.per_root);
        set_legs(&mut moved, DISTAL, e);
        moved
    }
}

/// What pairs of both links make of two numbers each: Φ_q v.
#[inline]
pub(super) fn at_tip([p, d]: &[Legs2; 2], x: &Angles) -> Vector<CLOSURES> {
    let (on_p, on_d) = (legs_of(x, PROXIMAL), legs_of(x, DISTAL));
    sums([p.x * on_p + d.x * on_d, p.y * on_p + d.y * on_d]).to_array().into()
}

impl Kkt<ANGLES, CLOSURES> for Factor {
    #[inline]
    fn solve(&self, b: &Angles, c: &Vector<CLOSURES>) -> (Angles, Vector<CLOSURES>) {
        let torques = [self.per_root * legs_of(b, PROXIMAL), legs_of(b, DISTAL)];
        let (a, lambda) = self.accelerated(torques, |free| sums(free) - legs_of(c, 0));
        (a, lambda.into())
    }

    #[inline]
    fn correction(&self, c: &Vector<CLOSURES>) -> Angles {
        let [x, y] = self.dual_times(legs_of(c, 0)).to_array().map(both);
        self.moved(self.by_tip.map(|by| by.x * x + by.y * y))
    }
}
