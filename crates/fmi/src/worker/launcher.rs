//! Command that starts a worker process.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// A program that serves as a worker when it is started with these arguments: it calls
/// [`serve_if_worker`](super::serve_if_worker).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Launcher {
    /// The program.
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
    /// A library with [`serve_before_main`](crate::serve_before_main), which is loaded ahead of the program:
    /// then that need not start.
    pub preload: Option<PathBuf>,
}

static KNOWN: Mutex<Option<Launcher>> = Mutex::new(None);

impl Launcher {
    /// A program without arguments.
    pub fn of(program: impl Into<PathBuf>) -> Self {
        Self { program: program.into(), arguments: Vec::new(), preload: None }
    }

    /// Has a library loaded ahead of the program where that is possible: on Linux, where the program is that
    /// of this process, in which the library has found what it needs.
    #[must_use]
    pub fn preloading(mut self, library: PathBuf) -> Self {
        let is_listable = |byte: &u8| !byte.is_ascii_whitespace() && *byte != b':';
        let is_this = || {
            let (program, this) = (self.program.canonicalize().ok()?, std::env::current_exe().ok()?);
            (program == this.canonicalize().ok()?).then_some(())
        };
        let is_possible = cfg!(target_os = "linux")
            && library.as_os_str().as_encoded_bytes().iter().all(is_listable)
            && is_this().is_some();
        self.preload = is_possible.then_some(library);
        self
    }

    /// Has all workers that this process starts from now on started so.
    pub fn set(self) {
        *KNOWN.lock().unwrap_or_else(PoisonError::into_inner) = Some(self);
    }

    /// True if this program can start worker processes.
    pub fn is_known() -> bool {
        cfg!(unix) && Self::known().is_some()
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
        *known = Some(Launcher::of(program));
    }
}
