//! Signals of Unix: Ctrl-C and SIGTERM, with which other programs end this one.

use crate::error::Exit;
use signal_hook::SigId;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag::{register, register_conditional_shutdown};
use signal_hook::low_level::unregister;
use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Handles the signals until it is dropped.
pub(super) struct Handlers(Vec<SigId>);

impl Handlers {
    /// Makes the first signal set a flag, and the second one end the program.
    pub(super) fn of(flag: &Arc<AtomicBool>) -> io::Result<Self> {
        let mut handlers = Self(Vec::new());
        for signal in [SIGINT, SIGTERM] {
            // The order matters: the first signal finds the flag cleared and sets it.
            let shutdown =
                register_conditional_shutdown(signal, Exit::Interrupted.code().into(), flag.clone());
            for handler in [shutdown, register(signal, flag.clone())] {
                handlers.0.push(handler?);
            }
        }
        Ok(handlers)
    }
}

impl Drop for Handlers {
    fn drop(&mut self) {
        self.0.drain(..).for_each(|handler| _ = unregister(handler));
    }
}
