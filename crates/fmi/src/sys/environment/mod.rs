//! Environment of a call into an FMU, restored after the call: the floating-point mode and the locale of its
//! thread. No other thread is inside of the loaded library.
//!
//! Every call into an FMU starts in the default floating-point mode, and the mode is looked at after it,
//! before any arithmetic of ours: what an FMU changes acts until its function returns, in every run alike,
//! and exceptions that it unmasks are masked again. Of the three calls of a right-hand side, or of event
//! indicators, at a new point this is done for the first few; then it is looked at once after the three, and
//! where one has changed the mode they are made again.

mod float;
mod locale;

use crate::fair_lock::{FairLock, Turn};
use float::FloatMode;
use std::cell::Cell;
use std::marker::PhantomData;
use std::ptr;
use std::sync::Arc;

thread_local! {
    /// The thread is set up for calls.
    static IS_SET_UP: Cell<bool> = const { Cell::new(false) };
    /// The lock of the library that this thread has entered last and is inside of; it is set up for calls
    /// then.
    static ENTERED: Cell<*const FairLock> = const { Cell::new(ptr::null()) };
}

/// The thread is set up for calls into FMUs (default floating-point mode, C locale); what was there before is
/// put back on drop. May be nested.
#[derive(Debug)]
pub(crate) struct CallEnvironment {
    _thread: Option<ThreadSetup>,
}

impl CallEnvironment {
    pub(crate) fn enter() -> Self {
        Self { _thread: ThreadSetup::unless_done() }
    }
}

/// The thread is set up for calls, and no other one is inside of a loaded library while this lives. May be
/// nested; the last one is dropped first.
pub(crate) struct Inside {
    before: *const FairLock,
    // Put back before others are let in.
    _environment: CallEnvironment,
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

    fn with(turn: Turn, lock: &Arc<FairLock>) -> Self {
        let _environment = CallEnvironment::enter();
        Self { before: ENTERED.replace(Arc::as_ptr(lock)), _environment, _turn: turn }
    }
}

impl Drop for Inside {
    fn drop(&mut self) {
        ENTERED.set(self.before);
        // Also where the thread had been set up before, within calls of another library.
        restore_default();
    }
}

/// The same for one call: next to nothing where the thread has entered the library.
pub(super) struct OneCall(Option<Inside>);

impl OneCall {
    #[inline]
    pub(super) fn enter(lock: &Arc<FairLock>) -> Self {
        Self(if ptr::eq(ENTERED.get(), Arc::as_ptr(lock)) { None } else { Some(Inside::enter(lock)) })
    }

    /// Ends it after somebody else has looked at the mode.
    #[inline]
    pub(super) fn forget(self) {
        if self.0.is_none() {
            std::mem::forget(self);
        }
    }
}

impl Drop for OneCall {
    #[inline]
    fn drop(&mut self) {
        if self.0.is_none() {
            restore_default();
        }
    }
}

/// Sets the default floating-point mode if a call has changed it; whether one has.
#[inline]
pub(super) fn restore_default() -> bool {
    let is_changed = !FloatMode::present().is_default();
    if is_changed {
        FloatMode::set_default();
    }
    is_changed
}

/// The thread is set up for calls; undone on drop.
#[derive(Debug)]
struct ThreadSetup {
    mode: FloatMode,
    _locale: locale::CLocale,
    /// Mode and locale belong to the thread.
    _not_send: PhantomData<*const ()>,
}

impl ThreadSetup {
    #[inline]
    fn unless_done() -> Option<Self> {
        if IS_SET_UP.get() { None } else { Some(Self::make()) }
    }

    fn make() -> Self {
        IS_SET_UP.set(true);
        let mode = FloatMode::present();
        if !mode.is_default() {
            FloatMode::set_default();
        }
        Self { mode, _locale: locale::CLocale::enter(), _not_send: PhantomData }
    }
}

impl Drop for ThreadSetup {
    fn drop(&mut self) {
        // Setting takes longer than looking.
        if !(self.mode.is_default() && FloatMode::present().is_default()) {
            self.mode.set();
        }
        IS_SET_UP.set(false);
    }
}
