//! Command that starts a worker process.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// A program that serves as a worker when it is started with these arguments: it calls
/// [`serve_if_asked`](super::serve_if_asked).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Launcher {
    /// The program.
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
}

static KNOWN: Mutex<Option<Launcher>> = Mutex::new(None);

impl Launcher {
    /// Has all workers that this process starts from now on started so.
    pub fn set(self) {
        *KNOWN.lock().unwrap_or_else(PoisonError::into_inner) = Some(self);
    }

    /// Command that starts workers; `None`: it has not been set.
    pub(super) fn known() -> Option<Self> {
        KNOWN.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// This program serves: unless another one was named, it starts itself.
pub(super) fn know_this_program() {
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if known.is_none()
        && let Ok(program) = std::env::current_exe()
    {
        *known = Some(Launcher { program, arguments: Vec::new() });
    }
}
