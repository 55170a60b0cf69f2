//! Time integration of constrained mechanical systems: i3-ALP and other methods, generic over the [`System`] that they integrate.
//!
//! Invariant: no module here knows the mechanism or FMI; none does input or output, allocates, or reads a clock.

pub mod checks;
mod consistency;
mod controller;
mod convergence;
pub mod dense;
mod dense_output;
mod discrete;
mod driver;
mod equilibrium;
mod error;
mod events;
pub mod i3alp;
pub mod i3alp_conserving;
pub mod i3alp_printed;
mod locator;
mod passage;
mod projection;
pub mod rk4;
mod state;
mod system;

pub use consistency::{Bounds, Inconsistency};
pub use discrete::{CutStep, Discrete, StepIncrement};
pub use equilibrium::{equilibrium, reaction};
pub use error::StepError;
pub use events::{ERROR_RATE, Events, Extremes, Guards, Residuals};
pub use locator::{CROSSING_RESIDUAL, Path};
pub use passage::{Approach, Departure, EnergyBalance, Passage, PassageLimits, StepLimits, Transit};
pub use projection::{Projection, velocity_correction};
use state::StepEnd;
pub use state::{CONFIGURATION_SIGNS, Counters, State};
pub use system::{AccelerationTangents, Features, Implicit, Kkt, Posed, StickingConstraint, Stuck, System, TangentPoint, Work};

/// A system with everything that error-controlled methods need: equations of motion, passages through vertices, and events.
pub trait Mechanics<const N: usize, const M: usize>: System<N, M> + Passage<N> + Events<N> {}

impl<const N: usize, const M: usize, S: System<N, M> + Passage<N> + Events<N>> Mechanics<N, M> for S {}
