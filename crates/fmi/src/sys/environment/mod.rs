//! What a call into an FMU finds in its thread and its process, and must not leave behind: the floating-point mode, the
//! locale, and how the process handles some signals.
//!
//! Every call into an FMU starts in the default floating-point mode, and the mode is looked at after it, before any
//! arithmetic of ours: what an FMU changes acts until its function returns, in every run alike, and exceptions that it
//! unmasks are masked again. Of the three calls of a right-hand side this is done for the first few; then it is looked at
//! once after the three, and where one has changed the mode they are made again.

mod float;
mod locale;
mod process;

pub(crate) use process::look_now_and_then;

use float::FloatMode;
use std::cell::Cell;
use std::marker::PhantomData;

thread_local! {
    /// A `CallEnvironment` or a `OneCall` has set the thread up.
    static IS_SET_UP: Cell<bool> = const { Cell::new(false) };
}

/// Keeps the thread set up for calls into FMUs (default floating-point mode, C locale) and watches over what belongs to
/// the process; what was there before is put back on drop. May be nested.
#[derive(Debug)]
pub(crate) struct CallEnvironment {
    _thread: Option<ThreadSetup>,
    _process: process::Watch,
}

impl CallEnvironment {
    pub(crate) fn enter() -> Self {
        Self { _process: process::Watch::begin(), _thread: ThreadSetup::unless_done() }
    }
}

/// The same for one call, but for what belongs to the process: next to nothing inside of a [`CallEnvironment`].
pub(super) struct OneCall(Option<ThreadSetup>);

impl OneCall {
    #[inline]
    pub(super) fn enter() -> Self {
        Self(ThreadSetup::unless_done())
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
