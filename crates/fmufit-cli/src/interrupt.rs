//! Ctrl-C: the first one asks the work to end, the second one ends the program.

use crate::error::{Error, Exit};
use signal_hook::SigId;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag::{register, register_conditional_shutdown};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Watches for Ctrl-C, and for the signal by which other programs ask this one to end.
pub(crate) struct Interrupt {
    is_asked: Arc<AtomicBool>,
    handlers: Vec<SigId>,
}

impl Interrupt {
    /// Watches from now on, until it is dropped.
    pub(crate) fn watch() -> Result<Self, Error> {
        let mut interrupt = Self { is_asked: Arc::default(), handlers: Vec::new() };
        for signal in [SIGINT, SIGTERM] {
            let flag = || Arc::clone(&interrupt.is_asked);
            // In this order: the first signal finds the flag down, and raises it.
            let shutdown = register_conditional_shutdown(signal, Exit::Interrupted.code().into(), flag());
            let handlers = [shutdown, register(signal, flag())];
            for handler in handlers {
                let handler = handler.map_err(|e| Error::work(format!("Ctrl-C cannot be watched: {e}")))?;
                interrupt.handlers.push(handler);
            }
        }
        Ok(interrupt)
    }

    /// True once the end was asked for.
    pub(crate) fn is_asked(&self) -> bool {
        self.is_asked.load(Ordering::Relaxed)
    }

    /// The same as a flag.
    pub(crate) fn flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.is_asked)
    }
}

impl Drop for Interrupt {
    fn drop(&mut self) {
        self.handlers.drain(..).for_each(|handler| _ = signal_hook::low_level::unregister(handler));
    }
}
