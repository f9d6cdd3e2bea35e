//! System-dependent part of this module: loading a library.

use crate::fair_lock::FairLock;
use libloading::Library;
use serde::{Deserialize, Serialize};
use std::mem::ManuallyDrop;
use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Options of the dynamic loader for a library. By default, all symbols are looked up when the library is
/// loaded (`RTLD_NOW`). A missing symbol is then an error at load time and does not terminate the process
/// later. The symbols are not available to other libraries (`RTLD_LOCAL`).
///
/// The options do not affect a library that is already loaded, nor the libraries it depends on. The loader
/// identifies these by name: if two have the same name in a process, it uses the first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LoaderOptions {
    /// Symbols of the library and of its dependencies take precedence over symbols of the process
    /// (`RTLD_DEEPBIND` of glibc). Use this for libraries that call one of their functions and get a function
    /// of the host program with the same name instead. Loading fails if the system has no such flag. The
    /// address sanitizer rejects the flag.
    pub deepbind: bool,
    /// Functions are looked up when they are first called (`RTLD_LAZY`). Use this for libraries that lack
    /// functions that are never called. If such a function is called, the process ends.
    pub lazy: bool,
}

/// An open library, used by one thread at a time. It is never closed. A thread that has called the FMU may
/// have thread-specific data (for example, `thread_local` of C++). Their destructor is code of the library
/// and runs when the thread ends.
pub(super) struct Handle {
    library: ManuallyDrop<Library>,
    /// Lock for access to the library.
    pub(super) lock: Arc<FairLock>,
    /// True after a call has returned `Fatal`.
    pub(super) is_fatal: AtomicBool,
    /// True after a component has been created.
    pub(super) is_used: AtomicBool,
}

impl Handle {
    pub(super) fn new(library: Library, lock: Arc<FairLock>) -> Self {
        let library = ManuallyDrop::new(library);
        Self { library, lock, is_fatal: AtomicBool::new(false), is_used: AtomicBool::new(false) }
    }
}

impl Deref for Handle {
    type Target = Library;

    fn deref(&self) -> &Library {
        &self.library
    }
}

/// `RTLD_DEEPBIND` of glibc (`dlfcn.h`), if the system has this flag.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const DEEPBIND: Option<std::ffi::c_int> = Some(8);
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
const DEEPBIND: Option<std::ffi::c_int> = None;

/// Maximum length of a path without the prefix `\\\\?\\` (`MAX_PATH` with its terminating zero is 260).
#[cfg(not(unix))]
const LONGEST_PATH: usize = 259;

/// Checks that the loader supports the options. Otherwise, returns the unsupported option.
pub(super) fn check(options: &LoaderOptions) -> Result<(), &'static str> {
    match options {
        LoaderOptions { deepbind: true, .. } if DEEPBIND.is_none() => Err("deepbind"),
        LoaderOptions { lazy: true, .. } if cfg!(not(unix)) => Err("lazy"),
        _ => Ok(()),
    }
}

/// Opens a shared library without making its symbols available to other libraries.
///
/// # Safety
/// Runs the library's constructors, which is foreign code.
pub(super) unsafe fn open(path: &Path, options: &LoaderOptions) -> Result<Library, libloading::Error> {
    #[cfg(unix)]
    {
        use libloading::os::unix::{self, RTLD_LAZY, RTLD_LOCAL, RTLD_NOW};
        let when = if options.lazy { RTLD_LAZY } else { RTLD_NOW };
        let deep = DEEPBIND.filter(|_| options.deepbind).unwrap_or(0);
        // SAFETY: the caller upholds the requirements of this function.
        unsafe { unix::Library::open(Some(path), when | RTLD_LOCAL | deep) }.map(Library::from)
    }
    #[cfg(not(unix))]
    {
        use libloading::os::windows::{self, LOAD_WITH_ALTERED_SEARCH_PATH};
        let _ = options;
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        // Longer paths need a prefix, with which some libraries cannot find their own files.
        let is_long = path.as_os_str().len() > LONGEST_PATH;
        let path = if is_long { path.canonicalize().unwrap_or(path) } else { path };
        // The libraries that this one needs are searched for in its own folder first.
        // SAFETY: the caller upholds the requirements of this function.
        let library = unsafe { windows::Library::load_with_flags(path, LOAD_WITH_ALTERED_SEARCH_PATH) };
        library.map(Library::from)
    }
}
