//! Environment of calls into an FMU: one thread is inside its loaded library, in the default floating-point
//! mode.
//!
//! The mode is set before a library is loaded, before an instance is created and freed, and before each run.
//! The previous mode is restored at the end. A change by an FMU during a call remains until the end of the
//! run, in every run alike.

mod float;

use crate::fair_lock::{FairLock, Turn};
use float::FloatMode;
use std::cell::Cell;
use std::ptr;
use std::sync::Arc;

thread_local! {
    /// Lock of the library that this thread entered last and is still inside.
    static ENTERED: Cell<*const FairLock> = const { Cell::new(ptr::null()) };
}

/// Guard: no other thread is inside the loaded library while it exists. This thread was in the default
/// floating-point mode when the guard was created. Guards may be nested; the last one is dropped first.
pub(crate) struct Inside {
    before: *const FairLock,
    mode: FloatMode,
    // Dropped last, to admit other threads after all other fields.
    _turn: Turn,
}

impl Inside {
    /// Waits until no other thread is inside.
    pub(crate) fn enter(lock: &Arc<FairLock>) -> Self {
        Self::with(lock.enter(), lock)
    }

    /// Waits as [`enter`](Self::enter) does, while `wait` (called every 20 ms) returns true.
    pub(crate) fn enter_while(lock: &Arc<FairLock>, wait: &mut dyn FnMut() -> bool) -> Option<Self> {
        lock.enter_while(wait).map(|turn| Self::with(turn, lock))
    }

    /// Enters for one call; returns `None` if the thread is already inside the library.
    #[inline]
    pub(super) fn enter_for_call(lock: &Arc<FairLock>) -> Option<Self> {
        (!ptr::eq(ENTERED.get(), Arc::as_ptr(lock))).then(|| Self::enter(lock))
    }

    fn with(turn: Turn, lock: &Arc<FairLock>) -> Self {
        let mode = FloatMode::present();
        set_float_mode();
        Self { before: ENTERED.replace(Arc::as_ptr(lock)), mode, _turn: turn }
    }
}

impl Drop for Inside {
    fn drop(&mut self) {
        ENTERED.set(self.before);
        // Writing the mode is slower than reading it.
        if !(self.mode.is_default() && FloatMode::present().is_default()) {
            self.mode.set();
        }
    }
}

/// Sets the default floating-point mode of this thread, unless it is already set.
pub(crate) fn set_float_mode() {
    if !FloatMode::present().is_default() {
        FloatMode::set_default();
    }
}
