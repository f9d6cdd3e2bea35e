//! A loaded shared library of an FMU with its function table.

use super::callbacks::Callbacks;
use super::environment::Inside;
use super::fmi1_fmi2_values::ScalarValues;
use super::function::Function;
use super::functions::{Functions, Text};
use super::platform::{self, Handle, LoaderOptions};
use super::symbols::{Dialect, Symbols};
use super::types::InterfaceKind;
use super::versioned_functions::{Values, Version};
use super::{fmi1, fmi2, fmi3};
use crate::description::FmiVersion;
use crate::error::{FmiError, Result};
use crate::fair_lock::FairLock;
use crate::log::LogFilter;
use crate::macros::getters;
use crate::platform::{check_length, missing_libraries};
use std::ffi::CStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

/// An open library and its functions.
pub(crate) struct Library {
    pub(super) functions: Functions,
    pub(super) values: Box<dyn Values>,
    pub(super) version: Box<dyn Version>,
    path: PathBuf,
    /// Possible cause of a failed call.
    hint: Option<Arc<str>>,
    /// Callbacks of freed instances, to be reused by new ones. They are never freed, because the FMU may
    /// still use them, even in its destructors.
    retired: Mutex<Vec<Callbacks>>,
    handle: Arc<Handle>,
}

/// Source of the functions of a library.
#[derive(Clone, Copy)]
pub(crate) enum LoadFrom<'a> {
    /// A file to be loaded. Threads that use it hold this lock.
    File(&'a Path, &'a Arc<FairLock>),
    /// A library that is already loaded. Its file may have been removed since.
    Loaded(&'a Library),
}

impl fmt::Debug for Library {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Library({})", self.path.display())
    }
}

impl Library {
    getters! {
        /// Returns the path of the file.
        pub(crate) path(self) -> &Path = &self.path;
        /// Returns a possible cause of a failed call.
        pub(crate) hint(self) -> Option<&Arc<str>> = self.hint.as_ref();
        /// Returns the lock that a thread must hold to use the library.
        #[inline]
        pub(crate) lock(self) -> &Arc<FairLock> = &self.handle.lock;
        /// True if a call has returned `Fatal`. The state of the loaded file is then unreliable.
        #[inline]
        pub(crate) is_fatal(self) -> bool = self.handle.is_fatal.load(Ordering::Relaxed);
        /// True if a component was ever created in the loaded file. Its static variables may then have
        /// changed.
        pub(crate) is_used(self) -> bool = self.handle.is_used.load(Ordering::Relaxed);
    }

    /// Loads the library, unless it is already loaded, and looks up the functions of one interface. **This
    /// runs foreign code** (the library's constructors).
    ///
    /// # Errors
    /// Returns the message of the dynamic loader, or the name of a mandatory function that is missing.
    pub(crate) fn open(
        from: LoadFrom<'_>,
        version: &FmiVersion,
        kind: InterfaceKind,
        model_identifier: &str,
        options: &LoaderOptions,
        hint: Option<&str>,
    ) -> Result<Self> {
        let (handle, path) = match from {
            LoadFrom::Loaded(library) => (Arc::clone(&library.handle), &*library.path),
            LoadFrom::File(path, lock) => (Self::load(path, lock, options)?, path),
        };
        // The lock is needed because `check_types` calls a function of the library.
        let _inside = Inside::enter(&handle.lock);
        let dialect = match (version.major, kind) {
            (1, InterfaceKind::ModelExchange) => Dialect::Fmi1,
            (1, InterfaceKind::CoSimulation) => Dialect::Fmi1Slave,
            (2, _) => Dialect::Fmi2,
            _ => Dialect::Fmi3,
        };
        let prefix = (version.major == 1).then_some(model_identifier);
        let symbols = Symbols { handle: &handle, path, prefix, dialect, kind, is_unused: false };
        // SAFETY: the description declares that the library follows this version of the standard.
        unsafe {
            let (version, values): (Box<dyn Version>, Box<dyn Values>) = match dialect {
                Dialect::Fmi1 | Dialect::Fmi1Slave => (
                    Box::new(fmi1::Fmi1::load(&symbols)?),
                    Box::new(ScalarValues::<fmi1::Boolean>::load(&symbols)?),
                ),
                Dialect::Fmi2 => (
                    Box::new(fmi2::Fmi2::load(&symbols)?),
                    Box::new(ScalarValues::<fmi2::Boolean>::load(&symbols)?),
                ),
                Dialect::Fmi3 => {
                    (Box::new(fmi3::Fmi3::load(&symbols)?), Box::new(fmi3::Fmi3Values::load(&symbols)?))
                }
            };
            let functions = Functions::load(&symbols)?;
            check_types(&functions, path)?;
            let (path, retired) = (path.to_owned(), Mutex::default());
            Ok(Self { functions, values, version, path, hint: hint.map(Arc::from), retired, handle })
        }
    }

    fn load(path: &Path, lock: &Arc<FairLock>, options: &LoaderOptions) -> Result<Arc<Handle>> {
        platform::check(options).map_err(|option| {
            FmiError::BadSetting(format!("the loader of this system does not support the option {option}"))
        })?;
        check_length(path)?;
        let _inside = Inside::enter(lock);
        // SAFETY: the user asked to run this FMU, which includes running its constructors.
        let opened = unsafe { platform::open(path, options) }.map_err(|error| FmiError::LoadFailed {
            library: path.to_owned(),
            message: message(&error, path),
        })?;
        Ok(Arc::new(Handle::new(opened, Arc::clone(lock))))
    }

    /// Returns the FMI version that the library reports, if it has the function for it.
    pub(crate) fn version_text(&self) -> Option<String> {
        text_of(&self.functions.get_version)
    }

    pub(super) fn set_fatal(&self) {
        self.handle.is_fatal.store(true, Ordering::Relaxed);
    }

    pub(super) fn set_used(&self) {
        self.handle.is_used.store(true, Ordering::Relaxed);
    }

    /// Returns callbacks for a new instance.
    pub(super) fn callbacks(&self, filter: LogFilter) -> Callbacks {
        let retired = self.retired.lock().unwrap_or_else(PoisonError::into_inner).pop();
        retired.inspect(|callbacks| callbacks.renew(filter)).unwrap_or_else(|| Callbacks::new(filter))
    }

    /// Accepts the callbacks of a freed instance for reuse.
    pub(super) fn retire(&self, callbacks: Callbacks) {
        self.retired.lock().unwrap_or_else(PoisonError::into_inner).push(callbacks);
    }
}

impl Drop for Library {
    fn drop(&mut self) {
        let retired = self.retired.get_mut().unwrap_or_else(PoisonError::into_inner);
        retired.drain(..).for_each(Callbacks::abandon);
    }
}

/// Rejects a library whose types do not match the standard's headers (FMI 1.0 and 2.0). Calls would pass
/// arguments of the wrong types.
fn check_types(functions: &Functions, path: &Path) -> Result<()> {
    match text_of(&functions.get_types_platform) {
        Some(platform) if !["standard32", "default", ""].contains(&platform.as_str()) => {
            let message = format!(
                "its types platform \"{}\" is not supported; expected one of: standard32, default",
                platform.escape_debug()
            );
            Err(FmiError::LoadFailed { library: path.to_owned(), message })
        }
        _ => Ok(()),
    }
}

/// Returns the string of a function without arguments; `None` if the library lacks the function.
fn text_of(function: &Function<Text>) -> Option<String> {
    // SAFETY: the standard allows calling such functions at any time. They return a NUL-terminated string
    // that stays valid.
    unsafe {
        let text = (function.pointer?)();
        (!text.is_null()).then(|| CStr::from_ptr(text).to_string_lossy().into_owned())
    }
}

/// Returns the message of the loader as reported by the system, with the libraries that are missing if the
/// system does not name them.
fn message(error: &libloading::Error, library: &Path) -> String {
    let message = match std::error::Error::source(error) {
        Some(source) => source.to_string(),
        None => error.to_string(),
    };
    match &missing_libraries(library)[..] {
        [] => message,
        missing => format!("{message}; not found: {}", missing.join(", ")),
    }
}
