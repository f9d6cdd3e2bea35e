//! Symbols of a library, looked up while its tables are being made.

use super::platform::Handle;
use crate::error::FmiError;
use std::path::Path;

/// Looks symbols up in a library while its tables are being made.
pub(super) struct Symbols<'a> {
    pub(super) handle: &'a Handle,
    pub(super) path: &'a Path,
    /// Before the names, up to an underscore.
    pub(super) prefix: Option<&'a str>,
}

impl<'a> Symbols<'a> {
    /// The same library with a prefix before the names; where a name does not have it, as some tools export it, the plain
    /// one is taken.
    pub(super) fn with_prefix(&self, prefix: &'a str) -> Self {
        Self { handle: self.handle, path: self.path, prefix: Some(prefix) }
    }

    /// A function that must be there.
    ///
    /// # Safety
    /// `T` is a function pointer type that fits the symbol, and is not called after the library is closed.
    pub(super) unsafe fn required<T: Copy>(&self, name: &'static str) -> Result<T, FmiError> {
        // SAFETY: handed on to the caller.
        unsafe { self.optional(name) }
            .ok_or_else(|| FmiError::MissingSymbol { library: self.path.to_owned(), symbol: name })
    }

    /// A function that may be missing.
    ///
    /// # Safety
    /// As for [`required`](Self::required).
    pub(super) unsafe fn optional<T: Copy>(&self, name: &str) -> Option<T> {
        // SAFETY: handed on to the caller.
        let find = |name: &str| unsafe { self.handle.get::<T>(name) }.ok().map(|symbol| *symbol);
        let prefixed = self.prefix.and_then(|prefix| find(&format!("{prefix}_{name}")));
        prefixed.or_else(|| find(name))
    }
}
