//! Bodies, revolute joints, closure, constraints and singularities of the planar five-bar.
//!
//! Four moving links between two motor axes on the x axis (the left one at the origin):
//!
//! ```text
//!                 tip
//!          1  .-'     '-.  2          links  0 left proximal   1 left distal
//!         .-'             '-.                3 right proximal  2 right distal
//!        o left elbow        o right elbow
//!         \                 /
//!        0 \               / 3        absolute angles, counter-clockwise from +x;
//!           o-------------o           distal links from elbow to tip
//!         left  distance  right motor
//! ```
//!
//! Invariant: no input or output, no clock; the same input bits give the same output bits.

pub mod closure;
mod closure_branch;
pub mod constraints;
pub mod coordinates;
pub mod exponential;
pub mod legs;
mod model;
pub mod placement;
pub mod secant;
mod singular_values;
pub mod singularity;
pub mod vertex;

pub use closure::{Assembly, Start, close};
pub use closure_branch::{BRANCH_ARM, ClosureBranch, ClosureTerms, TOLERANCE_OF_TURN};
pub use constraints::Pose;
pub use coordinates::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers};
pub use model::{Geometry, LINKS, Link, Mechanism, SceneError};
pub use singular_values::SingularValue;
