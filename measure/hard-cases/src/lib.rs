//! The battery of hard cases: five-bar motion through and near singularities, by every method, with pass or fail.
//!
//! A [`Case`] is data: trials (a scene, a start, a schedule of loads and communication steps, what to watch) and requirements on the
//! result. [`Case::measure`] runs it with a [`Setting`] (method, step, tolerance) and returns a [`Row`]. The cases are in [`cases`], in the
//! numbered groups of `docs/hard-cases.md`.

pub mod books;
pub mod cases;
pub mod checks;
pub mod coaxial;
pub mod ends;
pub mod gauss;
pub mod horizon;
pub mod independent;
mod machine;
mod random;
mod report;
mod setting;
pub mod speed;
pub mod step_times;
pub mod sticking;
mod trial;
mod vertex;
mod watch;

pub use cases::{Case, Demand, Extent};
pub use machine::mgl;
pub use report::{Row, Verdict, write_csv, write_markdown};
pub use setting::Setting;
pub use trial::{Beginning, Ending, Outcome, Span, Trial};
pub use vertex::{POSTURES, Vertex};
pub use watch::{Sample, Watch};
