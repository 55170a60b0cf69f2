//! Where things stand in q, q̇, q̈ and λ.
//!
//! Twelve coordinates: x, y (m) of each link's centre of mass and its angle θ (rad). Ten multipliers (N): the forces of the joints.
//! Both are stored by legs, left and right side by side: `[x_P left, x_P right, y_P left, …]`.

use super::legs::Legs;
use crate::vector::Vector;

/// Number of coordinates.
pub const COORDINATES: usize = 12;
/// Number of constraint equations and multipliers.
pub const MULTIPLIERS: usize = 10;
/// q, q̇, q̈, Q and the like.
pub type Coordinates = Vector<COORDINATES>;
/// Φ, λ and the like.
pub type Multipliers = Vector<MULTIPLIERS>;

/// x of the proximal links' centres of mass.
pub const P_X: usize = 0;
/// y of the proximal links' centres of mass.
pub const P_Y: usize = 1;
/// Angle of the proximal links.
pub const P_THETA: usize = 2;
/// x of the distal links' centres of mass.
pub const D_X: usize = 3;
/// y of the distal links' centres of mass.
pub const D_Y: usize = 4;
/// Angle of the distal links.
pub const D_THETA: usize = 5;

/// Joint of the proximal links with the ground, x component.
pub const G_X: usize = 0;
/// Joint of the proximal links with the ground, y component.
pub const G_Y: usize = 1;
/// Elbows, x component.
pub const E_X: usize = 2;
/// Elbows, y component.
pub const E_Y: usize = 3;
/// The tip's closure (one equation for both legs), x component: index into the multipliers themselves.
pub const TIP_X: usize = 8;
/// The tip's closure, y component.
pub const TIP_Y: usize = 9;

/// Index in q of the angles of links 1 to 4 (left proximal, left distal, right distal, right proximal).
pub const THETA: [usize; 4] = [2 * P_THETA, 2 * D_THETA, 2 * D_THETA + 1, 2 * P_THETA + 1];
/// Index in q of x of links 1 to 4.
pub const X: [usize; 4] = [2 * P_X, 2 * D_X, 2 * D_X + 1, 2 * P_X + 1];
/// Index in q of y of links 1 to 4.
pub const Y: [usize; 4] = [2 * P_Y, 2 * D_Y, 2 * D_Y + 1, 2 * P_Y + 1];

/// The i-th quantity of both legs.
#[inline]
pub fn legs_of<const K: usize>(values: &[f64; K], i: usize) -> Legs {
    Legs::new([values[2 * i], values[2 * i + 1]])
}

/// Adds to the i-th quantity of both legs.
#[inline]
pub fn add_legs<const K: usize>(values: &mut [f64; K], i: usize, legs: Legs) {
    set_legs(values, i, legs_of(values, i) + legs);
}

/// Writes the i-th quantity of both legs.
#[inline]
pub fn set_legs<const K: usize>(values: &mut [f64; K], i: usize, legs: Legs) {
    let [left, right] = legs.to_array();
    values[2 * i] = left;
    values[2 * i + 1] = right;
}

/// Largest magnitude among the link angles, or their rates or changes.
#[inline]
pub fn largest_angle(x: &Coordinates) -> f64 {
    let [left, right] = legs_of(x, P_THETA).abs().fast_max(legs_of(x, D_THETA).abs()).to_array();
    if left > right { left } else { right }
}
