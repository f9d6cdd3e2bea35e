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
use crate::platform::check_length;
use std::ffi::CStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

/// An open library and the functions found in it.
pub(crate) struct Library {
    pub(super) functions: Functions,
    pub(super) values: Box<dyn Values>,
    pub(super) version: Box<dyn Version>,
    path: PathBuf,
    /// What may be the cause where a call fails.
    hint: Option<Arc<str>>,
    /// Callbacks of instances that are gone, for the next ones: never freed, for the FMU may still use them,
    /// at last in its destructors.
    retired: Mutex<Vec<Callbacks>>,
    handle: Arc<Handle>,
}

/// Where the functions of a library are found.
#[derive(Clone, Copy)]
pub(crate) enum LoadFrom<'a> {
    /// In a file, which is loaded; who is inside of it has a turn of this lock.
    File(&'a Path, &'a Arc<FairLock>),
    /// In a library that is loaded already, whose file may have gone since.
    Loaded(&'a Library),
}

impl fmt::Debug for Library {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Library({})", self.path.display())
    }
}

impl Library {
    getters! {
        /// The file.
        pub(crate) path(self) -> &Path = &self.path;
        /// What may be the cause where a call fails.
        pub(crate) hint(self) -> Option<&Arc<str>> = self.hint.as_ref();
        /// Who is inside of it has a turn of this.
        #[inline]
        pub(crate) lock(self) -> &Arc<FairLock> = &self.handle.lock;
        /// True if a call has returned `Fatal`: then the state of the loaded file is not reliable any more.
        #[inline]
        pub(crate) is_fatal(self) -> bool = self.handle.is_fatal.load(Ordering::Relaxed);
        /// True if a component was ever made in the loaded file: then its static variables may have been
        /// changed.
        pub(crate) is_used(self) -> bool = self.handle.is_used.load(Ordering::Relaxed);
    }

    /// Loads the library, where it is not loaded already, and looks up the functions of one interface. **This
    /// runs foreign code** (the library's constructors).
    ///
    /// # Errors
    /// The dynamic loader's own message, or the name of the mandatory function that is missing.
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
        // It is asked for its types.
        let _inside = Inside::enter(&handle.lock);
        let dialect = match (version.major, kind) {
            (1, InterfaceKind::ModelExchange) => Dialect::Fmi1,
            (1, InterfaceKind::CoSimulation) => Dialect::Fmi1Slave,
            (2, _) => Dialect::Fmi2,
            _ => Dialect::Fmi3,
        };
        let prefix = (version.major == 1).then_some(model_identifier);
        let symbols = Symbols { handle: &handle, path, prefix, dialect, kind, is_unused: false };
        // SAFETY: the description says that the library follows this version of the standard.
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
            FmiError::BadSetting(format!("the loader of this system has no option {option}"))
        })?;
        check_length(path)?;
        let _inside = Inside::enter(lock);
        // SAFETY: the user asked to run this FMU, and running its constructors is part of that.
        let opened = unsafe { platform::open(path, options) }
            .map_err(|error| FmiError::LoadFailed { library: path.to_owned(), message: message(&error) })?;
        Ok(Arc::new(Handle::new(opened, Arc::clone(lock))))
    }

    /// The version of FMI that it says it follows, where it has the function for that.
    pub(crate) fn version_text(&self) -> Option<String> {
        text_of(&self.functions.get_version)
    }

    pub(super) fn set_fatal(&self) {
        self.handle.is_fatal.store(true, Ordering::Relaxed);
    }

    pub(super) fn set_used(&self) {
        self.handle.is_used.store(true, Ordering::Relaxed);
    }

    /// Callbacks for a new instance.
    pub(super) fn callbacks(&self, filter: LogFilter) -> Callbacks {
        let retired = self.retired.lock().unwrap_or_else(PoisonError::into_inner).pop();
        retired.inspect(|known| known.renew(filter)).unwrap_or_else(|| Callbacks::new(filter))
    }

    /// Takes the callbacks of an instance that is gone.
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

/// Refuses a library whose types are those of another platform than that of the standard's headers (FMI 1.0
/// and 2.0): the calls would pass other types than it takes.
fn check_types(functions: &Functions, path: &Path) -> Result<()> {
    match text_of(&functions.get_types_platform) {
        Some(platform) if !["standard32", "default", ""].contains(&platform.as_str()) => {
            let message = format!(
                "its types are those of the platform \"{}\"; known are those of the standard's headers \
                                   (standard32, default)",
                platform.escape_debug()
            );
            Err(FmiError::LoadFailed { library: path.to_owned(), message })
        }
        _ => Ok(()),
    }
}

/// Text returned by a function without arguments; `None` without the function.
fn text_of(function: &Function<Text>) -> Option<String> {
    // SAFETY: such functions of the standard may be called at any time, and answer with a text that ends in NUL and stays.
    unsafe {
        let text = (function.pointer?)();
        (!text.is_null()).then(|| CStr::from_ptr(text).to_string_lossy().into_owned())
    }
}

/// The loader's message as the system gives it.
fn message(error: &libloading::Error) -> String {
    match std::error::Error::source(error) {
        Some(source) => source.to_string(),
        None => error.to_string(),
    }
}
