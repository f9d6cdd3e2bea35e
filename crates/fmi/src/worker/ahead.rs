//! The program of worker processes, started before a problem is known.

use super::launcher::Launcher;
use super::platform::Starter;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// A program started in advance. It ends when this value is dropped, unless it is in use.
#[derive(Debug)]
pub struct StartedAhead(Mutex<Option<Ahead>>);

#[derive(Debug)]
struct Ahead {
    starter: Starter,
    launcher: Launcher,
    /// Process id of the owner. A forked child does not own the program.
    owner: u32,
}

static AHEAD: Mutex<Weak<StartedAhead>> = Mutex::new(Weak::new());

impl StartedAhead {
    fn content(&self) -> MutexGuard<'_, Option<Ahead>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Starts the program of worker processes in advance, without waiting for it. The program ends when the last
/// returned value is dropped, unless it is in use. Returns `None` if it cannot be started. The error is
/// reported when a worker is needed.
pub fn start_ahead() -> Option<Arc<StartedAhead>> {
    let mut started = AHEAD.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(ahead) = started.upgrade().filter(|ahead| ahead.content().is_some()) {
        return Some(ahead);
    }
    let launcher = Launcher::current()?;
    let starter = Starter::start(&launcher).ok()?;
    let content = Ahead { starter, launcher, owner: std::process::id() };
    let ahead = Arc::new(StartedAhead(Mutex::new(Some(content))));
    *started = Arc::downgrade(&ahead);
    Some(ahead)
}

/// Takes the program of this launcher, if it was started in advance and is still available.
pub(super) fn take(launcher: &Launcher) -> Option<Starter> {
    let ahead = AHEAD.lock().unwrap_or_else(PoisonError::into_inner).upgrade()?;
    let is_usable = |ahead: &mut Ahead| ahead.owner == std::process::id() && ahead.launcher == *launcher;
    ahead.content().take_if(is_usable).map(|ahead| ahead.starter)
}
