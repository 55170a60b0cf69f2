//! Payload: a point mass at the tip.
//!
//! The payload moves with the end of link 2 (left distal), so link 2 with payload is again a rigid link: its mass grows by m, its centre of
//! mass moves to (m₂ c₂ + m L₂)/(m₂ + m), and its inertia about the centre of mass grows by m₂ m/(m₂ + m) (L₂ − c₂)² (parallel axes). The
//! mass matrix changes by a constant; energy and gravity include the payload.
//! Default: 0.05 kg, three times a link of the paper's mechanism.
//! The mass may change during a run: added mass joins as [`Join`] describes; removed mass leaves with the velocity of the tip.
//! Limits: a point without moment of inertia, rigidly attached. Reaction 3 is the force of link 3 on link 2 with its payload.

use crate::mechanism::Geometry;

/// The `payload.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has a payload.
    pub enabled: bool,
    /// Mass, kg.
    pub mass: f64,
    /// Velocity of mass that is added during a run, before it joins.
    pub join: Join,
}

/// Velocity of mass that is added to the tip during a run, immediately before it joins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Join {
    /// At rest: the addition is an inelastic impact.
    #[default]
    AtRest,
    /// The velocity of the tip: the addition changes no velocity.
    WithTip,
}

/// Index of the link that carries the payload.
pub(crate) const CARRIER: usize = 1;

impl Parameters {
    /// Adds the payload to the left distal link.
    pub fn add_masses(&self, geometry: &mut Geometry) {
        let link = &mut geometry.links[CARRIER];
        let total = link.mass + self.mass;
        let distance = link.length - link.com;
        link.com += self.mass / total * distance;
        link.inertia += link.mass * self.mass / total * distance * distance;
        link.mass = total;
    }
}
