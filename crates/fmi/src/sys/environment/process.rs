//! What belongs to the whole process and FMUs are known to change: how SIGINT, SIGFPE and SIGSEGV are handled, the locale,
//! the working directory. They are remembered while calls into FMUs are under way on any thread, looked at now and then, and put back.
//!
//! Whoever else changes them meanwhile, on another thread, is taken for an FMU: the calls do not tell.

#[cfg(unix)]
mod watched {
    use std::ffi::{CStr, c_char, c_int};
    use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
    use std::sync::{Mutex, MutexGuard, PoisonError};

    const SIGNALS: [c_int; 3] = [libc::SIGINT, libc::SIGFPE, libc::SIGSEGV];

    /// Between two looks during a run.
    const INTERVAL: u64 = 20;

    struct State {
        /// Watches alive, in this process: a child that was forked meanwhile has none of these threads.
        watches: usize,
        process: u32,
        /// As they were when the first of the watches began.
        signals: Option<[libc::sigaction; 3]>,
        /// With its NUL.
        locale: Vec<u8>,
        /// With its NUL; empty where the system does not say.
        working_directory: Vec<u8>,
    }

    static STATE: Mutex<State> = Mutex::new(State {
        watches: 0,
        process: 0,
        signals: None,
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
            let [a, b, c] = SIGNALS.map(disposition);
            self.signals = a.zip(b).zip(c).map(|((a, b), c)| [a, b, c]);
            self.locale.clear();
            self.locale.extend_from_slice(locale().map_or(&[], CStr::to_bytes_with_nul));
            let mut buffer = [0; 1024];
            let directory = working_directory(&mut buffer).map_or(&[][..], CStr::to_bytes_with_nul);
            self.working_directory.clear();
            self.working_directory.extend_from_slice(directory);
        }

        /// Whether something had to be put back.
        fn put_back(&self) -> bool {
            let mut is_changed = false;
            for (signal, then) in SIGNALS.into_iter().zip(self.signals.iter().flatten()) {
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

    /// Puts back what has changed. Who logs may wait for locks of others: the state is not locked then.
    fn look(ends: usize) {
        let is_changed = {
            let mut state = lock();
            let is_changed = state.watches > 0 && state.put_back();
            state.watches = state.watches.saturating_sub(ends);
            is_changed
        };
        if is_changed && !IS_TOLD.swap(true, Ordering::Relaxed) {
            log::warn!(
                "an FMU changed how this process handles SIGINT, SIGFPE or SIGSEGV, its locale or its working \
                 directory; whenever that happens it is put back"
            );
        }
    }

    /// While it lives, what belongs to the process is remembered; looked at on drop.
    #[derive(Debug)]
    pub(in super::super) struct Watch(());

    impl Watch {
        pub(in super::super) fn begin() -> Self {
            let mut state = lock();
            if state.watches == 0 {
                state.remember();
            }
            state.watches += 1;
            NEXT_LOOK.store(now() + INTERVAL, Ordering::Relaxed);
            Self(())
        }
    }

    impl Drop for Watch {
        fn drop(&mut self) {
            look(1);
        }
    }

    /// For calls that are made often: looks if the last time was 20 ms ago.
    #[inline]
    pub(crate) fn look_now_and_then() {
        let now = now();
        if now >= NEXT_LOOK.load(Ordering::Relaxed) {
            NEXT_LOOK.store(now + INTERVAL, Ordering::Relaxed);
            look(0);
        }
    }
}

#[cfg(not(unix))]
mod watched {
    /// Nothing is watched here.
    #[derive(Debug)]
    pub(in super::super) struct Watch;

    impl Watch {
        pub(in super::super) fn begin() -> Self {
            Self
        }
    }

    pub(crate) fn look_now_and_then() {}
}

pub(super) use watched::Watch;
pub(crate) use watched::look_now_and_then;
