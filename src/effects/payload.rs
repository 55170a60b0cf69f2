//! Payload: a point mass at the tip.
//!
//! It moves with the end of link 2 (left distal), so that link 2 with payload is again a rigid link: its mass grows by m, its centre
//! of mass moves to (m₂ c₂ + m L₂)/(m₂ + m), its inertia about it grows by m₂ m/(m₂ + m) (L₂ − c₂)² (parallel axes). Constant in M;
//! energy and gravity include it. Default: 0.05 kg, three times a link of the paper's mechanism.
//! The mass may change during a run: what is added joins as [`Join`] says, what is taken off goes on with the velocity of the tip.
//! Limits: a point, without inertia of its own; rigidly held. Reaction 3 is what link 3 adds to link 2 with its payload.

use crate::mechanism::{Geometry, SceneError, not_negative};

/// The `payload.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has a payload.
    pub enabled: bool,
    /// Mass, kg.
    pub mass: f64,
    /// How mass joins that is added during a run.
    pub join: Join,
}

/// How mass joins the tip during a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Join {
    /// At rest until then: an inelastic impact.
    #[default]
    AtRest,
    /// With the velocity of the tip.
    WithTip,
}

/// The link that carries it.
const CARRIER: usize = 1;

impl Parameters {
    /// Adds the payload to the left distal link.
    pub fn add_masses(&self, geometry: &mut Geometry) -> Result<(), SceneError> {
        not_negative("payload.mass", self.mass, "kg")?;
        let link = &mut geometry.links[CARRIER];
        let total = link.mass + self.mass;
        let distance = link.length - link.com;
        link.com += self.mass / total * distance;
        link.inertia += link.mass * self.mass / total * distance * distance;
        link.mass = total;
        Ok(())
    }
}
