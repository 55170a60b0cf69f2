//! Path of the file that contains this library. It reveals where the archive was unpacked.

use std::path::PathBuf;

/// Path of the library, found by the address of one of its functions; `None` if the system does not know it.
#[cfg(unix)]
pub(super) fn path() -> Option<PathBuf> {
    use std::ffi::{CStr, OsStr};
    use std::mem::MaybeUninit;
    use std::os::unix::ffi::OsStrExt;

    let mut found = MaybeUninit::<libc::Dl_info>::zeroed();
    // SAFETY: the pointer leads to a place for the answer; for an address that belongs to no file the answer is 0.
    let known = unsafe { libc::dladdr((path as fn() -> _ as *const ()).cast(), found.as_mut_ptr()) } != 0;
    // SAFETY: all zeros are a value of the type, and dladdr writes only valid values.
    let name = unsafe { found.assume_init() }.dli_fname;
    if !known || name.is_null() {
        return None;
    }
    // SAFETY: the loader keeps the name while the library is loaded, and the library is running this code.
    let name = unsafe { CStr::from_ptr(name) };
    Some(OsStr::from_bytes(name.to_bytes()).into())
}

/// Path of the library, found by the address of one of its functions; `None` if the system does not know it.
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
    // Longest path of Windows, in UTF-16 units.
    let mut name = vec![0; 32_768];
    let mut module = null_mut();
    let address = (path as fn() -> _ as *const ()).cast();
    // SAFETY: the address lies in this library, and the pointer leads to a place for a handle.
    if unsafe { GetModuleHandleExW(BY_ADDRESS, address, &mut module) } == 0 {
        return None;
    }
    // SAFETY: the handle belongs to this library, which is loaded, and the buffer has the length that is passed.
    let length = unsafe { GetModuleFileNameW(module, name.as_mut_ptr(), name.len() as u32) } as usize;
    (1..name.len()).contains(&length).then(|| OsString::from_wide(&name[..length]).into())
}

/// None: a browser has no files.
#[cfg(not(any(unix, windows)))]
pub(super) fn path() -> Option<PathBuf> {
    None
}
