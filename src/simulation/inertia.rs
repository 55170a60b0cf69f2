//! The mass matrix of the five-bar in its link angles, leg by leg, and its inverse: see [`angles`](super::angles) for the formula.

use super::angles::{Angles, DISTAL, PROXIMAL};
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2};
use crate::mechanism::{Mechanism, Pose};

/// Motor axis to elbow.
#[inline]
pub(super) fn proximal_arm(pose: &Pose) -> Legs2 {
    Legs2 { x: pose.a_p.x + pose.b_p.x, y: pose.a_p.y + pose.b_p.y }
}

/// The mass matrix of each leg, or its inverse.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mass {
    pub(super) proximal: Legs,
    pub(super) distal: Legs,
    pub(super) coupling: Legs,
}

impl Mass {
    /// Each leg times a number of its own.
    #[inline]
    pub(super) fn scaled(&self, factor: Legs) -> Self {
        Self { proximal: self.proximal * factor, distal: self.distal * factor, coupling: self.coupling * factor }
    }

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
    /// m_D.
    carried: Legs,
    /// The determinant of M where the leg is stretched, a sum of positive terms; l_P × a_D adds its square times m_D².
    stretched: Legs,
}

impl Inertia {
    /// Of a mechanism.
    pub(super) fn new(mechanism: &Mechanism) -> Self {
        let &Mechanism { mass_p, mass_d, inertia_p, inertia_d, a_p, b_p, a_d, .. } = mechanism;
        let (own, swung) = (inertia_p + mass_p * a_p * a_p, mass_d * (a_p + b_p) * (a_p + b_p));
        let distal = inertia_d + mass_d * a_d * a_d;
        Self { proximal: own + swung, distal, carried: mass_d, stretched: own * distal + swung * inertia_d }
    }

    #[inline]
    pub(super) fn mass(&self, pose: &Pose) -> Mass {
        Mass { proximal: self.proximal, distal: self.distal, coupling: self.carried * proximal_arm(pose).dot(pose.a_d) }
    }

    /// The adjugate of M, constant but for its coupling, and the determinant, in which nothing cancels with links of little inertia:
    /// M⁻¹ is the one over the other.
    #[inline]
    pub(super) fn adjugate(&self, pose: &Pose) -> (Mass, Legs) {
        let (l, a) = (proximal_arm(pose), pose.a_d);
        let across = self.carried * (l.x * a.y - l.y * a.x);
        let coupling = self.mass(pose).coupling;
        (Mass { proximal: self.distal, distal: self.proximal, coupling: -coupling }, self.stretched + across * across)
    }
}
