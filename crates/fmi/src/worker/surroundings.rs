//! The working folder and the environment variables that a worker takes from its caller.

use serde::{Deserialize, Serialize};
use std::ffi::OsString;

/// The working folder and the environment variables of a process.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Surroundings {
    /// Working folder; `None` if it has been removed.
    pub(super) folder: Option<OsString>,
    pub(super) variables: Vec<(OsString, OsString)>,
}

impl Surroundings {
    /// Returns the current working folder and environment variables of this process.
    pub(super) fn present() -> Self {
        let folder = std::env::current_dir().ok().map(Into::into);
        Self { folder, variables: std::env::vars_os().collect() }
    }
}
