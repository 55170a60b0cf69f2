//! Discontinuous forces: one discrete state, the mode; force laws with kinks, and unilateral springs among them; friction that sticks and slips; and the guards
//! at which the mode ends, which `integrator/locator.rs` finds.
//!
//! Invariant: uses the methods only through their interface [`crate::integrator::System`], and knows no effect.

pub mod friction;
mod guards;
pub mod kink;
mod mode;
pub mod unilateral;

pub use friction::{
    FrictionConstraint, FrictionConstraints, FrictionGuard, FrictionGuards, FrictionPlace, Frictional, Law, stick_velocity,
};
pub use guards::{GuardValues, INDICATORS, Kinks};
pub use kink::{Border, Kink, Levels, Piecewise};
pub use mode::{FRICTION_PLACES, KINKS, Mode, Phase, SlipDirection, StickSlip, StickSlips, TIP_FRICTION};
pub use unilateral::{MeanReaction, UnilateralSpring};

use crate::integrator;
use crate::mechanism::LINKS;

/// Bounds on the derivatives of the link angles over a step.
pub type Extremes = integrator::Extremes<LINKS>;

/// Bound on a derivative of order 1 to 4 of a length. `arms` are its largest derivatives with respect to the link angles; these lever arms
/// turn with the links.
fn derivative_bound(arms: &[f64; LINKS], order: usize, Extremes { rates, accelerations, jerks, snaps }: &Extremes) -> f64 {
    // Derivatives of û(θ), the unit vector along a link.
    let of_direction = |link: usize| {
        let (w, a) = (rates[link], accelerations[link]);
        match order {
            1 => w,
            2 => a + w * w,
            3 => jerks[link] + w * (3.0 * a + w * w),
            _ => snaps[link] + 4.0 * w * jerks[link] + 3.0 * a * a + w * w * (6.0 * a + w * w),
        }
    };
    (0..LINKS).map(|link| arms[link] * of_direction(link)).sum()
}
