//! Stored states (FMI 2.0.4, section 2.1.8): an fmi2FMUstate points to a [`Snapshot`], which is independent of the instances.

use std::ptr::null_mut;

use super::function::functions;
use super::types::{fmi2Byte, fmi2FMUstate, size_t};
use crate::fmi::{CallError, Snapshot};

/// The snapshot behind a stored state; null is refused.
///
/// # Safety
/// The contract of [`crate::ffi`]: `state` is null or comes from this library and has not been freed.
unsafe fn stored<'a>(state: fmi2FMUstate) -> Result<&'a Snapshot, CallError> {
    // SAFETY: the caller vouches for the pointer unless it is null.
    unsafe { state.cast::<Snapshot>().as_ref() }.ok_or_else(|| CallError::error("FMUstate is null."))
}

/// Copies a snapshot to `state`: to a new state if `state` is null, otherwise over the old state.
///
/// # Safety
/// The contract of [`crate::ffi`]: `state` is null or comes from this library and has not been freed.
unsafe fn store(state: &mut fmi2FMUstate, snapshot: &Snapshot) {
    // SAFETY: the caller vouches for the pointer unless it is null.
    match unsafe { state.cast::<Snapshot>().as_mut() } {
        Some(old) => old.clone_from(snapshot),
        None => *state = Box::into_raw(Box::new(snapshot.clone())).cast(),
    }
}

functions! {
    /// Stores the state of the instance without its log. If `*FMUstate` is null a new state is created, otherwise the old state is
    /// overwritten.
    fmi2GetFMUstate(FMUstate: [out fmi2FMUstate]) |instance| {
        // SAFETY: the caller has initialised the place, and vouches for the state.
        unsafe { store(FMUstate.assume_init_mut(), instance.snapshot()) };
    };
    /// Restores a state that any instance of this FMU has stored for the same kind of simulation, co-simulation or model exchange.
    fmi2SetFMUstate(FMUstate: fmi2FMUstate) |instance| {
        // SAFETY: the caller vouches for the state.
        instance.restore(unsafe { stored(FMUstate) }?)?;
    };
    /// Frees a stored state and sets the pointer to null. A null state or a null pointer to it is allowed.
    fmi2FreeFMUstate(FMUstate: [raw *mut fmi2FMUstate]) |_instance| {
        // SAFETY: the caller vouches for the place unless it is null.
        if let Some(state) = unsafe { FMUstate.as_mut() }
            && !state.is_null()
        {
            // SAFETY: the caller vouches that the state comes from `store`, which leaked a box, and is not used again.
            drop(unsafe { Box::from_raw(state.cast::<Snapshot>()) });
            *state = null_mut();
        }
    };
    /// Returns the number of bytes of the serialised state.
    fmi2SerializedFMUstateSize(FMUstate: fmi2FMUstate, size: [out size_t]) |_instance| {
        // SAFETY: the caller vouches for the state.
        size.write(unsafe { stored(FMUstate) }?.to_bytes()?.len());
    };
    /// Writes the state as bytes. `size` must be at least the number from fmi2SerializedFMUstateSize.
    fmi2SerializeFMUstate(FMUstate: fmi2FMUstate, serializedState: [out fmi2Byte; size], size: size_t) |_instance| {
        // SAFETY: the caller vouches for the state.
        let bytes = unsafe { stored(FMUstate) }?.to_bytes()?;
        let Some(places) = serializedState.get_mut(..bytes.len()) else {
            return Err(CallError::error(format!("size is {size}, must be at least {}.", bytes.len())));
        };
        places.write_copy_of_slice(&bytes);
    };
    /// Creates a state from bytes: a new state if `*FMUstate` is null, otherwise over the old state. Bytes that are not a state of this FMU
    /// are refused and change nothing.
    fmi2DeSerializeFMUstate(serializedState: [in fmi2Byte; size], size: size_t, FMUstate: [out fmi2FMUstate]) |instance| {
        let snapshot = instance.deserialize(serializedState)?;
        // SAFETY: the caller has initialised the place, and vouches for the state.
        unsafe { store(FMUstate.assume_init_mut(), &snapshot) };
    };
}
