//! Functions common to all FMUs (FMI 2.0.4, section 2.1).

use std::convert::identity;
use std::ffi::CStr;
use std::panic::catch_unwind;
use std::ptr::null_mut;

use super::function::{functions, string};
use super::guard::Component;
use super::library;
use super::types::{
    fmi2Boolean, fmi2CallbackFunctions, fmi2CoSimulation, fmi2Component, fmi2False, fmi2Integer, fmi2ModelExchange, fmi2Real,
    fmi2String, fmi2Type, fmi2ValueReference, size_t,
};
use crate::fmi::{CallError, Kind, Unit};
use crate::variables::{FmiType, Value};

/// Returns the platform of the types: `default` (section 2.1.2).
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetTypesPlatform() -> fmi2String {
    c"default".as_ptr()
}

/// Returns the version of the standard: `2.0` (section 2.1.4).
#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetVersion() -> fmi2String {
    c"2.0".as_ptr()
}

/// Creates an instance (section 2.1.5). Returns null with a log message for a missing name, an unknown type or a wrong GUID. Only an FMU
/// with start values of its own reads its resources; nothing is displayed.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Instantiate(
    instanceName: fmi2String,
    fmuType: fmi2Type,
    fmuGUID: fmi2String,
    fmuResourceLocation: fmi2String,
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
        let resources = (!fmuResourceLocation.is_null()).then(|| unsafe { CStr::from_ptr(fmuResourceLocation) }.to_bytes());
        // SAFETY: the caller vouches for the string unless it is null.
        let guid = unsafe { string("fmuGUID", fmuGUID) };
        let unit = check_kind(name, fmuType).and(guid).and_then(|guid| Unit::find(guid, resources, library::path));
        match unit {
            Ok(unit) => {
                component.instance.belong_to(unit);
                Some(component)
            }
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

fn check_kind(name: &CStr, kind: fmi2Type) -> Result<(), CallError> {
    if name.is_empty() {
        return Err(CallError::error("instanceName is null or empty."));
    }
    if kind != fmi2CoSimulation && kind != fmi2ModelExchange {
        return Err(CallError::error(format!(
            "fmuType is {kind}, must be fmi2ModelExchange ({fmi2ModelExchange}) or fmi2CoSimulation ({fmi2CoSimulation})."
        )));
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
        // SAFETY: the caller vouches that the component comes from fmi2Instantiate, which leaked a box, and is not used again.
        drop(unsafe { Box::from_raw(c.cast::<Component>()) });
    }
}

functions! {
    /// Selects the log categories that reach the master (section 2.1.5). Refuses unknown categories.
    fmi2SetDebugLogging(loggingOn: fmi2Boolean, nCategories: size_t, categories: [in fmi2String; nCategories]) |instance| {
        // SAFETY: the caller vouches for the strings.
        let names = categories.iter().map(|name| unsafe { string("a category", *name) }).collect::<Result<Vec<&str>, _>>()?;
        instance.log.choose(loggingOn != fmi2False, names.into_iter())?;
    };
    /// Sets start and end of the experiment (section 2.1.6); the tolerance is not used.
    fmi2SetupExperiment(
        toleranceDefined: fmi2Boolean,
        tolerance: fmi2Real,
        startTime: fmi2Real,
        stopTimeDefined: fmi2Boolean,
        stopTime: fmi2Real
    ) |instance| {
        let defined = |flag: fmi2Boolean, value| (flag != fmi2False).then_some(value);
        instance.setup_experiment(defined(toleranceDefined, tolerance), startTime, defined(stopTimeDefined, stopTime))?;
    };
    /// Begins initialisation (section 2.1.6).
    fmi2EnterInitializationMode() |instance| instance.enter_initialization_mode()?;
    /// Ends initialisation: validates and prepares the scene (section 2.1.6).
    fmi2ExitInitializationMode() |instance| instance.exit_initialization_mode()?;
    /// Ends the run (section 2.1.6).
    fmi2Terminate() |instance| instance.terminate();
    /// Returns the instance to its state after instantiation (section 2.1.6).
    fmi2Reset() |instance| instance.reset();
    /// Refuses all references, because there are no String variables; `nvr` = 0 is allowed (section 2.1.7).
    fmi2GetString(vr: [in fmi2ValueReference; nvr], nvr: size_t, _value: [raw *mut fmi2String]) |instance| instance.no_strings(vr)?;
    /// Refuses all references, because there are no String variables; `nvr` = 0 is allowed (section 2.1.7).
    fmi2SetString(vr: [in fmi2ValueReference; nvr], nvr: size_t, _value: [raw *const fmi2String]) |instance| instance.no_strings(vr)?;
}

/// Defines the getter and the setter of a type (section 2.1.7).
macro_rules! access {
    ($($get:ident $set:ident: $c_type:ident, $type:ident, $to_c:expr, $from_c:expr;)+) => { functions! {$(
        /// Reads variables (section 2.1.7).
        $get(vr: [in fmi2ValueReference; nvr], nvr: size_t, value: [out $c_type; nvr]) |instance| {
            for (place, found) in value.iter_mut().zip(instance.get(FmiType::$type, vr)?) {
                if let Value::$type(found) = *found {
                    place.write($to_c(found));
                }
            }
        };
        /// Sets all variables, or none if it refuses one (section 2.1.7).
        $set(vr: [in fmi2ValueReference; nvr], nvr: size_t, value: [in $c_type; nvr]) |instance|
            instance.set(vr.iter().copied().zip(value.iter().map(|value| Value::$type($from_c(*value)))))?;
    )+} };
}

access! {
    fmi2GetReal fmi2SetReal: fmi2Real, Real, identity, identity;
    fmi2GetInteger fmi2SetInteger: fmi2Integer, Integer, identity, identity;
    fmi2GetBoolean fmi2SetBoolean: fmi2Boolean, Boolean, fmi2Boolean::from, |value| value != fmi2False;
}
