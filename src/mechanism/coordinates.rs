//! Layout of the coordinates q (also q̇, q̈, Q) and the multipliers λ (also Φ).
//!
//! Twelve coordinates: x, y (m) of each link's centre of mass and its angle θ (rad). Ten multipliers (N): the joint forces. Both vectors
//! are stored in pairs, left leg first: `[x_P left, x_P right, y_P left, …]`.

use super::legs::{Legs, Legs2, largest};
use crate::vector::Vector;

/// Number of coordinates.
pub const COORDINATES: usize = 12;
/// Number of constraint equations and multipliers.
pub const MULTIPLIERS: usize = 10;
/// A vector of the 12 coordinates: q, q̇, q̈ or Q.
pub type Coordinates = Vector<COORDINATES>;
/// A vector over the 10 constraints: Φ or λ.
pub type Multipliers = Vector<MULTIPLIERS>;

/// Pair index in q: x of the proximal links' centres of mass.
pub const P_X: usize = 0;
/// Pair index in q: y of the proximal links' centres of mass.
pub const P_Y: usize = 1;
/// Pair index in q: angles of the proximal links.
pub const P_THETA: usize = 2;
/// Pair index in q: x of the distal links' centres of mass.
pub const D_X: usize = 3;
/// Pair index in q: y of the distal links' centres of mass.
pub const D_Y: usize = 4;
/// Pair index in q: angles of the distal links.
pub const D_THETA: usize = 5;

/// Pair index in λ: joints between proximal links and ground, x component.
pub const G_X: usize = 0;
/// Pair index in λ: joints between proximal links and ground, y component.
pub const G_Y: usize = 1;
/// Pair index in λ: elbows, x component.
pub const E_X: usize = 2;
/// Pair index in λ: elbows, y component.
pub const E_Y: usize = 3;
/// Index in λ: closure of the tip (one equation for both legs), x component.
pub const TIP_X: usize = 8;
/// Index in λ: closure of the tip, y component.
pub const TIP_Y: usize = 9;

/// Indices in q of the angles of links 1 to 4 (left proximal, left distal, right distal, right proximal).
pub const THETA: [usize; 4] = [2 * P_THETA, 2 * D_THETA, 2 * D_THETA + 1, 2 * P_THETA + 1];
/// Indices in q of x of links 1 to 4.
pub const X: [usize; 4] = [2 * P_X, 2 * D_X, 2 * D_X + 1, 2 * P_X + 1];
/// Indices in q of y of links 1 to 4.
pub const Y: [usize; 4] = [2 * P_Y, 2 * D_Y, 2 * D_Y + 1, 2 * P_Y + 1];

/// Returns the i-th pair of a vector.
pub fn legs_of<const K: usize>(values: &[f64; K], i: usize) -> Legs {
    Legs::new([values[2 * i], values[2 * i + 1]])
}

/// Adds to the i-th pair of a vector.
pub fn add_legs<const K: usize>(values: &mut [f64; K], i: usize, legs: Legs) {
    set_legs(values, i, legs_of(values, i) + legs);
}

/// Sets the i-th pair of a vector.
pub fn set_legs<const K: usize>(values: &mut [f64; K], i: usize, legs: Legs) {
    let [left, right] = legs.to_array();
    values[2 * i] = left;
    values[2 * i + 1] = right;
}

/// Largest magnitude of the angle entries: rad for coordinates and increments, rad/s for velocities.
pub fn largest_angle(x: &Coordinates) -> f64 {
    let [proximal, distal] = angles_by_leg(x);
    largest(proximal.abs().fast_max(distal.abs()))
}

/// Angle entries by leg: proximal links, distal links.
pub fn angles_by_leg(x: &Coordinates) -> [Legs; 2] {
    [legs_of(x, P_THETA), legs_of(x, D_THETA)]
}

/// Angle entries of links 1 to 4.
pub fn link_angles(x: &Coordinates) -> [f64; 4] {
    THETA.map(|i| x[i])
}

/// Sets the angle entries by leg: proximal links, distal links.
pub fn set_angles(x: &mut Coordinates, [p, d]: [Legs; 2]) {
    set_legs(x, P_THETA, p);
    set_legs(x, D_THETA, d);
}

/// Position entries: centres of mass of the proximal and of the distal links.
pub fn centres(x: &Coordinates) -> [Legs2; 2] {
    [Legs2 { x: legs_of(x, P_X), y: legs_of(x, P_Y) }, Legs2 { x: legs_of(x, D_X), y: legs_of(x, D_Y) }]
}
