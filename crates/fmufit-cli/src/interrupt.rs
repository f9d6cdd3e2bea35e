//! Ctrl-C: the first one requests the end of the work, the second one ends the program.

use crate::error::{Error, Exit};
use signal_hook::SigId;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag::{register, register_conditional_shutdown};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Watches for Ctrl-C and for SIGTERM, with which other programs end this one.
pub(crate) struct Interrupt {
    is_requested: Arc<AtomicBool>,
    handlers: Vec<SigId>,
}

impl Interrupt {
    /// Watches until the value is dropped.
    pub(crate) fn watch() -> Result<Self, Error> {
        let mut interrupt = Self { is_requested: Arc::default(), handlers: Vec::new() };
        for signal in [SIGINT, SIGTERM] {
            let flag = || Arc::clone(&interrupt.is_requested);
            // The order matters: the first signal finds the flag cleared and sets it.
            let shutdown = register_conditional_shutdown(signal, Exit::Interrupted.code().into(), flag());
            let handlers = [shutdown, register(signal, flag())];
            for handler in handlers {
                let handler = handler.map_err(|e| Error::work(format!("cannot handle Ctrl-C: {e}")))?;
                interrupt.handlers.push(handler);
            }
        }
        Ok(interrupt)
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

impl Drop for Interrupt {
    fn drop(&mut self) {
        self.handlers.drain(..).for_each(|handler| _ = signal_hook::low_level::unregister(handler));
    }
}
