//! Who asks for a loaded copy, and can be asked to give it up.

use crate::error::FmiError;
use crate::simulation::Sharing;
use crate::sys::{InterfaceKind, Library, LoadFrom};
use std::sync::Weak;

/// An owner that can be asked to give its copy up between two of its calls.
pub(crate) trait Tenant: Send + Sync {
    /// Gives the copy up, if no call is under way.
    fn evict(&self) -> Eviction;

    /// Whether nothing is lost when it does: it is a simulator that lies in a pool.
    fn is_dormant(&self) -> bool;
}

/// What became of a request to give a copy up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Eviction {
    /// It was given up, or is just being given up.
    Done,
    /// A simulation is under way; it will end.
    Busy,
    /// The owner keeps it, and waiting for that would be in vain: it is this very thread, or an instance made by hand.
    Kept,
}

/// Who wants a copy, and how.
pub(crate) struct CopyRequest<'a> {
    pub(crate) kind: InterfaceKind,
    pub(crate) sharing: Sharing,
    /// `None`: the owner does not give it up.
    pub(crate) tenant: Option<Weak<dyn Tenant>>,
    /// Loads the library.
    pub(crate) open: &'a dyn Fn(LoadFrom<'_>) -> Result<Library, FmiError>,
}
