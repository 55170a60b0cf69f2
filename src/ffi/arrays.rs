//! C arrays and strings as slices; null is refused by name.

use std::ffi::CStr;

use super::fmi2String;
use crate::fmi::CallError;

/// Slice of a C array; null is allowed where the length is 0.
///
/// # Safety
/// `pointer` is null or points to `length` initialised values that do not change while the slice is in use.
pub(super) unsafe fn slice<'a, T>(name: &str, pointer: *const T, length: usize) -> Result<&'a [T], CallError> {
    if length == 0 {
        return Ok(&[]);
    }
    not_null(name, pointer)?;
    // SAFETY: not null, and the caller vouches for the length.
    Ok(unsafe { std::slice::from_raw_parts(pointer, length) })
}

/// Refuses a null pointer by its name.
pub(super) fn not_null<T>(name: &str, pointer: *const T) -> Result<(), CallError> {
    if pointer.is_null() { Err(CallError::error(format!("{name} is null."))) } else { Ok(()) }
}

/// UTF-8 text of a C string.
///
/// # Safety
/// `pointer` is null or points to a string that ends with a zero byte and does not change while the result is in use.
pub(super) unsafe fn string<'a>(name: &str, pointer: fmi2String) -> Result<&'a str, CallError> {
    not_null(name, pointer)?;
    // SAFETY: not null, and the caller vouches for the end.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| CallError::error(format!("{name} is not UTF-8.")))
}
