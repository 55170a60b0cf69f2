//! Derivatives: of outputs with respect to inputs and continuous states (FMI 2.0.4, section 2.1.9), of inputs and outputs with respect
//! to time (section 4.2.1).

use super::c_types::size_t;

use super::arrays::{not_null, slice};
use super::guard::guard;
use super::types::{fmi2Component, fmi2Integer, fmi2Real, fmi2Status, fmi2ValueReference};
use crate::fmi::{Call, Instance};

/// Changes of the unknowns for changes `dvKnown` of the knowns (section 2.1.9).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetDirectionalDerivative(
    c: fmi2Component,
    vUnknown_ref: *const fmi2ValueReference,
    nUnknown: size_t,
    vKnown_ref: *const fmi2ValueReference,
    nKnown: size_t,
    dvKnown: *const fmi2Real,
    dvUnknown: *mut fmi2Real,
) -> fmi2Status {
    let body = |instance: &mut Instance| {
        // SAFETY: the caller vouches for the arrays.
        let (unknowns, knowns, changes) = unsafe {
            (
                slice("vUnknown_ref", vUnknown_ref, nUnknown)?,
                slice("vKnown_ref", vKnown_ref, nKnown)?,
                slice("dvKnown", dvKnown, nKnown)?,
            )
        };
        if nUnknown > 0 {
            not_null("dvUnknown", dvUnknown)?;
        }
        instance.directional_derivative(unknowns, knowns.iter().copied().zip(changes.iter().copied()), |position, value| {
            // SAFETY: not null, and the caller vouches for nUnknown places, one per reference.
            unsafe { dvUnknown.add(position).write(value) }
        })
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::GetDirectionalDerivative, body) }
}

/// Sets derivatives of inputs, all or none (section 4.2.1).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetRealInputDerivatives(
    c: fmi2Component,
    vr: *const fmi2ValueReference,
    nvr: size_t,
    order: *const fmi2Integer,
    value: *const fmi2Real,
) -> fmi2Status {
    let body = |instance: &mut Instance| {
        // SAFETY: the caller vouches for the arrays.
        let (references, orders, values) =
            unsafe { (slice("vr", vr, nvr)?, slice("order", order, nvr)?, slice("value", value, nvr)?) };
        let triples = references.iter().zip(orders).zip(values).map(|((reference, order), value)| (*reference, *order, *value));
        instance.set_input_derivatives(triples)
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SetRealInputDerivatives, body) }
}

/// Reads derivatives of outputs at the present communication point (section 4.2.1).
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealOutputDerivatives(
    c: fmi2Component,
    vr: *const fmi2ValueReference,
    nvr: size_t,
    order: *const fmi2Integer,
    value: *mut fmi2Real,
) -> fmi2Status {
    let body = |instance: &mut Instance| {
        // SAFETY: the caller vouches for the arrays.
        let (references, orders) = unsafe { (slice("vr", vr, nvr)?, slice("order", order, nvr)?) };
        if nvr > 0 {
            not_null("value", value)?;
        }
        instance.output_derivatives(references, orders, |position, found| {
            // SAFETY: not null, and the caller vouches for nvr places, one per reference.
            unsafe { value.add(position).write(found) }
        })
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::GetRealOutputDerivatives, body) }
}
