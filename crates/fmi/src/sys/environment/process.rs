//! What belongs to the whole process and FMUs are known to change: how some signals are handled, the locale, the working directory;
//! and the signals that the thread blocks. They are remembered while calls into FMUs are under way on any thread, looked at now and
//! then, and put back.
//!
//! Whoever else changes them meanwhile, on another thread, is taken for an FMU: the calls do not tell.
//!
//! Not looked at, for it would cost more than it saves or cannot be put back: the mask of permissions of new files, limits of resources,
//! priorities, timers, environment variables, the random numbers of the C library, closed standard streams and their buffers.

#[cfg(unix)]
mod watched {
    use std::cell::Cell;
    use std::ffi::{CStr, c_char, c_int};
    use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
    use std::sync::{Mutex, MutexGuard, PoisonError};

    const SIGNALS: [c_int; 6] =
        [libc::SIGINT, libc::SIGFPE, libc::SIGSEGV, libc::SIGTERM, libc::SIGPIPE, libc::SIGCHLD];

    /// The first ones matter while FMUs run; the others later: whether writing to a closed pipe ends the process, and whether it is told
    /// how a compiler has ended.
    const N_DURING_RUNS: usize = 4;

    /// Between two looks during a run.
    const INTERVAL: u64 = 20;

    struct State {
        /// Watches alive, in this process: a child that was forked meanwhile has none of these threads.
        watches: usize,
        process: u32,
        /// As they were when the first of the watches began.
        signals: [Option<libc::sigaction>; SIGNALS.len()],
        /// With its NUL.
        locale: Vec<u8>,
        /// With its NUL; empty where the system does not say.
        working_directory: Vec<u8>,
    }

    static STATE: Mutex<State> = Mutex::new(State {
        watches: 0,
        process: 0,
        signals: [None; SIGNALS.len()],
        locale: Vec::new(),
        working_directory: Vec::new(),
    });

    /// Somebody was told that an FMU does such things.
    static IS_TOLD: AtomicBool = AtomicBool::new(false);

    /// When the next look is due, in milliseconds of the clock.
    static NEXT_LOOK: AtomicU64 = AtomicU64::new(0);

    fn lock() -> MutexGuard<'static, State> {
        let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
        let process = std::process::id();
        if state.process != process {
            state.process = process;
            state.watches = 0;
        }
        state
    }

    /// Milliseconds of a clock that is cheap to read.
    fn now() -> u64 {
        #[cfg(any(target_os = "linux", target_os = "android"))]
        const CLOCK: libc::clockid_t = libc::CLOCK_MONOTONIC_COARSE;
        #[cfg(not(any(target_os = "linux", target_os = "android")))]
        const CLOCK: libc::clockid_t = libc::CLOCK_MONOTONIC;
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: the address is that of a local.
        unsafe { libc::clock_gettime(CLOCK, &raw mut time) };
        time.tv_sec as u64 * 1000 + time.tv_nsec as u64 / 1_000_000
    }

    /// How a signal is handled.
    fn disposition(signal: c_int) -> Option<libc::sigaction> {
        let mut action = std::mem::MaybeUninit::uninit();
        // SAFETY: nothing is set; on success the structure has been filled in.
        let done = unsafe { libc::sigaction(signal, std::ptr::null(), action.as_mut_ptr()) } == 0;
        // SAFETY: as above.
        done.then(|| unsafe { action.assume_init() })
    }

    /// The locale of the process, by name.
    fn locale() -> Option<&'static CStr> {
        // SAFETY: asking changes nothing; the name ends in NUL. POSIX lets the name be overwritten by another call of
        // setlocale: it is copied or compared at once, and a program that changes the locale of the process while other
        // threads use it is not safe anyway (setlocale is not thread-safe).
        unsafe {
            let name = libc::setlocale(libc::LC_ALL, std::ptr::null());
            (!name.is_null()).then(|| CStr::from_ptr(name))
        }
    }

    /// The working directory of the process; none for paths that are too long to ask for them often.
    fn working_directory(buffer: &mut [u8; 1024]) -> Option<&CStr> {
        // SAFETY: the buffer has the size that is given with it; on success a text with its NUL is in it.
        let found = unsafe { libc::getcwd(buffer.as_mut_ptr().cast::<c_char>(), buffer.len()) };
        if found.is_null() { None } else { CStr::from_bytes_until_nul(buffer).ok() }
    }

    impl State {
        fn remember(&mut self) {
            self.signals = SIGNALS.map(disposition);
            self.locale.clear();
            self.locale.extend_from_slice(locale().map_or(&[], CStr::to_bytes_with_nul));
            let mut buffer = [0; 1024];
            let directory = working_directory(&mut buffer).map_or(&[][..], CStr::to_bytes_with_nul);
            self.working_directory.clear();
            self.working_directory.extend_from_slice(directory);
        }

        /// Whether something had to be put back; `is_last`: no FMU is called any more after this.
        fn put_back(&self, is_last: bool) -> bool {
            let mut is_changed = false;
            let n = if is_last { SIGNALS.len() } else { N_DURING_RUNS };
            for (signal, then) in SIGNALS.into_iter().zip(&self.signals).take(n) {
                let Some(then) = then else { continue };
                let is_same = |now: &libc::sigaction| {
                    now.sa_sigaction == then.sa_sigaction && now.sa_flags == then.sa_flags
                };
                if disposition(signal).is_some_and(|now| !is_same(&now)) {
                    // SAFETY: the disposition is one that the process had before.
                    unsafe { libc::sigaction(signal, then, std::ptr::null_mut()) };
                    is_changed = true;
                }
            }
            let is_same = |now: &CStr| now.to_bytes_with_nul() == self.locale;
            if !self.locale.is_empty() && locale().is_some_and(|now| !is_same(now)) {
                // SAFETY: a name that setlocale gave, with its NUL.
                unsafe { libc::setlocale(libc::LC_ALL, self.locale.as_ptr().cast::<c_char>()) };
                is_changed = true;
            }
            let mut buffer = [0; 1024];
            let is_same = |now: &CStr| now.to_bytes_with_nul() == self.working_directory;
            if !self.working_directory.is_empty()
                && working_directory(&mut buffer).is_none_or(|now| !is_same(now))
            {
                // SAFETY: a path that getcwd gave, with its NUL.
                is_changed |= unsafe { libc::chdir(self.working_directory.as_ptr().cast::<c_char>()) } == 0;
            }
            is_changed
        }
    }

    thread_local! {
        /// The signals that this thread blocked when the first of its watches began.
        static BLOCKED: Cell<Option<libc::sigset_t>> = const { Cell::new(None) };
        /// When the next look at them is due.
        static NEXT_LOOK_HERE: Cell<u64> = const { Cell::new(0) };
    }

    /// The signals that this thread blocks; with `put_back`, has it block those.
    fn blocked(put_back: Option<&libc::sigset_t>) -> libc::sigset_t {
        // SAFETY: a set of signals is made of integers. What the system leaves of it stays zero.
        let mut blocked: libc::sigset_t = unsafe { std::mem::zeroed() };
        let new = put_back.map_or(std::ptr::null(), std::ptr::from_ref);
        // SAFETY: the addresses are NULL or those of sets.
        unsafe { libc::pthread_sigmask(libc::SIG_SETMASK, new, &raw mut blocked) };
        blocked
    }

    fn is_same_set(a: &libc::sigset_t, b: &libc::sigset_t) -> bool {
        let bytes = |set: *const libc::sigset_t| {
            // SAFETY: all bytes of a set are set, by `zeroed` or the system.
            unsafe { std::slice::from_raw_parts(set.cast::<u8>(), size_of::<libc::sigset_t>()) }
        };
        bytes(a) == bytes(b)
    }

    /// Puts the signals back that this thread blocks; whether that was necessary.
    fn look_here() -> bool {
        let changed = BLOCKED.get().filter(|then| !is_same_set(then, &blocked(None)));
        if let Some(then) = &changed {
            blocked(Some(then));
        }
        changed.is_some()
    }

    /// Puts back what has changed. Who logs may wait for locks of others: the state is not locked then.
    fn look(ends: usize) {
        let is_changed_here = look_here();
        let is_changed = is_changed_here | {
            let mut state = lock();
            let is_changed = state.watches > 0 && state.put_back(state.watches == ends);
            state.watches = state.watches.saturating_sub(ends);
            is_changed
        };
        if is_changed && !IS_TOLD.swap(true, Ordering::Relaxed) {
            log::warn!(
                "an FMU changed how this process handles signals or blocks them, its locale or its working directory; \
                 whenever that happens it is put back"
            );
        }
    }

    /// While it lives, what belongs to the process is remembered; looked at on drop.
    #[derive(Debug)]
    pub(crate) struct Watch {
        /// No other was alive on this thread.
        is_first: bool,
    }

    impl Watch {
        /// Within another one on this thread it does nothing: that one looks at the end, and now and then.
        pub(crate) fn begin() -> Self {
            if BLOCKED.get().is_some() {
                return Self { is_first: false };
            }
            BLOCKED.set(Some(blocked(None)));
            let mut state = lock();
            if state.watches == 0 {
                state.remember();
            }
            state.watches += 1;
            drop(state);
            let next = now() + INTERVAL;
            NEXT_LOOK.store(next, Ordering::Relaxed);
            NEXT_LOOK_HERE.set(next);
            Self { is_first: true }
        }
    }

    impl Drop for Watch {
        fn drop(&mut self) {
            if self.is_first {
                look(1);
                BLOCKED.set(None);
            }
        }
    }

    /// For calls that are made often: looks if the last time was 20 ms ago.
    #[inline]
    pub(crate) fn look_now_and_then() {
        let now = now();
        if now >= NEXT_LOOK.load(Ordering::Relaxed) {
            NEXT_LOOK.store(now + INTERVAL, Ordering::Relaxed);
            look(0);
        } else if now >= NEXT_LOOK_HERE.get() {
            look_here();
        } else {
            return;
        }
        NEXT_LOOK_HERE.set(now + INTERVAL);
    }
}

#[cfg(not(unix))]
mod watched {
    /// Nothing is watched here.
    #[derive(Debug)]
    pub(crate) struct Watch;

    impl Watch {
        pub(crate) fn begin() -> Self {
            Self
        }
    }

    pub(crate) fn look_now_and_then() {}
}

pub(super) use watched::Watch;
pub(crate) use watched::look_now_and_then;
