//! Functions for model exchange (FMI 2.0.4, section 3.2).

use super::c_types::size_t;

use super::arrays::{not_null, slice};
use super::guard::guard;
use super::types::{fmi2Boolean, fmi2Component, fmi2EventInfo, fmi2False, fmi2Real, fmi2Status};
use crate::fmi::{Call, CallError, Instance, STATES};

/// Sets the time, s (section 3.2.1).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetTime(c: fmi2Component, time: fmi2Real) -> fmi2Status {
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SetTime, |instance| instance.set_time(time)) }
}

/// Sets the states (section 3.2.1); discarded, with the instance unchanged, where theta and omega are no coordinates.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetContinuousStates(c: fmi2Component, x: *const fmi2Real, nx: size_t) -> fmi2Status {
    let body = |instance: &mut Instance| {
        // SAFETY: the caller vouches for the array.
        let states = unsafe { slice("x", x, nx) }?;
        instance.set_continuous_states(states)
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SetContinuousStates, body) }
}

/// Begins an event (section 3.2.2).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2EnterEventMode(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::EnterEventMode, Instance::enter_event_mode) }
}

/// Puts parameters that were set into force (section 3.2.2); one call is enough.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2NewDiscreteStates(c: fmi2Component, fmi2eventInfo: *mut fmi2EventInfo) -> fmi2Status {
    let body = |instance: &mut Instance| {
        not_null("fmi2eventInfo", fmi2eventInfo)?;
        let info = fmi2EventInfo {
            newDiscreteStatesNeeded: fmi2False,
            terminateSimulation: fmi2False,
            nominalsOfContinuousStatesChanged: fmi2False,
            valuesOfContinuousStatesChanged: instance.new_discrete_states()?.into(),
            nextEventTimeDefined: fmi2False,
            nextEventTime: 0.0,
        };
        // SAFETY: not null, and the caller vouches for the place.
        unsafe { fmi2eventInfo.write(info) };
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::NewDiscreteStates, body) }
}

/// Ends an event (section 3.2.2).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2EnterContinuousTimeMode(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::EnterContinuousTimeMode, Instance::enter_continuous_time_mode) }
}

/// Accepts a step of the master's integrator (section 3.2.2); neither an event nor the end follows from it.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2CompletedIntegratorStep(
    c: fmi2Component,
    _noSetFMUStatePriorToCurrentPoint: fmi2Boolean,
    enterEventMode: *mut fmi2Boolean,
    terminateSimulation: *mut fmi2Boolean,
) -> fmi2Status {
    let body = |instance: &mut Instance| {
        not_null("enterEventMode", enterEventMode)?;
        not_null("terminateSimulation", terminateSimulation)?;
        instance.completed_integrator_step()?;
        // SAFETY: not null, and the caller vouches for the places.
        unsafe {
            enterEventMode.write(fmi2False);
            terminateSimulation.write(fmi2False);
        }
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::CompletedIntegratorStep, body) }
}

/// Writes `N` numbers to an array of the caller, whose length must be `N`.
///
/// # Safety
/// `values` is null or has `length` places.
unsafe fn write_array<const N: usize>(
    (name, values): (&str, *mut fmi2Real),
    (length_name, length): (&str, size_t),
    found: impl FnOnce() -> Result<[f64; N], CallError>,
) -> Result<(), CallError> {
    if length != N {
        return Err(CallError::error(format!("{length_name} is {length}, must be {N}.")));
    }
    not_null(name, values)?;
    let found = found()?;
    // SAFETY: not null, and the caller vouches for the places; our own numbers do not overlap them.
    unsafe { values.copy_from_nonoverlapping(found.as_ptr(), N) };
    Ok(())
}

/// Defines the getters of arrays.
macro_rules! arrays {
    ($($(#[doc = $doc:literal])+ $name:ident($values:ident, $length:ident): $call:ident => $found:expr;)+) => {$(
        $(#[doc = $doc])+
        ///
        /// # Safety
        /// See the contract of [`crate::ffi`].
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(c: fmi2Component, $values: *mut fmi2Real, $length: size_t) -> fmi2Status {
            let body = |instance: &mut Instance| {
                // SAFETY: the caller vouches for the array.
                unsafe { write_array((stringify!($values), $values), (stringify!($length), $length), || $found(instance)) }
            };
            // SAFETY: the caller vouches for the component.
            unsafe { guard(c, Call::$call, body) }
        }
    )+};
}

arrays! {
    /// Derivatives of the states with respect to time (section 3.2.2).
    fmi2GetDerivatives(derivatives, nx): GetDerivatives => Instance::state_derivatives;
    /// Event indicators: a sign change is an event (section 3.2.2).
    fmi2GetEventIndicators(eventIndicators, ni): GetEventIndicators => Instance::event_indicators;
    /// The states (section 3.2.2).
    fmi2GetContinuousStates(x, nx): GetContinuousStates => Instance::continuous_states;
    /// Nominal values of the states, 1 rad and 1 rad/s (section 3.2.2).
    fmi2GetNominalsOfContinuousStates(x_nominal, nx): GetNominalsOfContinuousStates => |_: &mut Instance| Ok([1.0; STATES]);
}
