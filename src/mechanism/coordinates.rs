//! Layout of the coordinates q (also q̇, q̈, Q) and the multipliers λ (also Φ).
//!
//! Twelve coordinates: x, y (m) of each link's centre of mass and its angle θ (rad). Ten multipliers (N): the forces of the joints.
//! Both vectors are stored in pairs of the left and the right leg: `[x_P left, x_P right, y_P left, …]`.

use super::legs::{Legs, Legs2, largest};
use crate::vector::Vector;

/// Number of coordinates.
pub const COORDINATES: usize = 12;
/// Number of constraint equations and multipliers.
pub const MULTIPLIERS: usize = 10;
/// A vector of 12 coordinates: q, q̇, q̈ or Q.
pub type Coordinates = Vector<COORDINATES>;
/// A vector of 10 constraints: Φ or λ.
pub type Multipliers = Vector<MULTIPLIERS>;

/// Pair of x of the proximal links' centres of mass.
pub const P_X: usize = 0;
/// Pair of y of the proximal links' centres of mass.
pub const P_Y: usize = 1;
/// Pair of angles of the proximal links.
pub const P_THETA: usize = 2;
/// Pair of x of the distal links' centres of mass.
pub const D_X: usize = 3;
/// Pair of y of the distal links' centres of mass.
pub const D_Y: usize = 4;
/// Pair of angles of the distal links.
pub const D_THETA: usize = 5;

/// Pair of the joints of the proximal links with the ground, x component.
pub const G_X: usize = 0;
/// Pair of the joints of the proximal links with the ground, y component.
pub const G_Y: usize = 1;
/// Pair of the elbows, x component.
pub const E_X: usize = 2;
/// Pair of the elbows, y component.
pub const E_Y: usize = 3;
/// Index in λ of the tip's closure (one equation for both legs), x component.
pub const TIP_X: usize = 8;
/// Index in λ of the tip's closure, y component.
pub const TIP_Y: usize = 9;

/// Index in q of the angles of links 1 to 4 (left proximal, left distal, right distal, right proximal).
pub const THETA: [usize; 4] = [2 * P_THETA, 2 * D_THETA, 2 * D_THETA + 1, 2 * P_THETA + 1];
/// Index in q of x of links 1 to 4.
pub const X: [usize; 4] = [2 * P_X, 2 * D_X, 2 * D_X + 1, 2 * P_X + 1];
/// Index in q of y of links 1 to 4.
pub const Y: [usize; 4] = [2 * P_Y, 2 * D_Y, 2 * D_Y + 1, 2 * P_Y + 1];

/// The i-th pair of a vector.
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

/// Largest magnitude among the angle entries of coordinates, rad, velocities, rad/s, or increments.
pub fn largest_angle(x: &Coordinates) -> f64 {
    let [proximal, distal] = angles_by_leg(x);
    largest(proximal.abs().fast_max(distal.abs()))
}

/// The angle entries of coordinates: proximal and distal links.
pub fn angles_by_leg(x: &Coordinates) -> [Legs; 2] {
    [legs_of(x, P_THETA), legs_of(x, D_THETA)]
}

/// The angle entries of coordinates: links 1 to 4.
pub fn link_angles(x: &Coordinates) -> [f64; 4] {
    THETA.map(|i| x[i])
}

/// Sets the angle entries of coordinates: proximal and distal links.
pub fn set_angles(x: &mut Coordinates, [p, d]: [Legs; 2]) {
    set_legs(x, P_THETA, p);
    set_legs(x, D_THETA, d);
}

/// The position entries of coordinates: vectors of the proximal and the distal centres of mass.
pub fn centres(x: &Coordinates) -> [Legs2; 2] {
    [Legs2 { x: legs_of(x, P_X), y: legs_of(x, P_Y) }, Legs2 { x: legs_of(x, D_X), y: legs_of(x, D_Y) }]
}
