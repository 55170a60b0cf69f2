//! Time integration of constrained mechanical systems: i3-ALP and the methods beside it, generic over the [`System`] they
//! integrate.
//!
//! Invariant: no module here knows the mechanism or FMI; none does input or output, allocates, or reads a clock.

mod consistency;
mod controller;
pub mod dense;
mod discrete;
mod equilibrium;
mod error;
mod events;
pub mod i3alp;
pub mod i3alp_conserving;
pub mod i3alp_printed;
mod passage;
mod projection;
pub mod rk4;
mod state;
mod system;

pub use consistency::{Bounds, Inconsistency};
pub use discrete::{CutStep, Discrete, StepIncrement};
pub use equilibrium::{equilibrium, equilibrium_at};
pub use error::StepError;
pub use events::{Events, Extremes};
pub use passage::{Approach, Departure, EnergyBalance, Passage, PassageLimits, StepLimits, Transit};
pub use projection::{Projection, velocity_correction};
use state::StepEnd;
pub use state::{CONFIGURATION_SIGNS, Counters, State};
pub use system::{AccelerationTangents, Implicit, Kkt, StickingConstraint, System, TangentPoint, Work};

/// Methods that begin and end a step with each macro step.
#[derive(Clone, Copy, Debug)]
pub enum MacroStepMethod {
    /// Index-3 augmented Lagrangian with projections in dual form, the default.
    I3alp(i3alp::Settings),
    /// Index-3 augmented Lagrangian with projections in the penalty form of the paper.
    I3alpPrinted(i3alp_printed::Settings),
    /// Classical Runge–Kutta of order 4 with projection.
    Rk4(rk4::Settings),
}

impl MacroStepMethod {
    /// Advances `state` and `mode` by one macro step of `h` seconds. On failure both are undefined, so the caller keeps a copy.
    #[inline(always)]
    pub fn advance<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
        &self,
        system: &S,
        state: &mut State<N, M>,
        mode: &mut S::Mode,
        h: f64,
    ) -> Result<(), StepError> {
        match self {
            Self::I3alp(settings) => i3alp::advance(system, settings, state, mode, h),
            Self::I3alpPrinted(settings) => i3alp_printed::advance(system, settings, state, h),
            Self::Rk4(settings) => rk4::advance(system, settings, state, h),
        }
    }
}
