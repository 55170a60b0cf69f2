//! Planar five-bar mechanism as an FMI 2.0 unit for co-simulation and model exchange.
//!
//! `ARCHITECTURE.md` describes the modules and their dependencies.

mod copies;
pub mod dynamics;
pub mod effects;
pub mod estimator;
pub mod ffi;
pub mod fmi;
pub mod hybrid;
pub mod integrator;
pub mod linear;
pub mod matrix;
pub mod mechanism;
pub mod observers;
pub mod scalar;
pub mod simulation;
pub mod variables;
pub mod vector;
