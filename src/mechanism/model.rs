//! Geometry and masses of the mechanism, by link (as a user gives them) and by leg (as the code computes with them).

use std::fmt;

use super::Coordinates;
use super::coordinates::{D_THETA, D_X, D_Y, P_THETA, P_X, P_Y, legs_of, set_legs};
use super::legs::{Legs, SIGMA, both, sum};

/// One link: a rigid bar between two revolute joints.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Link {
    /// Distance between the link's two joints, m.
    pub length: f64,
    /// Mass, kg.
    pub mass: f64,
    /// Moment of inertia about the centre of mass, kg·m².
    pub inertia: f64,
    /// Centre of mass, measured along the link from its motor axis (proximal) or elbow (distal), m. May lie outside the link.
    pub com: f64,
}

/// Number of links.
pub const LINKS: usize = 4;

/// Geometry and masses of the mechanism: links in the order left proximal, left distal, right distal, right proximal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Geometry {
    /// Distance between the motor axes, m; 0 = coaxial motors. Both axes are on the x axis, the left one at the origin.
    pub base_distance: f64,
    /// The four moving links.
    pub links: [Link; LINKS],
}

/// Message about a value that cannot be simulated: one sentence that names the variable, its value and the allowed values.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneError(pub String);

impl fmt::Display for SceneError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for SceneError {}

impl Geometry {
    /// Largest possible coordinate magnitude, m. Round-off in Φ is proportional to it.
    pub fn length_scale(&self) -> f64 {
        let [left_proximal, left_distal, right_distal, right_proximal] = self.links;
        let arm = |link: Link| link.length.max(link.com.abs()).max((link.length - link.com).abs());
        self.base_distance + (arm(left_proximal) + arm(left_distal)).max(arm(right_proximal) + arm(right_distal))
    }

    /// Whether the motors are coaxial and all links can lie in line, within the round-off of their lengths.
    pub fn turns_in_line(&self) -> bool {
        let [first, others @ ..] = self.lengths();
        let round_off = 2.0 * f64::EPSILON * self.lengths().iter().sum::<f64>();
        let sum = |signs: u8| (0..3).map(|i| if signs >> i & 1 == 0 { others[i] } else { -others[i] }).sum::<f64>();
        self.base_distance == 0.0 && (0..8).any(|signs| (first + sum(signs)).abs() <= round_off)
    }

    /// Lengths of links 1 to 4, m.
    pub fn lengths(&self) -> [f64; LINKS] {
        self.links.map(|link| link.length)
    }

    /// Mean mass of the links, kg.
    pub fn mean_mass(&self) -> f64 {
        self.links.iter().map(|link| link.mass).sum::<f64>() / 4.0
    }
}

/// The mechanism by legs; `P` stands for the proximal links, `D` for the distal links.
///
/// In each link, a is the distance from its first joint (motor axis or elbow) to the centre of mass, and b the rest of its length.
#[derive(Clone, Copy, Debug)]
pub struct Mechanism {
    /// Geometry and masses by links.
    pub geometry: Geometry,
    /// x coordinates of the motor axes, m.
    pub(crate) ground_x: Legs,
    /// Distance from the motor axis to the centre of mass of the proximal link, m.
    pub(crate) a_p: Legs,
    /// Distance from the centre of mass of the proximal link to the elbow, m.
    pub(crate) b_p: Legs,
    /// Distance from the elbow to the centre of mass of the distal link, m.
    pub(crate) a_d: Legs,
    /// Distance from the centre of mass of the distal link to the tip, times the sign σ of the leg in the tip's closure, m.
    pub(crate) sigma_b_d: Legs,
    /// Masses of the proximal links, kg.
    pub(crate) mass_p: Legs,
    /// Masses of the distal links, kg.
    pub(crate) mass_d: Legs,
    /// Moments of inertia of the proximal links about their centres of mass, kg·m².
    pub(crate) inertia_p: Legs,
    /// Moments of inertia of the distal links about their centres of mass, kg·m².
    pub(crate) inertia_d: Legs,
}

impl Mechanism {
    /// Arranges a geometry by legs.
    pub fn new(geometry: &Geometry) -> Self {
        let [left_proximal, left_distal, right_distal, right_proximal] = geometry.links;
        let proximal = |of: fn(Link) -> f64| Legs::new([of(left_proximal), of(right_proximal)]);
        let distal = |of: fn(Link) -> f64| Legs::new([of(left_distal), of(right_distal)]);
        Self {
            geometry: *geometry,
            ground_x: Legs::new([0.0, geometry.base_distance]),
            a_p: proximal(|link| link.com),
            b_p: proximal(|link| link.length - link.com),
            a_d: distal(|link| link.com),
            sigma_b_d: SIGMA * distal(|link| link.length - link.com),
            mass_p: proximal(|link| link.mass),
            mass_d: distal(|link| link.mass),
            inertia_p: proximal(|link| link.inertia),
            inertia_d: distal(|link| link.inertia),
        }
    }

    /// The product M x. The mass matrix of centre-of-mass coordinates is diagonal and constant.
    pub fn mass_times(&self, x: &Coordinates) -> Coordinates {
        let mut product = Coordinates::ZERO;
        for (i, m) in self.mass_diagonal().into_iter().enumerate() {
            set_legs(&mut product, i, m * legs_of(x, i));
        }
        product
    }

    /// Kinetic energy plus the potential energy of a constant generalised force, J.
    pub fn energy(&self, [q, v]: [&Coordinates; 2], force: &Coordinates) -> f64 {
        let (mut twice_kinetic, mut work) = (both(0.0), both(0.0));
        for (i, m) in self.mass_diagonal().into_iter().enumerate() {
            let rate = legs_of(v, i);
            twice_kinetic += m * rate * rate;
            work += legs_of(force, i) * legs_of(q, i);
        }
        sum(both(0.5) * twice_kinetic - work)
    }

    /// Diagonal of M by legs, kg and kg·m², in the order of the coordinate pairs.
    pub fn mass_diagonal(&self) -> [Legs; 6] {
        let mut diagonal = [both(0.0); 6];
        diagonal[P_X] = self.mass_p;
        diagonal[P_Y] = self.mass_p;
        diagonal[P_THETA] = self.inertia_p;
        diagonal[D_X] = self.mass_d;
        diagonal[D_Y] = self.mass_d;
        diagonal[D_THETA] = self.inertia_d;
        diagonal
    }
}
