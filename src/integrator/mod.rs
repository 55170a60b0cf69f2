//! i3-ALP and its companions, generic over the [`System`] they integrate.
//!
//! Invariant: knows neither mechanism nor FMI; does no input or output, allocates nothing, reads no clock.

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
pub use system::{AccelerationTangents, Held, Implicit, Kkt, System, TangentPoint, Work};

/// The methods whose steps end with the macro step.
#[derive(Clone, Copy, Debug)]
pub enum MacroStepMethod {
    /// The default.
    I3alp(i3alp::Settings),
    /// As printed in the paper.
    I3alpPrinted(i3alp_printed::Settings),
    /// Runge–Kutta with projection.
    Rk4(rk4::Settings),
}

impl MacroStepMethod {
    /// One macro step of h seconds. On failure the state is undefined: the caller keeps a copy.
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
