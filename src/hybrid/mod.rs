//! Hybrid room: what forces with discontinuities have beside formulas. One discrete state, the mode; unilateral springs and their phases;
//! friction that sticks and slips; and the guards where the mode ends, which `integrator/locator.rs` finds.
//!
//! Invariant: knows the methods by their interface [`crate::integrator::System`] only, and no effect.

pub mod friction;
mod guards;
mod mode;
pub mod unilateral;

pub use friction::{
    FrictionConstraint, FrictionConstraints, FrictionGuard, FrictionGuards, FrictionPlace, FrictionPlaces, Frictional, Law,
    stick_velocity,
};
pub use guards::{Extremes, GuardValues};
pub use mode::{CONTACT, FRICTION_PLACES, INDICATORS, Mode, SPRINGS, STOPS, SlipDirection, StickSlip, StickSlips, TIP_FRICTION};
pub use unilateral::{MeanReaction, UnilateralGuard, UnilateralSpring};
