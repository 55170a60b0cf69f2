//! Published multibody benchmarks, run through the very same integrator code as the five-bar: support for tests and benchmarks.
//!
//! One file per benchmark: its data, where they come from, the published result. `docs/notes/problems.md` says how each is set up
//! and what the required precision costs. Two of the three are [`Linkage`]s: bodies in x, y, θ joined by revolutes.

pub mod four_bars;
pub mod linkage;
pub mod pendulum;
mod run;
pub mod squeezer;

pub use linkage::Linkage;
pub use run::{Method, Outcome, Problem};
