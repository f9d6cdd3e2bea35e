//! A page of memory that a worker process shares with its parent process. It contains the last call into the
//! FMU, the simulated time, the cancellation request, and the numbers of the last request and answer. The
//! page outlives the worker, so that the end of the worker can be explained.

use crate::error::FmiError;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Maximum length of a function name in bytes. Longer names are truncated.
const NAME: usize = 48;

/// Maximum number of function names. Calls of further functions are not recorded.
const NAMES: usize = 160;

/// Memory shared by both processes. All bits are valid values, whatever an FMU writes to it.
#[repr(C)]
pub(super) struct Shared {
    /// Nonzero if the worker should stop its current work.
    cancel: AtomicU32,
    /// Number of simulations started.
    runs: AtomicU32,
    /// Index of the name of the last call, counted from 1; 0 if there is none.
    call: AtomicU32,
    n_names: AtomicU32,
    /// Cause of a failure that preceded a signal: [`NO_MEMORY`], [`REFUSED`] or 0.
    failed: AtomicU32,
    /// Code of the exception that ended a process of Windows; 0 if there was none.
    exception: AtomicU32,
    /// Bits of the simulated time.
    time: AtomicU64,
    names: [[AtomicU8; NAME]; NAMES],
    turns: Turns,
}

/// Fields that a waiting process reads continuously. They are in separate cache lines, because the other
/// fields change with every call of the FMU.
#[repr(C, align(128))]
struct Turns {
    /// Number of the last request sent.
    requested: AtomicU32,
    /// Number of the last request whose answer was sent.
    answered: AtomicU32,
    /// Nonzero if the worker may spin for a short time while it waits for the next request.
    may_spin: AtomicU32,
}

pub(super) const LENGTH: usize = size_of::<Shared>();

/// An allocation failed.
pub(super) const NO_MEMORY: u32 = 1;

/// The sandbox denied a system call.
pub(super) const REFUSED: u32 = 2;

/// The last call of a worker, as read by the parent process.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LastCall {
    /// Name of the function in the standard.
    pub(crate) function: String,
    /// Simulated time.
    pub(crate) time: Option<f64>,
}

/// The shared page, mapped into this process. The module of the system creates, maps and unmaps it
/// (`unix/mapping.rs`, `windows/mapping.rs`).
pub(crate) struct Page {
    /// Address of memory that exists until this is dropped, and contained zeros when it was created.
    pub(super) shared: std::ptr::NonNull<Shared>,
}

// SAFETY: only atomics are reached through the pointer.
unsafe impl Send for Page {}
// SAFETY: as above.
unsafe impl Sync for Page {}

impl std::fmt::Debug for Page {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Page").field("last_call", &self.last_call()).finish()
    }
}

impl Page {
    /// Makes this process record its calls in the page.
    pub(crate) fn tell_calls(self) -> Result<&'static Self, FmiError> {
        PAGE.set(self)
            .map_err(|_| FmiError::BadSetting("this process is already serving requests".to_owned()))?;
        PAGE.get().ok_or(FmiError::Cancelled)
    }

    fn shared(&self) -> &Shared {
        // SAFETY: mapped until this is dropped, aligned to a page, and made of atomics, for which any bits
        // are valid.
        unsafe { self.shared.as_ref() }
    }

    /// Sets or clears the request to stop the current work of the worker.
    pub(crate) fn set_cancelled(&self, cancelled: bool) {
        self.shared().cancel.store(cancelled.into(), Ordering::Relaxed);
    }

    /// True if the worker should stop its current work.
    pub(crate) fn is_cancelled(&self) -> bool {
        self.shared().cancel.load(Ordering::Relaxed) != 0
    }

    /// Sets whether the worker may [wait](Self::wait_for_question) for the next request by spinning.
    pub(crate) fn set_may_spin(&self, may_spin: bool) {
        self.shared().turns.may_spin.store(may_spin.into(), Ordering::Relaxed);
    }

    /// Records that a request was sent. A reader that sees the number before the request arrives must still
    /// wait for the request.
    pub(crate) fn note_question(&self, number: u32) {
        self.shared().turns.requested.store(number, Ordering::Release);
    }

    /// Records that an answer was sent.
    pub(crate) fn note_answer(&self, number: u32) {
        self.shared().turns.answered.store(number, Ordering::Release);
    }

    /// Spins until the answer was sent, at most for `longest`. Spinning avoids the delay of waking a sleeping
    /// core.
    pub(crate) fn wait_for_answer(&self, number: u32, longest: Duration) {
        let answered = &self.shared().turns.answered;
        spin_until(longest, || answered.load(Ordering::Acquire) == number);
    }

    /// Spins until a later request was sent, at most for `longest`, and only if spinning is allowed.
    pub(crate) fn wait_for_question(&self, after: u32, longest: Duration) {
        let turns = &self.shared().turns;
        if turns.may_spin.load(Ordering::Relaxed) != 0 {
            spin_until(longest, || turns.requested.load(Ordering::Acquire) != after);
        }
    }

    /// Returns the number of simulations started.
    pub(crate) fn runs(&self) -> u32 {
        self.shared().runs.load(Ordering::Relaxed)
    }

    /// True if a failed allocation preceded a signal.
    pub(crate) fn is_without_memory(&self) -> bool {
        self.shared().failed.load(Ordering::Relaxed) == NO_MEMORY
    }

    /// True if a denial by the sandbox preceded a signal.
    pub(crate) fn is_refused(&self) -> bool {
        self.shared().failed.load(Ordering::Relaxed) == REFUSED
    }

    /// Returns the code of the exception that ended a process of Windows.
    pub(crate) fn exception(&self) -> Option<u32> {
        Some(self.shared().exception.load(Ordering::Relaxed)).filter(|code| *code != 0)
    }

    /// Returns the last call; `None` before the first one.
    pub(crate) fn last_call(&self) -> Option<LastCall> {
        let shared = self.shared();
        let place = (shared.call.load(Ordering::Relaxed) as usize).checked_sub(1)?;
        let name = shared.names.get(place)?.iter().map(|byte| byte.load(Ordering::Relaxed));
        let name: Vec<u8> = name.take_while(|byte| byte.is_ascii_graphic()).collect();
        let time = f64::from_bits(shared.time.load(Ordering::Relaxed));
        let function = String::from_utf8(name).ok()?;
        Some(LastCall { function, time: time.is_finite().then_some(time) })
    }

    /// Returns the number with which calls of a function are recorded; 0 if they are not recorded.
    fn number_of(&self, name: &str) -> u32 {
        let shared = self.shared();
        let n = shared.n_names.load(Ordering::Relaxed) as usize;
        let cut = &name.as_bytes()[..name.len().min(NAME)];
        let is_same = |row: &[AtomicU8; NAME]| {
            let stored = row.iter().map(|byte| byte.load(Ordering::Relaxed));
            stored.take_while(|byte| *byte != 0).eq(cut.iter().copied())
        };
        let place = match shared.names.iter().take(n).position(is_same) {
            Some(place) => place,
            None if n < NAMES => {
                shared.names[n].iter().zip(cut).for_each(|(byte, new)| byte.store(*new, Ordering::Relaxed));
                shared.n_names.store(n as u32 + 1, Ordering::Relaxed);
                n
            }
            None => return 0,
        };
        place as u32 + 1
    }
}

/// Spins on a condition for at most `longest`, and yields the core to other threads.
fn spin_until(longest: Duration, is_met: impl Fn() -> bool) {
    let began = Instant::now();
    while began.elapsed() < longest {
        for _ in 0..16 {
            if is_met() {
                return;
            }
            std::hint::spin_loop();
        }
        std::thread::yield_now();
    }
}

/// Page of this process, if it is a worker.
static PAGE: OnceLock<Page> = OnceLock::new();

/// True if this process is a worker.
pub(crate) fn is_worker() -> bool {
    PAGE.get().is_some()
}

/// Returns the number with which calls of a function are recorded; 0 if they are not recorded.
pub(super) fn number_of(name: &str) -> u32 {
    PAGE.get().map_or(0, |page| page.number_of(name))
}

/// Records a call before it is made.
#[inline]
pub(super) fn note_call(number: u32) {
    if number != 0
        && let Some(page) = PAGE.get()
    {
        page.shared().call.store(number, Ordering::Relaxed);
    }
}

/// Records the time of the following calls.
#[inline]
pub(super) fn note_time(time: f64) {
    if let Some(page) = PAGE.get() {
        page.shared().time.store(time.to_bits(), Ordering::Relaxed);
    }
}

/// Records the start of a simulation, before its checks.
pub(crate) fn note_run() {
    if let Some(page) = PAGE.get() {
        page.shared().runs.fetch_add(1, Ordering::Relaxed);
    }
}

/// Records that an instance is being reset and has no time.
pub(crate) fn note_start() {
    if let Some(page) = PAGE.get() {
        page.shared().time.store(f64::NAN.to_bits(), Ordering::Relaxed);
    }
}

/// Records the exception that ends this process.
#[cfg(windows)]
pub(super) fn note_exception(code: u32) {
    if let Some(page) = PAGE.get() {
        page.shared().exception.store(code, Ordering::Relaxed);
    }
}

/// Records the cause of a failure that preceded a signal.
pub(super) fn note_failed(what: u32) {
    if let Some(page) = PAGE.get() {
        page.shared().failed.store(what, Ordering::Relaxed);
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;

    #[test]
    fn shared_page_transfers_last_call() {
        let (ours, file) = Page::new().unwrap();
        let theirs = Page::of(&file).unwrap();
        assert_eq!(ours.last_call(), None);
        let long = "f".repeat(NAME + 10);
        let (step, cut) = (theirs.number_of("fmi2DoStep"), theirs.number_of(&long));
        assert_eq!((step, theirs.number_of("fmi2DoStep"), theirs.number_of(&long)), (1, 1, cut));
        theirs.shared().time.store(3.25_f64.to_bits(), Ordering::Relaxed);
        theirs.shared().call.store(step, Ordering::Relaxed);
        assert_eq!(ours.last_call(), Some(LastCall { function: "fmi2DoStep".to_owned(), time: Some(3.25) }));
        theirs.shared().call.store(cut, Ordering::Relaxed);
        assert_eq!(ours.last_call().unwrap().function.len(), NAME);
        // An FMU may write anything to the page.
        theirs.shared().call.store(u32::MAX, Ordering::Relaxed);
        assert_eq!(ours.last_call(), None);
        ours.set_cancelled(true);
        assert!(theirs.is_cancelled());
    }

    #[test]
    fn shared_page_ignores_names_beyond_capacity() {
        let (page, _file) = Page::new().unwrap();
        let numbers: Vec<u32> = (0..NAMES + 2).map(|k| page.number_of(&format!("f{k}"))).collect();
        assert_eq!((numbers[NAMES - 1], numbers[NAMES]), (NAMES as u32, 0));
    }
}
