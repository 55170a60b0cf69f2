//! Functions for co-simulation (FMI 2.0.4, section 4.2.1).

use super::arrays::not_null;
use super::guard::guard;
use super::types::{fmi2Boolean, fmi2Component, fmi2Integer, fmi2Real, fmi2Status, fmi2StatusKind, fmi2String};
use crate::fmi::status::StatusKind;
use crate::fmi::{Call, Instance};

/// Takes one communication step (section 4.2.2). Stored states belong to the master, so the last argument is ignored.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DoStep(
    c: fmi2Component,
    currentCommunicationPoint: fmi2Real,
    communicationStepSize: fmi2Real,
    _noSetFMUStatePriorToCurrentPoint: fmi2Boolean,
) -> fmi2Status {
    let body = |instance: &mut Instance| instance.do_step(currentCommunicationPoint, communicationStepSize);
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::DoStep, body) }
}

/// Refused: a step is never pending (section 4.2.2).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2CancelStep(c: fmi2Component) -> fmi2Status {
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::CancelStep, |instance| instance.cancel_step()) }
}

/// The communication point reached, for fmi2LastSuccessfulTime (section 4.2.3).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealStatus(c: fmi2Component, s: fmi2StatusKind, value: *mut fmi2Real) -> fmi2Status {
    let body = |instance: &mut Instance| {
        not_null("value", value)?;
        let time = instance.real_status(StatusKind::from_number(s)?)?;
        // SAFETY: not null, and the caller vouches for the place.
        unsafe { value.write(time) };
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::GetRealStatus, body) }
}

/// False for fmi2Terminated (section 4.2.3).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetBooleanStatus(c: fmi2Component, s: fmi2StatusKind, value: *mut fmi2Boolean) -> fmi2Status {
    let body = |instance: &mut Instance| {
        not_null("value", value)?;
        let terminated = instance.boolean_status(StatusKind::from_number(s)?)?;
        // SAFETY: not null, and the caller vouches for the place.
        unsafe { value.write(terminated.into()) };
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::GetBooleanStatus, body) }
}

/// Defines the status functions without a status of their type: fmi2Discard (section 4.2.3).
macro_rules! unavailable_status {
    ($($name:ident: $call:ident, $kind:ty;)+) => {$(
        /// fmi2Discard: no status of this type is available (section 4.2.3).
        ///
        /// # Safety
        /// See the contract of [`crate::ffi`].
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(c: fmi2Component, s: fmi2StatusKind, _value: *mut $kind) -> fmi2Status {
            let body = |instance: &mut Instance| instance.other_status(StatusKind::from_number(s)?);
            // SAFETY: the caller vouches for the component.
            unsafe { guard(c, Call::$call, body) }
        }
    )+};
}

unavailable_status! {
    fmi2GetStatus: GetStatus, fmi2Status;
    fmi2GetIntegerStatus: GetIntegerStatus, fmi2Integer;
    fmi2GetStringStatus: GetStringStatus, fmi2String;
}
