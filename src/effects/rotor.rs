//! Rotor: the inertia of each motor's rotor, which turns with the proximal link through a gear.
//!
//! Links 1 and 4 gain the moment of inertia gearRatio² · inertia: a rotor that turns gearRatio times as fast as its link stores ½ inertia
//! (gearRatio ω)² (Siciliano et al., Robotics, 2009, section 7.1.1). The mass matrix gains a constant and no force arises; the kinetic
//! energy includes the rotor. Defaults: 1e-5 kg·m², a small brushless motor's, without gear (ratio 1).
//! Limits: no gear friction, play or elasticity; the rotor's axis is fixed to the ground, so there is no gyroscopic coupling.

use crate::mechanism::Geometry;

/// The `rotor.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has rotors.
    pub enabled: bool,
    /// Moments of inertia of the left and the right rotor about their axes, kg·m².
    pub inertia: [f64; 2],
    /// Turns of the rotor per turn of the link.
    pub gear_ratio: [f64; 2],
}

/// Indices of the links that the motors drive.
const DRIVEN: [usize; 2] = [0, 3];

impl Parameters {
    /// Adds the inertia of the rotors to the proximal links.
    pub fn add_masses(&self, geometry: &mut Geometry) {
        for (i, link) in DRIVEN.into_iter().enumerate() {
            let (inertia, ratio) = (self.inertia[i], self.gear_ratio[i]);
            geometry.links[link].inertia += ratio * ratio * inertia;
        }
    }
}
