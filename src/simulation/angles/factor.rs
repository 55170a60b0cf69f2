//! The saddle-point systems of the link angles, 2×2 in each leg.

use super::{ANGLES, Angles, CLOSURES, DISTAL, PROXIMAL};
use crate::integrator::Kkt;
use crate::mechanism::Pose;
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, both};
use crate::simulation::inertia::{Eliminated, Inertia};
use crate::vector::Vector;

/// The factorised saddle-point matrix. In each leg the angle of the proximal link is eliminated: with p and d the columns of Φ_q, and
/// χ = C/P, δ = D − C²/P of M = [P C; C D], what is left of d is e = d − χ p, and S = Φ_q M⁻¹ Φ_qᵀ + e 1 = Σ (p pᵀ/P + e eᵀ/δ) + e 1.
#[derive(Clone, Copy)]
pub struct Factor {
    mass: Eliminated,
    /// p/P and e/δ.
    by_tip: [Legs2; 2],
    /// S: its diagonal exchanged, yy and xx; xy in both; and 1 over its determinant in both.
    exchanged: Legs,
    beside: Legs,
    reciprocal: Legs,
}

/// The sums over both legs of two numbers of each.
#[inline(always)]
fn sums([x, y]: [Legs; 2]) -> Legs {
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
    #[inline]
    pub(super) fn new(inertia: &Inertia, pose: &Pose, [p, d]: [Legs2; 2], regularization: f64) -> Self {
        let mass = inertia.eliminated(pose);
        let e = Legs2 { x: d.x - mass.share * p.x, y: d.y - mass.share * p.y };
        let by_tip @ [on_p, on_e] = [p.scaled(mass.proximal), e.scaled(mass.distal)];
        let diagonal = sums([p.x * on_p.x + e.x * on_e.x, p.y * on_p.y + e.y * on_e.y]) + both(regularization);
        let beside = p.x * on_p.y + e.x * on_e.y;
        let (exchanged_diagonal, beside) = (exchanged(diagonal), beside + exchanged(beside));
        let reciprocal = both(1.0) / (diagonal * exchanged_diagonal - beside * beside);
        Self { mass, by_tip, exchanged: exchanged_diagonal, beside, reciprocal }
    }

    /// S⁻¹ x.
    #[inline(always)]
    fn dual_times(&self, x: Legs) -> Legs {
        (self.exchanged * x - self.beside * exchanged(x)) * self.reciprocal
    }

    /// M⁻¹ of what is left of a torque on the distal link, and of one on the proximal link.
    #[inline(always)]
    fn moved(&self, [p, e]: [Legs; 2]) -> Angles {
        let mut moved = Angles::ZERO;
        set_legs(&mut moved, PROXIMAL, p - self.mass.share * e);
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
        let [p, e] = &self.by_tip;
        let on_p = legs_of(b, PROXIMAL);
        let on_e = legs_of(b, DISTAL) - self.mass.share * on_p;
        let free = sums([p.x * on_p + e.x * on_e, p.y * on_p + e.y * on_e]);
        let lambda = self.dual_times(free - legs_of(c, 0)).to_array();
        let [x, y] = lambda.map(both);
        let on_p = self.mass.proximal * on_p - (p.x * x + p.y * y);
        let on_e = self.mass.distal * on_e - (e.x * x + e.y * y);
        (self.moved([on_p, on_e]), lambda.into())
    }

    #[inline]
    fn correction(&self, c: &Vector<CLOSURES>) -> Angles {
        let [x, y] = self.dual_times(legs_of(c, 0)).to_array().map(both);
        self.moved(self.by_tip.map(|by| by.x * x + by.y * y))
    }
}
