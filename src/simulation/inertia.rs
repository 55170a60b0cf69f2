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
    /// I_P + m_P a_P² + m_D l_P².
    proximal: Legs,
    /// I_D + m_D a_D².
    distal: Legs,
    /// m_D l_P a_D: times the cosine and the sine of the angle between the links.
    carried: Legs,
    /// 1/P and m_D l_P a_D / P with P the first of these.
    mobility: Legs,
    share: Legs,
    /// The determinant of M where the leg is stretched, a sum of positive terms, by P; l_P × a_D adds its square times m_D² / P.
    stretched: Legs,
}

impl Inertia {
    /// Of a mechanism.
    pub(super) fn new(mechanism: &Mechanism) -> Self {
        let &Mechanism { mass_p, mass_d, inertia_p, inertia_d, a_p, b_p, a_d, .. } = mechanism;
        let (own, swung) = (inertia_p + mass_p * a_p * a_p, mass_d * (a_p + b_p) * (a_p + b_p));
        let distal = inertia_d + mass_d * a_d * a_d;
        let (proximal, carried) = (own + swung, mass_d * (a_p + b_p) * a_d);
        let mobility = both(1.0) / proximal;
        let stretched = (own * distal + swung * inertia_d) * mobility;
        Self { proximal, distal, carried, mobility, share: carried * mobility, stretched }
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

    /// M⁻¹, with the angle of the proximal link eliminated. In the remainder nothing cancels with links of little inertia.
    #[inline(always)]
    pub(super) fn eliminated(&self, pose: &Pose) -> Eliminated {
        let across = self.centripetal(pose);
        Eliminated {
            proximal: self.mobility,
            share: self.share * pose.u_p.dot(pose.u_d),
            distal: both(1.0) / (self.stretched + across * across * self.mobility),
        }
    }
}

/// The inverse of M of each leg, P and D its diagonal and C beside it, by the elimination of the proximal link's angle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eliminated {
    /// 1/P.
    pub(super) proximal: Legs,
    /// C/P: what of a torque on the proximal link is taken from the distal one.
    pub(super) share: Legs,
    /// 1/(D − C²/P).
    pub(super) distal: Legs,
}
