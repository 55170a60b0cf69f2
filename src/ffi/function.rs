//! The common form of a C function: it checks its arguments, then runs its body on the instance behind the [guard](super::guard).
//!
//! | argument | C type | value in the body |
//! | --- | --- | --- |
//! | `T` | `T` | unchanged |
//! | `[in T; n]` | `*const T` | `&[T]` of length `n`; null is allowed if `n` is 0 |
//! | `[out T; n]` | `*mut T` | `&mut [MaybeUninit<T>]` of length `n`; null is allowed if `n` is 0 |
//! | `[out T; n = N]` | `*mut T` | `&mut [MaybeUninit<T>]`; `n` must be `N` |
//! | `[out T]` | `*mut T` | `&mut MaybeUninit<T>` |
//! | `[raw *mut T]` | `*mut T` | unchanged and unchecked |

use std::ffi::CStr;
use std::mem::MaybeUninit;

use super::fmi2String;
use crate::fmi::CallError;

/// Defines C functions that take an instance, with arguments as in the table above. A body acts on the instance; it refuses with `?`.
macro_rules! functions {
    ($($(#[doc = $doc:literal])+ $name:ident($($argument:ident: $kind:tt),*) |$instance:ident| $body:expr;)+) => {$(
        $(#[doc = $doc])+
        ///
        /// # Safety
        /// See the contract of [`crate::ffi`].
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(
            c: $crate::ffi::fmi2Component,
            $($argument: functions!(@type $kind)),*
        ) -> $crate::ffi::fmi2Status {
            let body = |$instance: &mut $crate::fmi::Instance| -> Result<(), $crate::fmi::CallError> {
                $(functions!(@check $argument $kind);)*
                $body;
                Ok(())
            };
            // SAFETY: the caller vouches for the component.
            unsafe { $crate::ffi::guard::guard(c, $crate::fmi::Call::$name, body) }
        }
    )+};
    (@type [in $of:ty; $length:ident]) => { *const $of };
    (@type [out $of:ty; $length:ident $(= $exactly:expr)?]) => { *mut $of };
    (@type [out $of:ty]) => { *mut $of };
    (@type [raw $of:ty]) => { $of };
    (@type $of:ty) => { $of };
    (@check $name:ident [in $of:ty; $length:ident]) => {
        // SAFETY: the caller vouches for the array.
        let $name = unsafe { $crate::ffi::function::slice(stringify!($name), $name, $length) }?;
    };
    (@check $name:ident [out $of:ty; $length:ident $(= $exactly:expr)?]) => {
        $($crate::ffi::function::exactly(stringify!($length), $length, $exactly)?;)?
        // SAFETY: the caller vouches for the array.
        let $name = unsafe { $crate::ffi::function::places(stringify!($name), $name, $length) }?;
    };
    (@check $name:ident [out $of:ty]) => {
        // SAFETY: the caller vouches for the place.
        let $name = unsafe { $crate::ffi::function::place(stringify!($name), $name) }?;
    };
    (@check $name:ident $kind:tt) => {};
}

pub(super) use functions;

/// Slice of a C array; null is allowed if the length is 0.
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

/// Writable places of a C array; null is allowed if the length is 0.
///
/// # Safety
/// `pointer` is null or points to `length` places that are not used elsewhere while the slice is in use.
pub(super) unsafe fn places<'a, T>(name: &str, pointer: *mut T, length: usize) -> Result<&'a mut [MaybeUninit<T>], CallError> {
    if length == 0 {
        return Ok(&mut []);
    }
    not_null(name, pointer)?;
    // SAFETY: not null, and the caller vouches for the length.
    Ok(unsafe { std::slice::from_raw_parts_mut(pointer.cast(), length) })
}

/// Writable place of one value.
///
/// # Safety
/// `pointer` is null or points to a place that is not used elsewhere while the reference is in use.
pub(super) unsafe fn place<'a, T>(name: &str, pointer: *mut T) -> Result<&'a mut MaybeUninit<T>, CallError> {
    // SAFETY: the caller vouches for the pointer unless it is null.
    unsafe { pointer.cast::<MaybeUninit<T>>().as_mut() }.ok_or_else(|| null(name))
}

/// Refuses an array with a length other than `wanted`.
pub(super) fn exactly(name: &str, length: usize, wanted: usize) -> Result<(), CallError> {
    if length == wanted { Ok(()) } else { Err(CallError::error(format!("{name} is {length}, must be {wanted}."))) }
}

/// Refuses a null pointer; the error gives its name.
pub(super) fn not_null<T>(name: &str, pointer: *const T) -> Result<(), CallError> {
    if pointer.is_null() { Err(null(name)) } else { Ok(()) }
}

#[cold]
fn null(name: &str) -> CallError {
    CallError::error(format!("{name} is null."))
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
