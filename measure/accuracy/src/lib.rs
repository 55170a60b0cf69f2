//! Accuracy against wall time: every scene with a reference solution, by every method at many steps or tolerances.
//!
//! A [`Scene`] is a file of `scenes/` with a [`Reference`]; a [`Choice`] is a method with its step or tolerance. Each result goes to a CSV
//! file: [`precision`] (error against wall time), [`energy`] (50 s), [`horizon`] (time until a run diverges) and [`steps`] (wall time of
//! single milliseconds). `cargo xtask report` draws them.

pub mod choice;
pub mod energy;
pub mod horizon;
pub mod precision;
mod reference;
mod run;
mod scene;
pub mod steps;
mod table;

pub use choice::Choice;
pub use reference::Reference;
pub use run::{COMMUNICATION, Run};
pub use scene::{Kind, Scene};
pub use table::Folder;

/// Extent of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Everything.
    Full,
    /// A sample of everything within seconds, for tests.
    Quick,
}
