//! Path of the file that this library was loaded from, which tells where its archive was unpacked.

use std::path::PathBuf;

/// The path, where the system knows it: by the address of a function in this library.
#[cfg(unix)]
pub(super) fn path() -> Option<PathBuf> {
    use std::ffi::{CStr, OsStr};
    use std::mem::MaybeUninit;
    use std::os::unix::ffi::OsStrExt;

    let mut found = MaybeUninit::<libc::Dl_info>::zeroed();
    // SAFETY: the place is one for the answer; an address that belongs to no file is answered by 0.
    let known = unsafe { libc::dladdr((path as fn() -> _ as *const ()).cast(), found.as_mut_ptr()) } != 0;
    // SAFETY: all zeros are a value of the type, and dladdr writes nothing else than values.
    let name = unsafe { found.assume_init() }.dli_fname;
    if !known || name.is_null() {
        return None;
    }
    // SAFETY: the loader keeps the name as long as the library is loaded, which runs this code.
    let name = unsafe { CStr::from_ptr(name) };
    Some(OsStr::from_bytes(name.to_bytes()).into())
}

/// The path, where the system knows it: by the address of a function in this library.
#[cfg(windows)]
pub(super) fn path() -> Option<PathBuf> {
    use std::ffi::{OsString, c_void};
    use std::os::windows::ffi::OsStringExt;
    use std::ptr::null_mut;

    #[link(name = "kernel32")]
    unsafe extern "system" {
        fn GetModuleHandleExW(flags: u32, address: *const c_void, module: *mut *mut c_void) -> i32;
        fn GetModuleFileNameW(module: *mut c_void, name: *mut u16, size: u32) -> u32;
    }
    // GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS and _UNCHANGED_REFCOUNT.
    const BY_ADDRESS: u32 = 0x4 | 0x2;
    // Longest path of Windows, in units of UTF-16.
    let mut name = vec![0; 32_768];
    let mut module = null_mut();
    let address = (path as fn() -> _ as *const ()).cast();
    // SAFETY: the address lies in this library, and the place is one for a handle.
    if unsafe { GetModuleHandleExW(BY_ADDRESS, address, &mut module) } == 0 {
        return None;
    }
    // SAFETY: the handle is that of this library, which is loaded, and the buffer has the length that is passed along.
    let length = unsafe { GetModuleFileNameW(module, name.as_mut_ptr(), name.len() as u32) } as usize;
    (1..name.len()).contains(&length).then(|| OsString::from_wide(&name[..length]).into())
}

/// None: a browser has no files.
#[cfg(not(any(unix, windows)))]
pub(super) fn path() -> Option<PathBuf> {
    None
}
