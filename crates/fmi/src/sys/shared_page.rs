//! A page of memory that a worker process shares with the process that has started it: the last call into the
//! FMU, the simulated time, the request to end, and the numbers of the last question and answer. It outlives
//! the worker, so that its end can be explained.

use crate::error::FmiError;
use std::fs::File;
use std::io;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Bytes of a function's name; longer ones are cut.
const NAME: usize = 48;

/// Functions that are known by name; calls of further ones are not told.
const NAMES: usize = 160;

/// Memory shared by both processes. All bits are valid values, whatever an FMU writes there.
#[repr(C)]
struct Shared {
    /// Not 0: the worker is to end what it does.
    cancel: AtomicU32,
    /// Simulations begun.
    runs: AtomicU32,
    /// The last call: the place of its name, from 1; 0: none.
    call: AtomicU32,
    n_names: AtomicU32,
    /// What had failed when a signal came: [`NO_MEMORY`], [`REFUSED`] or nothing.
    failed: AtomicU32,
    /// The bits of the simulated time.
    time: AtomicU64,
    names: [[AtomicU8; NAME]; NAMES],
    turns: Turns,
}

/// In cache lines of its own: who waits reads it all the time, and the rest changes with every call of the
/// FMU.
#[repr(C, align(128))]
struct Turns {
    /// Number of the last question that is on its way.
    asked: AtomicU32,
    /// Number of the last question whose answer is on its way.
    answered: AtomicU32,
    /// Not 0: the worker may keep a core busy for a moment while it waits for the next question.
    may_spin: AtomicU32,
}

const LENGTH: usize = size_of::<Shared>();

/// An allocation.
pub(super) const NO_MEMORY: u32 = 1;

/// A call that the sandbox does not allow.
pub(super) const REFUSED: u32 = 2;

/// The last call that a worker has made, as the other process finds it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LastCall {
    /// The function, by the standard's name.
    pub(crate) function: String,
    /// The simulated time.
    pub(crate) time: Option<f64>,
}

/// The page.
pub(crate) struct Page {
    shared: std::ptr::NonNull<Shared>,
}

// SAFETY: all that is reached through the pointer are atomics.
unsafe impl Send for Page {}
// SAFETY: as above.
unsafe impl Sync for Page {}

impl std::fmt::Debug for Page {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Page").field("last_call", &self.last_call()).finish()
    }
}

impl Page {
    /// A new page, and the file by which the other process gets it. The file cannot be made shorter where the
    /// system knows that.
    pub(crate) fn new() -> io::Result<(Self, File)> {
        let file = anonymous_file()?;
        Ok((Self::of(&file)?, file))
    }

    /// The page in a file that [`new`](Self::new) has made.
    pub(crate) fn of(file: &File) -> io::Result<Self> {
        use rustix::mm::{MapFlags, ProtFlags, mmap};
        if file.metadata()?.len() < LENGTH as u64 {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the shared page is too short"));
        }
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping at an address that the system chooses, of a file that has this length.
        let address = unsafe { mmap(std::ptr::null_mut(), LENGTH, protection, MapFlags::SHARED, file, 0) }?;
        std::ptr::NonNull::new(address.cast())
            .map(|shared| Self { shared })
            .ok_or_else(|| io::ErrorKind::Other.into())
    }

    fn shared(&self) -> &Shared {
        // SAFETY: mapped until this is dropped, aligned to a page, and made of atomics, for which any bits are valid.
        unsafe { self.shared.as_ref() }
    }

    /// Asks the worker to end what it does, or takes that back.
    pub(crate) fn set_cancelled(&self, cancelled: bool) {
        self.shared().cancel.store(cancelled.into(), Ordering::Relaxed);
    }

    /// True if the worker is to end its current work.
    pub(crate) fn is_cancelled(&self) -> bool {
        self.shared().cancel.load(Ordering::Relaxed) != 0
    }

    /// Sets whether the worker may [wait](Self::wait_for_question) for the next question without sleeping.
    pub(crate) fn set_may_spin(&self, may_spin: bool) {
        self.shared().turns.may_spin.store(may_spin.into(), Ordering::Relaxed);
    }

    /// Says that a question was sent. Who is told before sleeps until it arrives.
    pub(crate) fn note_question(&self, number: u32) {
        self.shared().turns.asked.store(number, Ordering::Release);
    }

    /// Says that an answer is on its way.
    pub(crate) fn note_answer(&self, number: u32) {
        self.shared().turns.answered.store(number, Ordering::Release);
    }

    /// Waits without sleeping until the answer is on its way, no longer than so. A core that sleeps wakes up
    /// late.
    pub(crate) fn wait_for_answer(&self, number: u32, longest: Duration) {
        let answered = &self.shared().turns.answered;
        spin_until(longest, || answered.load(Ordering::Acquire) == number);
    }

    /// Waits without sleeping until a question after this one is on its way, no longer than so, and only
    /// where that was allowed.
    pub(crate) fn wait_for_question(&self, after: u32, longest: Duration) {
        let turns = &self.shared().turns;
        if turns.may_spin.load(Ordering::Relaxed) != 0 {
            spin_until(longest, || turns.asked.load(Ordering::Acquire) != after);
        }
    }

    /// Simulations begun.
    pub(crate) fn runs(&self) -> u32 {
        self.shared().runs.load(Ordering::Relaxed)
    }

    /// True if an allocation had failed when a signal came.
    pub(crate) fn is_without_memory(&self) -> bool {
        self.shared().failed.load(Ordering::Relaxed) == NO_MEMORY
    }

    /// True if the sandbox had refused something when a signal came.
    pub(crate) fn is_refused(&self) -> bool {
        self.shared().failed.load(Ordering::Relaxed) == REFUSED
    }

    /// The last call; `None` before the first one.
    pub(crate) fn last_call(&self) -> Option<LastCall> {
        let shared = self.shared();
        let place = (shared.call.load(Ordering::Relaxed) as usize).checked_sub(1)?;
        let name = shared.names.get(place)?.iter().map(|byte| byte.load(Ordering::Relaxed));
        let name: Vec<u8> = name.take_while(|byte| byte.is_ascii_graphic()).collect();
        let time = f64::from_bits(shared.time.load(Ordering::Relaxed));
        let function = String::from_utf8(name).ok()?;
        Some(LastCall { function, time: time.is_finite().then_some(time) })
    }

    /// The number by which calls of a function are told; 0: they are not.
    fn number_of(&self, name: &str) -> u32 {
        let shared = self.shared();
        let n = shared.n_names.load(Ordering::Relaxed) as usize;
        let cut = &name.as_bytes()[..name.len().min(NAME)];
        let is_same = |row: &[AtomicU8; NAME]| {
            let known = row.iter().map(|byte| byte.load(Ordering::Relaxed));
            known.take_while(|byte| *byte != 0).eq(cut.iter().copied())
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

/// Looks at a condition for so long, and leaves the core to whoever else has use for it.
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

impl Drop for Page {
    fn drop(&mut self) {
        // SAFETY: mapped by `of` with this length; references do not outlive the page.
        let _ = unsafe { rustix::mm::munmap(self.shared.as_ptr().cast(), LENGTH) };
    }
}

#[cfg(any(target_os = "linux", target_os = "android"))]
fn anonymous_file() -> io::Result<File> {
    use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
    let file = memfd_create("fmufit-worker", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    ftruncate(&file, LENGTH as u64)?;
    // Whoever reads a page that was cut off is killed.
    fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
    Ok(file.into())
}

#[cfg(not(any(target_os = "linux", target_os = "android")))]
fn anonymous_file() -> io::Result<File> {
    let file = tempfile::tempfile()?;
    file.set_len(LENGTH as u64)?;
    Ok(file)
}

/// The page of this process, if it is a worker.
static PAGE: OnceLock<Page> = OnceLock::new();

/// Makes this process one that tells its calls.
pub(crate) fn tell_calls(page: Page) -> Result<&'static Page, FmiError> {
    PAGE.set(page).map_err(|_| FmiError::BadSetting("this process serves already".to_owned()))?;
    PAGE.get().ok_or(FmiError::Cancelled)
}

/// True if this process is a worker.
pub(crate) fn is_worker() -> bool {
    PAGE.get().is_some()
}

/// The number by which calls of a function are told; 0: they are not.
pub(super) fn number_of(name: &str) -> u32 {
    PAGE.get().map_or(0, |page| page.number_of(name))
}

/// Tells of a call that will be made.
#[inline]
pub(super) fn note_call(number: u32) {
    if number != 0
        && let Some(page) = PAGE.get()
    {
        page.shared().call.store(number, Ordering::Relaxed);
    }
}

/// Tells the time at which calls are made.
#[inline]
pub(super) fn note_time(time: f64) {
    if let Some(page) = PAGE.get() {
        page.shared().time.store(time.to_bits(), Ordering::Relaxed);
    }
}

/// Tells that a simulation begins, with the checks that come before it.
pub(crate) fn note_run() {
    if let Some(page) = PAGE.get() {
        page.shared().runs.fetch_add(1, Ordering::Relaxed);
    }
}

/// Tells that an instance is brought to its start, where it has no time.
pub(crate) fn note_start() {
    if let Some(page) = PAGE.get() {
        page.shared().time.store(f64::NAN.to_bits(), Ordering::Relaxed);
    }
}

/// Tells what had failed when a signal came.
pub(super) fn note_failed(what: u32) {
    if let Some(page) = PAGE.get() {
        page.shared().failed.store(what, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_side_notes_the_other_reads() {
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
        // Whatever an FMU writes there.
        theirs.shared().call.store(u32::MAX, Ordering::Relaxed);
        assert_eq!(ours.last_call(), None);
        ours.set_cancelled(true);
        assert!(theirs.is_cancelled());
    }

    #[test]
    fn names_beyond_the_room_are_not_told() {
        let (page, _file) = Page::new().unwrap();
        let numbers: Vec<u32> = (0..NAMES + 2).map(|k| page.number_of(&format!("f{k}"))).collect();
        assert_eq!((numbers[NAMES - 1], numbers[NAMES]), (NAMES as u32, 0));
    }
}
