//! Bodies, revolute joints, closure, constraints and singularities of the planar five-bar.

use std::fmt;

/// One link: lengths in m, mass in kg, inertia in kg·m² about the centre of mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Distance between the link's two joints, m.
    pub length: f64,
    /// Mass, kg.
    pub mass: f64,
    /// Moment of inertia about the centre of mass, kg·m².
    pub inertia: f64,
    /// Centre of mass, measured along the link from its motor axis (proximal) or elbow (distal), m.
    pub com: f64,
}

/// The mechanism's constant geometry. Links: 0 left proximal, 1 left distal, 2 right distal, 3 right proximal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Distance between the motor axes, both on the x axis, the left one at the origin, m.
    pub base_distance: f64,
    /// The four moving links.
    pub links: [Link; 4],
}

/// Side of the arrow from left elbow to right elbow on which the tip lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Assembly {
    /// To the left of the arrow.
    Plus,
    /// To the right of the arrow.
    Minus,
}

/// What a run starts from: the proximal links and the choice of closure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Proximal angles, left and right, rad.
    pub theta: [f64; 2],
    /// Proximal rates, left and right, rad/s.
    pub omega: [f64; 2],
    /// The way to close the loop.
    pub assembly: Assembly,
}

/// A value that cannot be simulated: one sentence naming the variable, its value and what is allowed.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal(pub String);

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Refusal {}
