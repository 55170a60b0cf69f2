//! Hybrid room: what forces with discontinuities have beside formulas. One discrete state, the mode; unilateral springs and their phases;
//! friction that sticks and slips; and the guards where the mode ends, which `integrator/locator.rs` finds.
//!
//! Invariant: knows the methods by their interface [`crate::integrator::System`] only, and no effect.

pub mod friction;
mod guards;
mod mode;
pub mod unilateral;

pub use friction::{
    FrictionConstraint, FrictionConstraints, FrictionGuard, FrictionGuards, FrictionPlace, Frictional, Law, stick_velocity,
};
pub use guards::GuardValues;
pub use mode::{CONTACT, FRICTION_PLACES, INDICATORS, Mode, SPRINGS, STOPS, SlipDirection, StickSlip, StickSlips, TIP_FRICTION};
pub use unilateral::{MeanReaction, UnilateralGuard, UnilateralSpring};

use crate::integrator;
use crate::mechanism::LINKS;

/// Bounds on the derivatives of the link angles over a step.
pub type Extremes = integrator::Extremes<LINKS>;
