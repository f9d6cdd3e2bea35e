//! Events of the console of Windows: Ctrl-C, Ctrl-Break, and the end of the console.

use crate::error::Exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Flags of the work in progress. Windows has one handler for the whole program.
static WATCHED: Mutex<Vec<Arc<AtomicBool>>> = Mutex::new(Vec::new());

/// Handles the events until it is dropped.
pub(super) struct Handlers(Arc<AtomicBool>);

impl Handlers {
    /// Makes the first event set a flag, and the second one end the program.
    pub(super) fn of(flag: &Arc<AtomicBool>) -> Result<Self, String> {
        static INSTALLED: OnceLock<Result<(), String>> = OnceLock::new();
        INSTALLED.get_or_init(|| ctrlc::set_handler(on_event).map_err(|error| error.to_string())).clone()?;
        WATCHED.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(flag));
        Ok(Self(Arc::clone(flag)))
    }
}

impl Drop for Handlers {
    fn drop(&mut self) {
        let mut watched = WATCHED.lock().unwrap_or_else(PoisonError::into_inner);
        watched.retain(|flag| !Arc::ptr_eq(flag, &self.0));
    }
}

/// Requests the end of the work. Ends the program if there is none, or if its end was requested before.
fn on_event() {
    let watched = WATCHED.lock().unwrap_or_else(PoisonError::into_inner);
    let requested: Vec<bool> = watched.iter().map(|flag| flag.swap(true, Ordering::Relaxed)).collect();
    drop(watched);
    if requested.is_empty() || requested.contains(&true) {
        std::process::exit(Exit::Interrupted.code().into());
    }
}
