//! System-dependent part of this module: the loading of a library.

use crate::fair_lock::FairLock;
use serde::{Deserialize, Serialize};
use std::mem::ManuallyDrop;
use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Options of the dynamic loader for a library. By default all its symbols are looked up when it is loaded,
/// so that a missing one is an error then and not the end of the process later (`RTLD_NOW`), and none of them
/// are offered to other libraries (`RTLD_LOCAL`). A library that is loaded already stays as it is; that holds
/// for the libraries it depends on too, which the loader identifies by their names: of two with one name in a
/// process it takes the first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LoaderOptions {
    /// Symbols of the library and what it depends on come before those of the process (`RTLD_DEEPBIND` of
    /// glibc): for libraries that call a function of their own and get one of the same name of the host
    /// program instead. An error where the system has no such flag. Not together with the address sanitizer,
    /// which refuses it.
    pub deepbind: bool,
    /// Functions are looked up when they are first called (`RTLD_LAZY`): for libraries that lack some which
    /// are never called. If one is called, the process ends.
    pub lazy: bool,
}

#[cfg(unix)]
pub(super) type Opened = libloading::os::unix::Library;
#[cfg(not(unix))]
pub(super) type Opened = libloading::Library;

/// An open library, which one thread at a time is inside of. It is never closed: a thread that has called the
/// FMU may hold data of its own for it (thread-specific data, `thread_local` of C++) whose destructor is code
/// of the library and runs when the thread ends.
pub(super) struct Handle {
    library: ManuallyDrop<Opened>,
    /// Who may be inside.
    pub(super) lock: Arc<FairLock>,
    /// A call returned `Fatal`.
    pub(super) is_fatal: AtomicBool,
    /// A component was made.
    pub(super) is_used: AtomicBool,
}

impl Handle {
    pub(super) fn new(library: Opened, lock: Arc<FairLock>) -> Self {
        let library = ManuallyDrop::new(library);
        Self { library, lock, is_fatal: AtomicBool::new(false), is_used: AtomicBool::new(false) }
    }
}

impl Deref for Handle {
    type Target = Opened;

    fn deref(&self) -> &Opened {
        &self.library
    }
}

/// `RTLD_DEEPBIND` of glibc (`dlfcn.h`), where there is such a flag.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const DEEPBIND: Option<std::ffi::c_int> = Some(8);
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
const DEEPBIND: Option<std::ffi::c_int> = None;

/// Checks that the loader supports the options; else returns the one that it does not have.
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
pub(super) unsafe fn open(path: &Path, options: &LoaderOptions) -> Result<Opened, libloading::Error> {
    use libloading::os::unix::{RTLD_LAZY, RTLD_LOCAL, RTLD_NOW};
    let when = if options.lazy { RTLD_LAZY } else { RTLD_NOW };
    let deep = DEEPBIND.filter(|_| options.deepbind).unwrap_or(0);
    // SAFETY: handed on to the caller.
    unsafe { Opened::open(Some(path), when | RTLD_LOCAL | deep) }
}

/// Opens a shared library.
///
/// # Safety
/// Runs the library's constructors, which is foreign code.
#[cfg(not(unix))]
pub(super) unsafe fn open(path: &Path, _: &LoaderOptions) -> Result<Opened, libloading::Error> {
    // SAFETY: handed on to the caller.
    unsafe { Opened::new(path) }
}
