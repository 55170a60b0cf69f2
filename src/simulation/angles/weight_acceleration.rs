//! Acceleration under the weight alone, in the link angles, in as few operations as possible: the evaluation that fixed costs are measured
//! by.
//!
//! Per leg, with P = I_P + m_P a_P² + m_D l_P², angles of the proximal link are counted in units of 1/√P, so that M = [1 χ; χ D]. In
//! coordinates of the tip turned by −90° the columns of Φ_q are the links themselves, p = σ l_P/√P and d = σ l_D, with the signs of the
//! legs in the closure. Elimination of the proximal angle leaves r = d − χ p and δ = D − χ² of the distal one. Lengths and angles do not
//! depend on the frame; in an upright frame, with the weight along −y, only the first component of a link has a torque. Then
//!
//! ```text
//! S = Σ (p pᵀ + r rᵀ/δ) + e 1,     S μ = Σ (p Q_P + r (Q_D − χ Q_P)/δ + n̂(p) √P ω_P² + n̂(d) ω_D²),
//! α_D = (Q_D − χ Q_P − r·μ)/δ,     √P α_P = Q_P − p·μ − χ α_D.
//! ```
//!
//! Under other loads the forces are known last and few operations may follow them: there M is inverted (`factor.rs`).

use super::factor::sums;
use super::{Angles, DISTAL, PROXIMAL};
use crate::mechanism::coordinates::{D_X, D_Y, P_X, P_Y, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both, sum, turned_with};
use crate::mechanism::{Coordinates, Mechanism};
use crate::simulation::inertia::Inertia;

/// Constant data of the evaluation.
#[derive(Clone, Copy, Debug)]
pub(in crate::simulation) struct WeightAcceleration {
    /// Signed lengths of p and d, times cosine and times sine of the angle from the machine's frame to the upright one.
    lengths: [[Legs; 2]; 2],
    /// Factor m_D a_D / l_D: χ is its product with p·d.
    carried: Legs,
    /// δ of a stretched leg, a sum of positive terms; (carried · p × d)² adds to it.
    stretched: Legs,
    /// √P, with P in kg·m².
    /// Reciprocal 1/√P.
    root: Legs,
    per_root: Legs,
    /// Torques of the weight on links of length 1, N·m.
    on_arms: [Legs2; 2],
    /// Torques of the weight per component of p and d in the upright frame, of which the first alone counts.
    weight: [Legs; 2],
    /// e of the saddle-point system, 1/kg.
    regularization: Legs,
}

/// Base data for small-angle updates of the link directions: directions, and p and d in the upright frame.
#[derive(Clone, Copy, Debug)]
pub struct TrigBase {
    pub(super) directions: [Legs2; 2],
    links: [Legs2; 2],
    /// Twice `links`.
    twice: [Legs2; 2],
}

impl WeightAcceleration {
    /// Constant data of a mechanism under the constant force `force`, N and N·m; `regularization` is e, 1/kg.
    pub(in crate::simulation) fn new(mechanism: &Mechanism, inertia: &Inertia, force: &Coordinates, regularization: f64) -> Self {
        let &Mechanism { mass_d, a_p, b_p, a_d, sigma_b_d, .. } = mechanism;
        let root = inertia.proximal.sqrt();
        let [p, d] = [SIGMA * (a_p + b_p) / root, SIGMA * a_d + sigma_b_d];
        // The proximal link carries at its elbow the force on the distal one.
        let [on_p, on_d] = [[P_X, P_Y], [D_X, D_Y]].map(|[x, y]| Legs2 { x: legs_of(force, x), y: legs_of(force, y) });
        let (own, hung) = (on_p.scaled(a_p), on_d.scaled(a_p + b_p));
        let on_arms = [Legs2 { x: own.x + hung.x, y: own.y + hung.y }, on_d.scaled(a_d)];
        // All weights are parallel to their sum, which is turned to −y.
        let [x, y] = [on_p.x + on_d.x, on_p.y + on_d.y].map(sum);
        let all = libm::hypot(x, y);
        let [cos, sin] = if all > 0.0 { [-y / all, x / all] } else { [1.0, 0.0] }.map(both);
        let upright = |weight: Legs2, length: Legs| (cos * weight.y - sin * weight.x) / length;
        Self {
            lengths: [[p * cos, p * sin], [d * cos, d * sin]],
            carried: SIGMA * mass_d * a_d / d,
            stretched: inertia.stretched / inertia.proximal,
            root,
            per_root: both(1.0) / root,
            on_arms,
            weight: [upright(on_arms[0], root * p), upright(on_arms[1], d)],
            regularization: both(regularization),
        }
    }

    /// Base data for small-angle updates from these directions.
    #[inline(always)]
    pub(super) fn trig_base(&self, directions: [Legs2; 2]) -> TrigBase {
        let links @ [p, d] = [0, 1].map(|link| {
            let (Legs2 { x, y }, [cos, sin]) = (directions[link], self.lengths[link]);
            Legs2 { x: cos * x + sin * y, y: cos * y - sin * x }
        });
        TrigBase { directions, links, twice: [p.scaled(both(2.0)), d.scaled(both(2.0))] }
    }

    /// Torques of the weight on links with these directions, N·m.
    #[inline(always)]
    pub(super) fn torques(&self, [p, d]: [Legs2; 2]) -> [Legs; 2] {
        let [on_p, on_d] = self.on_arms;
        [p.cross(on_p), d.cross(on_d)]
    }

    /// Accelerations q̈, rad/s², at some rates, rad/s, after the links have turned by small angles `by`, rad.
    #[inline(always)]
    pub(super) fn acceleration(&self, trig_base: &TrigBase, by: [Legs; 2], [w_p, w_d]: [Legs; 2]) -> Angles {
        let [p, d] = [0, 1].map(|link| turned_with(trig_base.links[link], trig_base.twice[link], by[link]));
        let (chi, across) = (self.carried * p.dot(d), self.carried * p.cross(d));
        // Torques with the centripetal ones of the distal centre of mass.
        let (s_p, s_d) = (self.root * (w_p * w_p), w_d * w_d);
        let (on_p, on_d) = (p.x * self.weight[0] + across * s_d, d.x * self.weight[1] - across * s_p);
        // Diagonal of S, also with its entries exchanged.
        let mobility = both(1.0) / (self.stretched + across * across);
        let r = Legs2 { x: d.x - chi * p.x, y: d.y - chi * p.y };
        let moved = r.scaled(mobility);
        let diagonal = sums([p.x * p.x + r.x * moved.x, p.y * p.y + r.y * moved.y]) + self.regularization;
        let beside = p.x * p.y + r.x * moved.y;
        let (exchanged, beside) = (other(diagonal), beside + other(beside));
        let reciprocal = both(1.0) / (diagonal * exchanged - beside * beside);
        // Force μ at the tip.
        let on_r = on_d - chi * on_p;
        let lacking =
            sums([p.x * on_p + moved.x * on_r - p.y * s_p - d.y * s_d, p.y * on_p + moved.y * on_r + p.x * s_p + d.x * s_d]);
        let [x, y] = ((exchanged * lacking - beside * other(lacking)) * reciprocal).to_array().map(both);
        let a_d = mobility * on_r - (moved.x * x + moved.y * y);
        let a_p = on_p - (p.x * x + p.y * y) - chi * a_d;
        let mut a = Angles::ZERO;
        set_legs(&mut a, PROXIMAL, self.per_root * a_p);
        set_legs(&mut a, DISTAL, a_d);
        a
    }
}

/// Pair with its two entries exchanged.
#[inline(always)]
fn other(x: Legs) -> Legs {
    let [one, other] = x.to_array();
    Legs::new([other, one])
}
