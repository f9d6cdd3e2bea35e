//! Command that starts a worker process.

use super::handshake::{LEVEL, VERSION, WORKER_VARIABLE};
use crate::sys::{PRELOAD, PRELOADED_BEFORE};
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// A program that serves as a worker if it is started with these arguments. It must call
/// [`serve_if_worker`](super::serve_if_worker).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Launcher {
    /// Path of the program.
    pub program: PathBuf,
    /// Arguments of the program.
    pub arguments: Vec<OsString>,
    /// A library with [`serve_before_main`](crate::serve_before_main), to be preloaded. The start of the
    /// program itself is then skipped.
    pub preload: Option<PathBuf>,
    /// Wine, which runs `program`, a Windows program.
    pub(super) wine: Option<PathBuf>,
    /// What the models have that run in this program only, and not in this process.
    pub(super) models: Option<&'static str>,
}

static CURRENT: Mutex<Option<Launcher>> = Mutex::new(None);

impl Launcher {
    /// Creates a launcher for a program without arguments.
    pub fn of(program: impl Into<PathBuf>) -> Self {
        Self { program: program.into(), arguments: Vec::new(), preload: None, wine: None, models: None }
    }

    /// Adds arguments of the program.
    #[must_use]
    pub fn with_arguments(mut self, arguments: impl IntoIterator<Item = OsString>) -> Self {
        self.arguments.extend(arguments);
        self
    }

    /// Preloads a library if possible. This requires Linux and the program of this process, which satisfies
    /// the dependencies of the library.
    #[must_use]
    pub fn preloading(mut self, library: PathBuf) -> Self {
        let is_listable = |byte: &u8| !byte.is_ascii_whitespace() && *byte != b':';
        let is_this_program = || {
            let (program, current) = (self.program.canonicalize().ok()?, std::env::current_exe().ok()?);
            (program == current.canonicalize().ok()?).then_some(())
        };
        let is_possible = cfg!(target_os = "linux")
            && library.as_os_str().as_encoded_bytes().iter().all(is_listable)
            && is_this_program().is_some();
        self.preload = is_possible.then_some(library);
        self
    }

    /// Uses this launcher for all workers that this process starts from now on.
    pub fn set(self) {
        *CURRENT.lock().unwrap_or_else(PoisonError::into_inner) = Some(self);
    }

    /// Returns the launcher of workers; `None` if it has not been set.
    pub(super) fn current() -> Option<Self> {
        CURRENT.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the command that starts the program to serve.
    pub(super) fn command(&self) -> Command {
        let mut command = Command::new(self.wine.as_ref().unwrap_or(&self.program));
        command.args(self.wine.as_ref().map(|_| &self.program));
        command.args(&self.arguments).env(WORKER_VARIABLE, VERSION).env(LEVEL, log::max_level().as_str());
        if let Some(library) = &self.preload {
            let before = std::env::var_os(PRELOAD).unwrap_or_default();
            let mut libraries = before.clone();
            libraries.push(if before.is_empty() { "" } else { ":" });
            libraries.push(library);
            command.env(PRELOAD, libraries).env(PRELOADED_BEFORE, before);
        }
        command
    }
}

/// Makes this program the launcher, unless another one has been set.
pub(super) fn set_this_program() {
    let mut launcher = CURRENT.lock().unwrap_or_else(PoisonError::into_inner);
    if launcher.is_none()
        && let Ok(program) = std::env::current_exe()
    {
        *launcher = Some(Launcher::of(program));
    }
}
