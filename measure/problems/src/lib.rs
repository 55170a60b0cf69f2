//! Published multibody benchmarks, run by the same integrator code as the five-bar: support for tests and benchmarks.
//!
//! One file per benchmark: its data, their source, the published result. `docs/notes/problems.md` describes each setup and the cost of the
//! required precision. Two of the three are [`Linkage`]s: bodies in x, y, θ joined by revolutes.

pub mod four_bars;
pub mod linkage;
pub mod pendulum;
mod run;
pub mod squeezer;

pub use linkage::Linkage;
pub use run::{Method, Outcome, Problem};
