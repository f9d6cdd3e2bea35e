//! Ctrl-C: the first one requests the end of the work, the second one ends the program.

#[cfg(windows)]
mod console;
#[cfg(not(windows))]
mod signals;

use crate::error::Error;
#[cfg(windows)]
use console::Handlers;
#[cfg(not(windows))]
use signals::Handlers;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Watches for Ctrl-C and for requests of other programs to end this one.
pub(crate) struct Interrupt {
    is_requested: Arc<AtomicBool>,
    _handlers: Handlers,
}

impl Interrupt {
    /// Watches until the value is dropped.
    pub(crate) fn watch() -> Result<Self, Error> {
        let is_requested = Arc::default();
        let handlers =
            Handlers::of(&is_requested).map_err(|e| Error::work(format!("cannot handle Ctrl-C: {e}")))?;
        Ok(Self { is_requested, _handlers: handlers })
    }

    /// True if the end of the work was requested.
    pub(crate) fn is_requested(&self) -> bool {
        self.is_requested.load(Ordering::Relaxed)
    }

    /// Returns the request as a flag.
    pub(crate) fn flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.is_requested)
    }
}
