//! The mass matrix of the five-bar in its link angles, leg by leg, and its inverse: see [`angles`](super::angles) for the formula.

use super::angles::{Angles, DISTAL, PROXIMAL};
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs, both};
use crate::mechanism::{Mechanism, Pose};

/// The mass matrix of each leg, or its inverse.
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

/// Constant part of the mass matrix in the link angles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inertia {
    /// I_P + m_P a_P² + m_D l_P², kg·m².
    pub(super) proximal: Legs,
    /// I_D + m_D a_D², kg·m².
    distal: Legs,
    /// m_D l_P a_D, kg·m²: the coupling is its product with the cosine of the angle between the links.
    carried: Legs,
    /// Determinant of M of a stretched leg, kg²·m⁴, a sum of positive terms; (m_D l_P × a_D)² adds to it.
    pub(super) stretched: Legs,
}

impl Inertia {
    /// Constant part for a mechanism.
    pub(super) fn new(mechanism: &Mechanism) -> Self {
        let &Mechanism { mass_p, mass_d, inertia_p, inertia_d, a_p, b_p, a_d, .. } = mechanism;
        let (own, swung) = (inertia_p + mass_p * a_p * a_p, mass_d * (a_p + b_p) * (a_p + b_p));
        let distal = inertia_d + mass_d * a_d * a_d;
        Self { proximal: own + swung, distal, carried: mass_d * (a_p + b_p) * a_d, stretched: own * distal + swung * inertia_d }
    }

    #[inline]
    pub(super) fn mass(&self, pose: &Pose) -> Mass {
        Mass { proximal: self.proximal, distal: self.distal, coupling: self.carried * pose.u_p.dot(pose.u_d) }
    }

    /// m_D l_P × a_D, kg·m²: torque on the other link per square of a rate.
    #[inline]
    pub(super) fn centripetal(&self, pose: &Pose) -> Legs {
        self.carried * pose.u_p.cross(pose.u_d)
    }

    /// Inverse M⁻¹ as adjugate over determinant, without cancellation for links of little inertia.
    #[inline]
    pub(super) fn inverse(&self, pose: &Pose) -> Mass {
        let across = self.centripetal(pose);
        let reciprocal = both(1.0) / (self.stretched + across * across);
        let coupling = self.mass(pose).coupling;
        Mass { proximal: self.distal * reciprocal, distal: self.proximal * reciprocal, coupling: -coupling * reciprocal }
    }
}
