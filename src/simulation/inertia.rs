//! The mass matrix of the five-bar in its link angles, leg by leg, and its inverse: see [`angles`](super::angles) for the formula.

use super::angles::{Angles, DISTAL, PROXIMAL};
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, both};
use crate::mechanism::{Mechanism, Pose};

/// Motor axis to elbow.
#[inline]
pub(super) fn proximal_arm(pose: &Pose) -> Legs2 {
    Legs2 { x: pose.a_p.x + pose.b_p.x, y: pose.a_p.y + pose.b_p.y }
}

/// The mass matrix of each leg.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mass {
    pub(super) proximal: Legs,
    pub(super) distal: Legs,
    pub(super) coupling: Legs,
}

impl Mass {
    #[inline]
    pub(super) fn times(&self, x: &Angles) -> Angles {
        let (p, d) = (legs_of(x, PROXIMAL), legs_of(x, DISTAL));
        let mut product = Angles::ZERO;
        set_legs(&mut product, PROXIMAL, self.proximal * p + self.coupling * d);
        set_legs(&mut product, DISTAL, self.coupling * p + self.distal * d);
        product
    }
}

/// What of the mass matrix in the angles is constant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inertia {
    /// P = I_P + m_P a_P² + m_D l_P².
    proximal: Legs,
    /// I_D + m_D a_D².
    distal: Legs,
    /// m_D l_P a_D: times the cosine and the sine of the angle between the links.
    carried: Legs,
    /// √P and 1/√P.
    pub(super) root: Legs,
    pub(super) per_root: Legs,
    /// The determinant of M where the leg is stretched, a sum of positive terms, by P.
    stretched: Legs,
}

impl Inertia {
    /// Of a mechanism.
    pub(super) fn new(mechanism: &Mechanism) -> Self {
        let &Mechanism { mass_p, mass_d, inertia_p, inertia_d, a_p, b_p, a_d, .. } = mechanism;
        let (own, swung) = (inertia_p + mass_p * a_p * a_p, mass_d * (a_p + b_p) * (a_p + b_p));
        let (proximal, distal) = (own + swung, inertia_d + mass_d * a_d * a_d);
        let (root, carried) = (proximal.sqrt(), mass_d * (a_p + b_p) * a_d);
        let stretched = (own * distal + swung * inertia_d) / proximal;
        Self { proximal, distal, carried, root, per_root: both(1.0) / root, stretched }
    }

    #[inline]
    pub(super) fn mass(&self, pose: &Pose) -> Mass {
        Mass { proximal: self.proximal, distal: self.distal, coupling: self.carried * pose.u_p.dot(pose.u_d) }
    }

    /// m_D l_P × a_D: by what the square of one rate drives the other link.
    #[inline]
    pub(super) fn centripetal(&self, pose: &Pose) -> Legs {
        self.carried * pose.u_p.cross(pose.u_d)
    }

    /// How the links of each leg are coupled.
    #[inline(always)]
    pub(super) fn coupling(&self, pose: &Pose) -> Coupling {
        self.coupled(self.carried * self.per_root, [pose.u_p.dot(pose.u_d), pose.u_p.cross(pose.u_d)])
    }

    /// The same by the scalar and the vector product of both links in some lengths, with m_D l_P a_D / √P for these.
    #[inline(always)]
    pub(super) fn coupled(&self, carried: Legs, [along, across]: [Legs; 2]) -> Coupling {
        let (along, across) = (carried * along, carried * across);
        Coupling { along, across, remainder: self.stretched + across * across }
    }
}

/// How the links of each leg are coupled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coupling {
    /// m_D l_P·a_D by √P.
    pub(super) along: Legs,
    /// m_D l_P × a_D by √P: by what the square of one rate drives the other link.
    pub(super) across: Legs,
    /// What M leaves for the distal link where the proximal one gives way, kg m². Nothing cancels with links of little inertia.
    pub(super) remainder: Legs,
}
