//! Constants of the two legs, open at the tip: moments and mobilities in the equations of the cut loop.

use crate::mechanism::Mechanism;
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both};

/// Constants of a mechanism with its legs open at the tip.
#[derive(Clone, Copy, Debug)]
pub struct OpenLegs {
    pub(super) mechanism: Mechanism,
    /// Lengths ℓ and L, times the leg's sign in the tip's closure, m.
    pub(super) sigma_length: [Legs; 2],
    /// Coefficients of first moments: m_P a, m_D ℓ and m_D a_D, kg·m.
    mass_moment: [Legs; 3],
    /// Moments of inertia A, B and D, kg·m².
    pub(super) moment: [Legs; 3],
    /// Mobilities 1/(I + A) and 1/(I + D) of a single link about its first joint, 1/(kg·m²).
    pub(super) turn_mobility: [Legs; 2],
}

/// First moments of displacements of the proximal and the distal links, kg·m².
pub(super) type Moments = [Legs2; 2];

impl OpenLegs {
    /// Computes the constants of a mechanism.
    pub fn new(mechanism: &Mechanism) -> Self {
        let &Mechanism { a_p, b_p, a_d, sigma_b_d, mass_p, mass_d, inertia_p, inertia_d, .. } = mechanism;
        let length = a_p + b_p;
        let mass_moment @ [proximal, elbow, distal] = [mass_p * a_p, mass_d * length, mass_d * a_d];
        let moment = [proximal * a_p + elbow * length, distal * length, distal * a_d];
        Self {
            mechanism: *mechanism,
            sigma_length: [SIGMA * length, SIGMA * a_d + sigma_b_d],
            mass_moment,
            moment,
            turn_mobility: [both(1.0) / (inertia_p + moment[0]), both(1.0) / (inertia_d + moment[2])],
        }
    }

    /// First moments of rotations of the links, kg·m²; p and d are displacements divided by lengths.
    pub(super) fn moment(&self, [p, d]: [Legs2; 2]) -> Moments {
        let [own, shared, distal] = self.moment;
        [p.scaled(own) + d.scaled(shared), p.scaled(shared) + d.scaled(distal)]
    }

    /// First moments of displacements of the centres of mass, m.
    pub(super) fn moment_of_centres(&self, [p, d]: [Legs2; 2]) -> Moments {
        let [proximal, elbow, distal] = self.mass_moment;
        [p.scaled(proximal) + d.scaled(elbow), d.scaled(distal)]
    }

    /// Moments of forces on the centres of mass; N·m for forces in N.
    pub(super) fn moment_of_forces(&self, [p, d]: [Legs2; 2]) -> Moments {
        let Mechanism { a_p, b_p, a_d, .. } = self.mechanism;
        [p.scaled(a_p) + d.scaled(a_p + b_p), d.scaled(a_d)]
    }

    /// Products of σ(ℓ, L) with a vector of the tip.
    pub(super) fn levers(&self, tip: Legs2) -> Moments {
        self.sigma_length.map(|length| tip.scaled(length))
    }
}
