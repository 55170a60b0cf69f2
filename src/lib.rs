//! Planar five-bar mechanism as a unit for FMI 2.0 co-simulation and model exchange.
//!
//! The modules and the arrows between them are described in `ARCHITECTURE.md`.

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
