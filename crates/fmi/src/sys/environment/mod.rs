//! Environment of calls into an FMU: one thread is inside of its loaded library, in the default
//! floating-point mode.
//!
//! The mode is set before a library is loaded, before an instance is made and freed, and before each run, and
//! what was there is put back at the end. What an FMU changes in a call acts until the end of the run, in
//! every run alike.

mod float;

use crate::fair_lock::{FairLock, Turn};
use float::FloatMode;
use std::cell::Cell;
use std::ptr;
use std::sync::Arc;

thread_local! {
    /// The lock of the library that this thread has entered last and is inside of.
    static ENTERED: Cell<*const FairLock> = const { Cell::new(ptr::null()) };
}

/// No other thread is inside of a loaded library while this lives, and this thread was in the default
/// floating-point mode when it began. May be nested; the last one is dropped first.
pub(crate) struct Inside {
    before: *const FairLock,
    mode: FloatMode,
    // Others are let in last.
    _turn: Turn,
}

impl Inside {
    /// Waits until nobody else is inside.
    pub(crate) fn enter(lock: &Arc<FairLock>) -> Self {
        Self::with(lock.enter(), lock)
    }

    /// The same, as long as `wait` (asked every 20 ms) says so.
    pub(crate) fn enter_while(lock: &Arc<FairLock>, wait: &mut dyn FnMut() -> bool) -> Option<Self> {
        lock.enter_while(wait).map(|turn| Self::with(turn, lock))
    }

    /// The same for one call: nothing where the thread has entered the library.
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
        // Setting takes longer than looking.
        if !(self.mode.is_default() && FloatMode::present().is_default()) {
            self.mode.set();
        }
    }
}

/// Sets the default floating-point mode of this thread, if it is another.
pub(crate) fn set_float_mode() {
    if !FloatMode::present().is_default() {
        FloatMode::set_default();
    }
}
