//! The working folder and the environment variables of a worker, which are those of its caller.

use super::handshake::{FOLDER, TEMPORARY};
use crate::sys::{overwrite_variable, replace_environment};
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// The working folder and the environment variables of a process.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Surroundings {
    /// Working folder; `None` if it has been removed.
    folder: Option<OsString>,
    variables: Vec<(OsString, OsString)>,
}

impl Surroundings {
    /// Returns the present working folder and environment variables of this process.
    pub(super) fn present() -> Self {
        let folder = std::env::current_dir().ok().map(Into::into);
        Self { folder, variables: std::env::vars_os().collect() }
    }

    /// Applies them to this process, a worker whose own folder is `own`. Temporary files go to `own`. `own`
    /// becomes the working folder if the other one cannot be entered. No other thread may be running.
    pub(super) fn enter(&self, own: &Path) -> io::Result<()> {
        if self.folder.as_ref().is_none_or(|folder| std::env::set_current_dir(folder).is_err()) {
            std::env::set_current_dir(own)?;
        }
        // Overwritten in place, because child processes of the worker are identified by this folder in
        // `/proc/<pid>/environ`.
        for name in [FOLDER, TEMPORARY] {
            overwrite_variable(name, own.as_os_str().as_bytes())?;
        }
        replace_environment(&self.variables, &[FOLDER, TEMPORARY]);
        Ok(())
    }
}
