//! C's types: those of the crate libc; on WebAssembly, for which libc has none, those of `core::ffi`.

#[cfg(target_family = "wasm")]
pub(super) use core::ffi::{c_char, c_int, c_uint, c_void};

#[cfg(not(target_family = "wasm"))]
pub(super) use libc::{c_char, c_int, c_uint, c_void, size_t};

/// Length of an array.
#[cfg(target_family = "wasm")]
pub(super) type size_t = usize;
