//! A machine on which nothing acts but its weight: the evaluation that all others are measured by.

use super::factor::{Factor, sums};
use super::{Angles, ByAngles, CLOSURES, legs};
use crate::mechanism::coordinates::{D_X, D_Y, P_X, P_Y, legs_of};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, turned_by};
use crate::mechanism::{Coordinates, Mechanism};
use crate::simulation::inertia::Inertia;

/// What of it is constant, for links as long as they are in Φ_q: with the signs of the legs in the closure of the tip, the proximal ones by √P.
#[derive(Clone, Copy, Debug)]
pub(in crate::simulation) struct Falling {
    /// Those lengths, of the proximal and the distal links.
    pub(super) lengths: [Legs; 2],
    /// m_D a_D / l_D: times the scalar and the vector product of both links.
    carried: Legs,
    /// The weight where it pulls at both links: by the vector product a torque, on the proximal one by √P.
    weight: [Legs2; 2],
}

impl Falling {
    /// Of a mechanism and the constant forces on it.
    pub(in crate::simulation) fn new(mechanism: &Mechanism, inertia: &Inertia, force: &Coordinates) -> Self {
        let &Mechanism { mass_d, a_p, b_p, a_d, sigma_b_d, .. } = mechanism;
        let lengths = [SIGMA * (a_p + b_p) * inertia.per_root, SIGMA * a_d + sigma_b_d];
        // The proximal link carries the force on the distal one at its elbow.
        let [on_p, on_d] = [[P_X, P_Y], [D_X, D_Y]].map(|[x, y]| Legs2 { x: legs_of(force, x), y: legs_of(force, y) });
        let (own, carried) = (on_p.scaled(a_p), on_d.scaled(a_p + b_p));
        let on_p = Legs2 { x: own.x + carried.x, y: own.y + carried.y }.scaled(inertia.per_root / lengths[0]);
        let on_d = on_d.scaled(a_d / lengths[1]);
        Self { lengths, carried: mass_d * a_d * SIGMA / lengths[1], weight: [on_p, on_d] }
    }

    /// The torques of the weight.
    #[inline(always)]
    pub(super) fn torques(&self, [p, d]: [Legs2; 2]) -> [Legs; 2] {
        let [on_p, on_d] = self.weight;
        [p.cross(on_p), d.cross(on_d)]
    }
}

/// Where links begin to turn: their directions, and as long as they are in [`Falling`].
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub(super) directions: [Legs2; 2],
    pub(super) links: [Legs2; 2],
}

impl ByAngles<'_> {
    /// q̈, a small way from a place, with the rates there. In coordinates of the tip that are turned by −90°: the columns of Φ_q are the
    /// links themselves.
    #[inline(always)]
    pub(super) fn falling(&self, place: &Place, by: &Angles, v: &Angles, regularization: f64) -> Angles {
        let (falling, inertia) = (&self.model().falling, self.inertia);
        let ([p, d], [by_p, by_d]) = (place.links, legs(by));
        let [p, d] = [turned_by(p, by_p), turned_by(d, by_d)];
        let coupling = inertia.coupled(falling.carried, [p.dot(d), p.cross(d)]);
        let ([w_p, w_d], [on_p, on_d]) = (legs(v), falling.torques([p, d]));
        let (s_p, s_d) = (inertia.root * (w_p * w_p), w_d * w_d);
        let torques = [on_p + coupling.across * s_d, on_d - coupling.across * s_p];
        let lacking = |[x, y]: [Legs; CLOSURES]| sums([x - p.y * s_p - d.y * s_d, y + p.x * s_p + d.x * s_d]);
        Factor::new(inertia, &coupling, [p, d], regularization).accelerated(torques, lacking).0
    }
}
