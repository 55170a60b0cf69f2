//! Functions common to all FMUs (FMI 2.0.4, section 2.1).

use std::ffi::CStr;
use std::panic::catch_unwind;
use std::ptr::null_mut;

use super::c_types::size_t;

use super::arrays::{not_null, slice, string};
use super::guard::{Component, guard};
use super::types::{
    fmi2Boolean, fmi2CallbackFunctions, fmi2CoSimulation, fmi2Component, fmi2False, fmi2Integer, fmi2ModelExchange, fmi2Real,
    fmi2Status, fmi2String, fmi2Type, fmi2ValueReference,
};
use crate::fmi::{Call, CallError, Instance, Kind};
use crate::variables::{FmiType, GUID, Value};

/// The platform of the types: `default` (section 2.1.2).
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetTypesPlatform() -> fmi2String {
    c"default".as_ptr()
}

/// The version of the standard: `2.0` (section 2.1.4).
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetVersion() -> fmi2String {
    c"2.0".as_ptr()
}

/// A fresh instance, or null with a log line (section 2.1.5). Resources are not needed and nothing is shown.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Instantiate(
    instanceName: fmi2String,
    fmuType: fmi2Type,
    fmuGUID: fmi2String,
    _fmuResourceLocation: fmi2String,
    functions: *const fmi2CallbackFunctions,
    _visible: fmi2Boolean,
    loggingOn: fmi2Boolean,
) -> fmi2Component {
    // SAFETY: the caller vouches for the pointer unless it is null.
    let Some(functions) = (unsafe { functions.as_ref() }) else {
        return null_mut();
    };
    let made = catch_unwind(|| {
        let name = if instanceName.is_null() {
            c""
        } else {
            // SAFETY: the caller vouches for the string.
            unsafe { CStr::from_ptr(instanceName) }
        };
        let kind = if fmuType == fmi2ModelExchange { Kind::ModelExchange } else { Kind::CoSimulation };
        let mut component = Component::new(kind, name.to_owned(), *functions, loggingOn != fmi2False);
        // SAFETY: the caller vouches for the string unless it is null.
        let checked = unsafe { string("fmuGUID", fmuGUID) }.and_then(|guid| check_identity(name, fmuType, guid));
        match checked {
            Ok(()) => Some(component),
            Err(rejection) => {
                let text = || format!("fmi2Instantiate: {}", rejection.message);
                component.instance.log.push(rejection.status, text);
                component.send_all();
                None
            }
        }
    });
    match made {
        Ok(Some(component)) => Box::into_raw(Box::new(component)).cast(),
        Ok(None) | Err(_) => null_mut(),
    }
}

fn check_identity(name: &CStr, kind: fmi2Type, guid: &str) -> Result<(), CallError> {
    if name.is_empty() {
        return Err(CallError::error("instanceName is null or empty."));
    }
    if kind != fmi2CoSimulation && kind != fmi2ModelExchange {
        return Err(CallError::error(format!(
            "fmuType is {kind}, must be fmi2ModelExchange ({fmi2ModelExchange}) or fmi2CoSimulation ({fmi2CoSimulation})."
        )));
    }
    if guid != GUID {
        return Err(CallError::error(format!("fmuGUID is {guid}, this library belongs to {GUID}.")));
    }
    Ok(())
}

/// Frees an instance; null is allowed (section 2.1.5).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeInstance(c: fmi2Component) {
    if !c.is_null() {
        // SAFETY: the caller vouches that it comes from fmi2Instantiate, which leaked a box, and is not used again.
        drop(unsafe { Box::from_raw(c.cast::<Component>()) });
    }
}

/// Selects the log categories that are passed on (section 2.1.5).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetDebugLogging(
    c: fmi2Component,
    loggingOn: fmi2Boolean,
    nCategories: size_t,
    categories: *const fmi2String,
) -> fmi2Status {
    let body = |instance: &mut Instance| {
        // SAFETY: the caller vouches for the array and its strings.
        let names = unsafe { slice("categories", categories, nCategories) }?;
        // SAFETY: as above.
        let names = names.iter().map(|name| unsafe { string("a category", *name) });
        let names = names.collect::<Result<Vec<&str>, _>>()?;
        instance.set_debug_logging(loggingOn != fmi2False, names.into_iter())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SetDebugLogging, body) }
}

/// Start and end of the experiment (section 2.1.6); the tolerance is not used.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetupExperiment(
    c: fmi2Component,
    toleranceDefined: fmi2Boolean,
    tolerance: fmi2Real,
    startTime: fmi2Real,
    stopTimeDefined: fmi2Boolean,
    stopTime: fmi2Real,
) -> fmi2Status {
    let defined = |flag: fmi2Boolean, value| (flag != fmi2False).then_some(value);
    let body = |instance: &mut Instance| {
        let (tolerance, stop) = (defined(toleranceDefined, tolerance), defined(stopTimeDefined, stopTime));
        instance.setup_experiment(tolerance, startTime, stop)
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SetupExperiment, body) }
}

/// Defines functions that take nothing but the instance.
macro_rules! plain {
    ($($(#[doc = $doc:literal])+ $name:ident: $call:ident => $method:ident;)+) => {$(
        $(#[doc = $doc])+
        ///
        /// # Safety
        /// See the contract of [`crate::ffi`].
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(c: fmi2Component) -> fmi2Status {
            // SAFETY: the caller vouches for the component.
            unsafe { guard(c, Call::$call, Instance::$method) }
        }
    )+};
}

plain! {
    /// Begins initialisation (section 2.1.6).
    fmi2EnterInitializationMode: EnterInitializationMode => enter_initialization_mode;
    /// Ends initialisation: the scene is validated and made ready (section 2.1.6).
    fmi2ExitInitializationMode: ExitInitializationMode => exit_initialization_mode;
    /// Ends the run (section 2.1.6).
    fmi2Terminate: Terminate => terminate;
    /// Back to a fresh instance (section 2.1.6).
    fmi2Reset: Reset => reset;
}

/// Defines the getter and the setter of a type (section 2.1.7).
macro_rules! access {
    ($($get:ident $set:ident: $c_type:ty, $access:ident, $get_call:ident $set_call:ident, $to_c:expr, $from_c:expr;)+) => {$(
        /// Reads variables (section 2.1.7).
        ///
        /// # Safety
        /// See the contract of [`crate::ffi`].
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $get(
            c: fmi2Component,
            vr: *const fmi2ValueReference,
            nvr: size_t,
            value: *mut $c_type,
        ) -> fmi2Status {
            let body = |instance: &mut Instance| {
                // SAFETY: the caller vouches for the array.
                let references = unsafe { slice("vr", vr, nvr) }?;
                if nvr > 0 {
                    not_null("value", value)?;
                }
                instance.get(FmiType::$access, references, |position, found| {
                    let to_c: fn(Value) -> Option<$c_type> = $to_c;
                    if let Some(found) = to_c(found) {
                        // SAFETY: not null, and the caller vouches for nvr places, one per reference.
                        unsafe { value.add(position).write(found) }
                    }
                })
            };
            // SAFETY: the caller vouches for the component.
            unsafe { guard(c, Call::$get_call, body) }
        }

        /// Sets variables, all or none (section 2.1.7).
        ///
        /// # Safety
        /// See the contract of [`crate::ffi`].
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $set(
            c: fmi2Component,
            vr: *const fmi2ValueReference,
            nvr: size_t,
            value: *const $c_type,
        ) -> fmi2Status {
            let body = |instance: &mut Instance| {
                // SAFETY: the caller vouches for both arrays.
                let (references, values) = unsafe { (slice("vr", vr, nvr)?, slice("value", value, nvr)?) };
                let from_c: fn($c_type) -> Value = $from_c;
                let values = values.iter().map(|value| from_c(*value));
                instance.set(references.iter().copied().zip(values))
            };
            // SAFETY: the caller vouches for the component.
            unsafe { guard(c, Call::$set_call, body) }
        }
    )+};
}

access! {
    fmi2GetReal fmi2SetReal: fmi2Real, Real, GetReal SetReal,
        |value| if let Value::Real(x) = value { Some(x) } else { None }, Value::Real;
    fmi2GetInteger fmi2SetInteger: fmi2Integer, Integer, GetInteger SetInteger,
        |value| if let Value::Integer(n) = value { Some(n) } else { None }, Value::Integer;
    fmi2GetBoolean fmi2SetBoolean: fmi2Boolean, Boolean, GetBoolean SetBoolean,
        |value| if let Value::Boolean(b) = value { Some(b.into()) } else { None }, |b| Value::Boolean(b != fmi2False);
}

/// There are no String variables: an error unless `nvr` is 0 (section 2.1.7).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetString(
    c: fmi2Component,
    vr: *const fmi2ValueReference,
    nvr: size_t,
    _value: *mut fmi2String,
) -> fmi2Status {
    let body = |instance: &mut Instance| {
        // SAFETY: the caller vouches for the array.
        let references = unsafe { slice("vr", vr, nvr) }?;
        instance.no_strings(references)
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::GetString, body) }
}

/// There are no String variables: an error unless `nvr` is 0 (section 2.1.7).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetString(
    c: fmi2Component,
    vr: *const fmi2ValueReference,
    nvr: size_t,
    _value: *const fmi2String,
) -> fmi2Status {
    let body = |instance: &mut Instance| {
        // SAFETY: the caller vouches for the array.
        let references = unsafe { slice("vr", vr, nvr) }?;
        instance.no_strings(references)
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SetString, body) }
}
