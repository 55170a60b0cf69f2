//! fmi2TypesPlatform.h ("default") and the types of fmi2FunctionTypes.h (FMI 2.0.4, sections 2.1.2 to 2.1.5).
//!
//! Enumerations are plain integers, because C may pass any number by mistake and a Rust enum must not hold an undefined one.

use std::ffi::{c_char, c_int, c_uint, c_void};

use crate::fmi::Status;

/// Length of an array: C's size_t.
pub type size_t = usize;

/// Pointer to an instance.
pub type fmi2Component = *mut c_void;
/// Pointer of the master, passed back to its logger.
pub type fmi2ComponentEnvironment = *mut c_void;
/// Pointer to a stored state.
pub type fmi2FMUstate = *mut c_void;
/// Identifies a variable.
pub type fmi2ValueReference = c_uint;
/// Value of a Real variable.
pub type fmi2Real = f64;
/// Value of an Integer or Enumeration variable.
pub type fmi2Integer = c_int;
/// Boolean: [`fmi2True`] or [`fmi2False`].
pub type fmi2Boolean = c_int;
/// Character.
pub type fmi2Char = c_char;
/// UTF-8 text that ends with a zero byte.
pub type fmi2String = *const fmi2Char;
/// Byte of a serialised state: a char in C, which may be signed.
pub type fmi2Byte = u8;

/// True.
pub const fmi2True: fmi2Boolean = 1;
/// False.
pub const fmi2False: fmi2Boolean = 0;

/// Status of a call.
pub type fmi2Status = c_int;
/// The call succeeded.
pub const fmi2OK: fmi2Status = Status::Ok as fmi2Status;
/// The call succeeded, but the master probably made a mistake.
pub const fmi2Warning: fmi2Status = Status::Warning as fmi2Status;
/// The call could not be completed.
pub const fmi2Discard: fmi2Status = Status::Discard as fmi2Status;
/// The call was refused.
pub const fmi2Error: fmi2Status = Status::Error as fmi2Status;
/// The library has a defect.
pub const fmi2Fatal: fmi2Status = Status::Fatal as fmi2Status;

/// Kind of FMU.
pub type fmi2Type = c_int;
/// Model exchange.
pub const fmi2ModelExchange: fmi2Type = 0;
/// Co-simulation.
pub const fmi2CoSimulation: fmi2Type = 1;

/// Result of fmi2NewDiscreteStates.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct fmi2EventInfo {
    /// Whether fmi2NewDiscreteStates must be called again.
    pub newDiscreteStatesNeeded: fmi2Boolean,
    /// Whether the simulation must end.
    pub terminateSimulation: fmi2Boolean,
    /// Whether nominal values of the states have changed.
    pub nominalsOfContinuousStatesChanged: fmi2Boolean,
    /// Whether values of the states have changed.
    pub valuesOfContinuousStatesChanged: fmi2Boolean,
    /// Whether the time of the next event is known.
    pub nextEventTimeDefined: fmi2Boolean,
    /// Time of the next event, s.
    pub nextEventTime: fmi2Real,
}

/// Kind of status: fmi2DoStepStatus 0, fmi2PendingStatus 1, fmi2LastSuccessfulTime 2, fmi2Terminated 3.
pub type fmi2StatusKind = c_int;

/// The master's logger. The message is complete text: no further arguments follow, and `%` is doubled.
pub type fmi2CallbackLogger = unsafe extern "C" fn(
    componentEnvironment: fmi2ComponentEnvironment,
    instanceName: fmi2String,
    status: fmi2Status,
    category: fmi2String,
    message: fmi2String,
    ...
);
/// Not used.
pub type fmi2CallbackAllocateMemory = unsafe extern "C" fn(nobj: size_t, size: size_t) -> *mut c_void;
/// Not used.
pub type fmi2CallbackFreeMemory = unsafe extern "C" fn(obj: *mut c_void);
/// Not used: steps are never pending.
pub type fmi2StepFinished = unsafe extern "C" fn(componentEnvironment: fmi2ComponentEnvironment, status: fmi2Status);

/// The master's callbacks; each may be null.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct fmi2CallbackFunctions {
    /// Receives log lines.
    pub logger: Option<fmi2CallbackLogger>,
    /// Not used.
    pub allocateMemory: Option<fmi2CallbackAllocateMemory>,
    /// Not used.
    pub freeMemory: Option<fmi2CallbackFreeMemory>,
    /// Not used.
    pub stepFinished: Option<fmi2StepFinished>,
    /// Passed back to the logger.
    pub componentEnvironment: fmi2ComponentEnvironment,
}
