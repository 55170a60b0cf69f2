//! The C interface: FMI 2.0 for co-simulation and model exchange, function by function.
//!
//! | file | holds |
//! | --- | --- |
//! | `types.rs` | fmi2TypesPlatform.h and the types of fmi2FunctionTypes.h, names unchanged |
//! | `guard.rs` | entry of every call: null component, order of calls, panic, log |
//! | `function.rs` | the common form of a C function: arguments as slices and places, null pointers refused |
//! | `library.rs` | path of the file that contains this library |
//! | `common.rs` | functions common to all FMUs (FMI 2.0.4, section 2.1) |
//! | `cosimulation.rs` | functions for co-simulation (section 4.2.1) |
//! | `exchange.rs` | functions for model exchange (section 3.2) |
//! | `state.rs` | stored states (section 2.1.8) |
//! | `derivatives.rs` | directional derivatives (section 2.1.9), time derivatives of inputs and outputs (section 4.2.1) |
//!
//! # Safety
//!
//! One contract holds for every function. If a checked condition is violated, the function returns a status; the other conditions are up to
//! the caller.
//!
//! Checked here:
//! - a null component, null arrays (allowed with length 0), null results, null strings;
//! - the order of calls, value references, types and values, by the rules in `crate::fmi`;
//! - a panic, which becomes fmi2Fatal and poisons the instance: from then on it can only be freed.
//!
//! Required of the caller, as in the standard:
//! - a component comes from [`fmi2Instantiate`] of this library and has not been freed;
//! - an instance is used by one thread at a time (different instances are independent);
//! - a stored state comes from this library and has not been freed; it is not overwritten or freed while another thread reads it (restoring
//!   it and serialising it only read it);
//! - arrays have the length that is passed with them, strings end with a zero byte, and neither changes during the call;
//! - the callbacks stay valid until the instance is freed; the logger does not call back into the same instance and does not unwind.
//!
//! The caller owns every pointer that it passes; only the callbacks and the component environment are kept. The strings of
//! [`fmi2GetVersion`] and [`fmi2GetTypesPlatform`] are static. The memory callbacks and stepFinished are not used.
//!
//! Nothing is printed, with one exception: Rust's panic hook writes the place of a defect to stderr before the panic is caught. A hook of
//! our own would be global state that outlives the instances, and a bug report needs this line.

#![allow(unsafe_code, reason = "raw pointers come in here and go no further")]
#![allow(non_camel_case_types, non_snake_case, non_upper_case_globals, reason = "the names are those of the standard's headers")]

mod common;
mod cosimulation;
mod derivatives;
mod exchange;
mod function;
mod guard;
mod library;
mod state;
mod types;

pub use common::*;
pub use cosimulation::*;
pub use derivatives::*;
pub use exchange::*;
pub use state::*;
pub use types::*;
