//! Stored states (FMI 2.0.4, section 2.1.8): an fmi2FMUstate points to a [`Snapshot`], which belongs to no instance.

use std::ptr::null_mut;

use super::c_types::size_t;

use super::arrays::{not_null, slice};
use super::guard::guard;
use super::types::{fmi2Byte, fmi2Component, fmi2FMUstate, fmi2Status};
use crate::fmi::{Call, CallError, Instance, Snapshot};

/// The snapshot behind a stored state; null is refused.
///
/// # Safety
/// The contract of [`crate::ffi`]: `state` is null or comes from this library and has not been freed.
unsafe fn stored<'a>(state: fmi2FMUstate) -> Result<&'a Snapshot, CallError> {
    // SAFETY: the caller vouches for the pointer unless it is null.
    unsafe { state.cast::<Snapshot>().as_ref() }.ok_or_else(|| CallError::error("FMUstate is null."))
}

/// Copies a snapshot to `*state`: into a new one where `*state` is null, otherwise over the old one.
///
/// # Safety
/// `state` is not null, and `*state` is null or comes from this library and has not been freed.
unsafe fn store(state: *mut fmi2FMUstate, snapshot: &Snapshot) {
    // SAFETY: the caller vouches for both pointers.
    unsafe {
        match state.read().cast::<Snapshot>().as_mut() {
            Some(old) => old.copy(snapshot),
            None => state.write(Box::into_raw(Box::new(snapshot.clone())).cast()),
        }
    }
}

/// Stores the state of the instance without its log; where `*FMUstate` is null a new state is made, otherwise it is overwritten.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetFMUstate(c: fmi2Component, FMUstate: *mut fmi2FMUstate) -> fmi2Status {
    let body = |instance: &mut Instance| {
        not_null("FMUstate", FMUstate)?;
        // SAFETY: not null, and the caller vouches for the rest.
        unsafe { store(FMUstate, instance.snapshot()) };
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::GetFMUstate, body) }
}

/// Restores a stored state, made by any instance of this FMU.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetFMUstate(c: fmi2Component, FMUstate: fmi2FMUstate) -> fmi2Status {
    // SAFETY: the caller vouches for the state.
    let body = |instance: &mut Instance| unsafe { stored(FMUstate) }.and_then(|snapshot| instance.restore(snapshot));
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SetFMUstate, body) }
}

/// Frees a stored state and sets the pointer to null; a null state or a null pointer to it is allowed.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeFMUstate(c: fmi2Component, FMUstate: *mut fmi2FMUstate) -> fmi2Status {
    let body = |_: &mut Instance| {
        // SAFETY: the caller vouches for the place unless it is null.
        if let Some(state) = unsafe { FMUstate.as_mut() }
            && !state.is_null()
        {
            // SAFETY: the caller vouches that it comes from `store`, which leaked a box, and is not used again.
            drop(unsafe { Box::from_raw(state.cast::<Snapshot>()) });
            *state = null_mut();
        }
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::FreeFMUstate, body) }
}

/// Number of bytes that the state takes.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializedFMUstateSize(c: fmi2Component, FMUstate: fmi2FMUstate, size: *mut size_t) -> fmi2Status {
    let body = |_: &mut Instance| {
        not_null("size", size)?;
        // SAFETY: the caller vouches for the state.
        let bytes = unsafe { stored(FMUstate) }?.to_bytes()?;
        // SAFETY: not null, and the caller vouches for the place.
        unsafe { size.write(bytes.len()) };
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SerializedFMUstateSize, body) }
}

/// Writes the state as bytes; `size` must be at least the number from fmi2SerializedFMUstateSize.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializeFMUstate(
    c: fmi2Component,
    FMUstate: fmi2FMUstate,
    serializedState: *mut fmi2Byte,
    size: size_t,
) -> fmi2Status {
    let body = |_: &mut Instance| {
        not_null("serializedState", serializedState)?;
        // SAFETY: the caller vouches for the state.
        let bytes = unsafe { stored(FMUstate) }?.to_bytes()?;
        if size < bytes.len() {
            return Err(CallError::error(format!("size is {size}, must be at least {}.", bytes.len())));
        }
        // SAFETY: not null, and the caller vouches for `size` places, which are enough; our own bytes do not overlap them.
        unsafe { serializedState.copy_from_nonoverlapping(bytes.as_ptr().cast(), bytes.len()) };
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::SerializeFMUstate, body) }
}

/// Makes a state from bytes: where `*FMUstate` is null a new one, otherwise over the old one. Bytes that are not a state of this FMU are
/// refused and change nothing.
///
/// # Safety
/// See the contract of [`crate::ffi`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DeSerializeFMUstate(
    c: fmi2Component,
    serializedState: *const fmi2Byte,
    size: size_t,
    FMUstate: *mut fmi2FMUstate,
) -> fmi2Status {
    let body = |_: &mut Instance| {
        not_null("FMUstate", FMUstate)?;
        // SAFETY: the caller vouches for the array; a byte is a byte, with or without a sign.
        let bytes = unsafe { slice("serializedState", serializedState.cast::<u8>(), size) }?;
        let snapshot = Snapshot::from_bytes(bytes)?;
        // SAFETY: not null, and the caller vouches for the rest.
        unsafe { store(FMUstate, &snapshot) };
        Ok(())
    };
    // SAFETY: the caller vouches for the component.
    unsafe { guard(c, Call::DeSerializeFMUstate, body) }
}
