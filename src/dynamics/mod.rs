//! The mechanism under wrenches: motions as force laws see them, and wrenches and slopes in the coordinates of each formulation.
//!
//! | file | holds |
//! | --- | --- |
//! | `angles.rs` | equations of motion in the four link angles, and their linearisation |
//! | `motion.rs` | motion of joints and tip from the 12 coordinates, from the link angles, or over a finite step |
//! | `wrench.rs` | wrenches and slopes in the 12 coordinates, in the 4 link angles and in the legs of a finite step |
//!
//! `ARCHITECTURE.md`, "Formulations of the dynamics", lists the formulations and the methods that use them.

pub mod angles;
mod motion;
mod wrench;

pub use motion::{Conditions, change_of_motion};
pub use wrench::{INNER, INNER_COUNT, StepLevers, TipArm};
