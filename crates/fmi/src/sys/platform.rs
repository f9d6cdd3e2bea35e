//! What differs between systems in this module: how a library is opened.

use crate::open_options::LoaderOptions;
use std::path::Path;

/// Never closed: a thread that has called the FMU may hold data of its own for it (thread-specific data, `thread_local`
/// of C++) whose destructor is code of the library and runs when the thread ends. An open library also keeps its file's
/// place on the disk from being given to another file, for which the loader would take that one's code.
#[cfg(unix)]
pub(super) type Handle = std::mem::ManuallyDrop<libloading::os::unix::Library>;
#[cfg(not(unix))]
pub(super) type Handle = libloading::Library;

/// `RTLD_DEEPBIND` of glibc (`dlfcn.h`), where there is such a flag.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const DEEPBIND: Option<std::ffi::c_int> = Some(8);
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
const DEEPBIND: Option<std::ffi::c_int> = None;

/// Whether the loader can do what is asked of it; else the option that it does not have.
pub(super) fn check(options: &LoaderOptions) -> Result<(), &'static str> {
    match options {
        LoaderOptions { deepbind: true, .. } if DEEPBIND.is_none() => Err("deepbind"),
        LoaderOptions { lazy: true, .. } if cfg!(not(unix)) => Err("lazy"),
        _ => Ok(()),
    }
}

/// Opens a shared library and offers none of its symbols to other libraries.
///
/// # Safety
/// Runs the library's constructors, which is foreign code.
#[cfg(unix)]
pub(super) unsafe fn open(path: &Path, options: &LoaderOptions) -> Result<Handle, libloading::Error> {
    use libloading::os::unix::{RTLD_LAZY, RTLD_LOCAL, RTLD_NOW};
    let when = if options.lazy { RTLD_LAZY } else { RTLD_NOW };
    let deep = DEEPBIND.filter(|_| options.deepbind).unwrap_or(0);
    // SAFETY: handed on to the caller.
    unsafe { libloading::os::unix::Library::open(Some(path), when | RTLD_LOCAL | deep) }
        .map(std::mem::ManuallyDrop::new)
}

/// Opens a shared library.
///
/// # Safety
/// Runs the library's constructors, which is foreign code.
#[cfg(not(unix))]
pub(super) unsafe fn open(path: &Path, _: &LoaderOptions) -> Result<Handle, libloading::Error> {
    // SAFETY: handed on to the caller.
    unsafe { Handle::new(path) }
}
