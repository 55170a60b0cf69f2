//! Accuracy of the unit in following measured machines: figures of its estimator, with their targets.
//!
//! Machines are simulations with other parameters, pushes and encoders. All random values come from seeds that were not used to choose any
//! setting.

#![expect(clippy::needless_range_loop, reason = "matrices are indexed as formulas index them")]

pub mod benchmark;
pub mod causes;
pub mod compare;
pub mod detection;
pub mod faults;
pub mod forecast;
pub mod foreign;
pub mod geometry;
pub mod learning;
pub mod machine;
pub mod quality;
pub mod report;
pub mod scores;
pub mod singular;
pub mod starts;
