//! Gravity: a constant acceleration g·sin(tilt) in the plane of the mechanism, in a chosen direction.
//!
//! Q = m g⃗ at each centre of mass r, potential −Σ m g⃗·r (0 at the left motor axis). K = C = 0; conservative.
//! Defaults: standard gravity rounded as in the paper (9.81 m/s²), an upright mechanism, pulling along −y.
//! Limits: none within Newtonian mechanics; components out of the plane do no work and are carried by the bearings.

use crate::mechanism::coordinates::{D_X, D_Y, P_X, P_Y, add_legs};
use crate::mechanism::legs::both;
use crate::mechanism::{Coordinates, Mechanism};

/// The `gravity.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has gravity.
    pub enabled: bool,
    /// Gravitational acceleration, m/s².
    pub g: f64,
    /// Angle between the mechanism's plane and the horizontal, rad: 0 = lying flat, π/2 = upright.
    pub tilt: f64,
    /// Direction of the in-plane component, rad, counter-clockwise from +x.
    pub direction: f64,
}

impl Parameters {
    /// Adds the weights of the links, N, to a generalised force.
    pub fn add_weight(&self, mechanism: &Mechanism, weight: &mut Coordinates) {
        let Self { g, tilt, direction, .. } = *self;
        let (sin, cos) = libm::sincos(direction);
        let in_plane = g * libm::sin(tilt);
        for (x, y, mass) in [(P_X, P_Y, mechanism.mass_p), (D_X, D_Y, mechanism.mass_d)] {
            add_legs(weight, x, mass * both(in_plane * cos));
            add_legs(weight, y, mass * both(in_plane * sin));
        }
    }
}
