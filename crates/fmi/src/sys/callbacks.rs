//! Callbacks of an FMU: the logger and the memory functions.
//!
//! The loggers of FMI 1.0 and 2.0 are variadic. Stable Rust can call such functions but not define them. A
//! function with a fixed number of arguments would lose the arguments (messages would keep their `%s`). A C
//! shim (`logger.c`) therefore expands the message with `vsnprintf` and passes plain bytes to [`sink`].
//!
//! A message is stored in the log of the instance that is being called on its thread. The environment that an
//! FMU passes is ignored, because FMI 1.0 has none and some FMUs pass NULL or a constant. On threads that
//! belong to the FMU, no instance is being called. There, the environment is compared with the known
//! addresses.

use super::types;
use crate::log::{Log, LogFilter};
use crate::macros::getters;
use std::any::Any;
use std::collections::VecDeque;
use std::ffi::{c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, OnceLock, PoisonError};

/// All data that an FMU receives for callbacks. Threads of some FMUs log after their instance has been freed,
/// so these data are never freed. The library passes them to its next instance ([`Library`](super::Library)),
/// which receives such lines.
#[derive(Debug)]
pub(super) struct Callbacks {
    environment: &'static Environment,
    /// Additional data that a version of the standard requires, at an address that does not change.
    keep: OnceLock<&'static (dyn Any + Send + Sync)>,
    log: &'static Log,
}

impl Callbacks {
    getters! {
        pub(super) environment(self) -> &Environment = self.environment;
        pub(super) log(self) -> &Log = self.log;
    }

    pub(super) fn new(filter: LogFilter) -> Self {
        let log: &Log = Box::leak(Box::new(Log::new(filter)));
        let environment: &Environment = Box::leak(Box::new(Environment::new(log)));
        environment.register();
        Self { environment, keep: OnceLock::new(), log }
    }

    /// Makes the instance the current one of this thread. The messages of the following calls go to its log.
    #[inline]
    pub(super) fn enter(&self) {
        // SAFETY: environments of callbacks are never freed.
        unsafe { fmufit_enter(self.environment) };
    }

    /// Returns the data kept for the version. Creates them on first use.
    pub(super) fn keep<T: Any + Send + Sync>(&self, make: impl FnOnce(&Environment) -> T) -> *const T {
        let kept = self.keep.get_or_init(|| Box::leak(Box::new(make(self.environment))));
        // The type differs only if the instances of one library followed different versions.
        kept.downcast_ref::<T>().map_or(std::ptr::null(), std::ptr::from_ref)
    }

    /// Resets the callbacks for another instance.
    pub(super) fn renew(&self, filter: LogFilter) {
        self.log.filter.store(filter as u8, Ordering::Relaxed);
        self.log.lines().categories.clear();
        self.log.clear();
    }

    /// Discards the log lines. This program does not use the callbacks again.
    pub(super) fn abandon(self) {
        self.log.lines().kept = VecDeque::new();
    }
}

/// Addresses of the environments passed to FMUs.
static REGISTERED: Mutex<Vec<usize>> = Mutex::new(Vec::new());

/// Returns the environment at an address, or NULL.
extern "C" fn find(address: *const c_void) -> *const Environment {
    let registered = REGISTERED.lock().unwrap_or_else(PoisonError::into_inner);
    if registered.contains(&address.addr()) { address.cast() } else { std::ptr::null() }
}

/// Target of `componentEnvironment`, with the layout declared in `logger.c`.
#[repr(C)]
#[derive(Debug, Clone)]
pub(super) struct Environment {
    admits: unsafe extern "C" fn(*mut c_void, c_int) -> c_int,
    sink: unsafe extern "C" fn(*mut c_void, c_int, *const c_char, usize, *const c_char, usize),
    data: *mut c_void,
}

// SAFETY: not written after construction; `data` points to a `Log`, which is a mutex and may be used from any
// thread.
unsafe impl Send for Environment {}
// SAFETY: as for `Send`.
unsafe impl Sync for Environment {}

impl Environment {
    /// Creates an environment whose messages go to `log`. The log must outlive every component that knows the
    /// environment.
    pub(super) fn new(log: &Log) -> Self {
        Self { admits, sink, data: std::ptr::from_ref(log).cast_mut().cast() }
    }

    /// Registers the environment, so that it receives messages from threads that are not inside a call.
    fn register(&'static self) {
        let mut registered = REGISTERED.lock().unwrap_or_else(PoisonError::into_inner);
        if registered.is_empty() {
            // SAFETY: no FMU has an environment yet, so none calls the logger.
            unsafe { fmufit_set_find(find) };
        }
        registered.push(std::ptr::from_ref(self).addr());
    }
}

/// Returns nonzero to the C shim if a message should be logged.
///
/// # Safety
/// `data` is the address of a live [`Log`].
unsafe extern "C" fn admits(data: *mut c_void, status: c_int) -> c_int {
    // SAFETY: `Environment::new` stored the address of a `Log` that outlives the component (invariant 3).
    // Nothing here panics.
    let log = unsafe { &*data.cast::<Log>() };
    c_int::from(log.admits(types::status(status)))
}

/// Receives a message from the C shim.
///
/// # Safety
/// `data` is the address of a live [`Log`]; `category` and `text` point to at least `category_length` and
/// `text_length` bytes.
unsafe extern "C" fn sink(
    data: *mut c_void,
    status: c_int,
    category: *const c_char,
    category_length: usize,
    text: *const c_char,
    text_length: usize,
) {
    // A panic (for example, out of memory) must not unwind into C. In that case the line is lost.
    let _ = catch_unwind(AssertUnwindSafe(|| {
        // SAFETY: `Environment::new` stored the address of a `Log` that outlives the component (invariant 3).
        let log = unsafe { &*data.cast::<Log>() };
        // SAFETY: the shim passes its own buffer, or the FMU's category up to its NUL, with the length it
        // found.
        let (category, text) = unsafe {
            (
                std::slice::from_raw_parts(category.cast::<u8>(), category_length),
                std::slice::from_raw_parts(text.cast::<u8>(), text_length),
            )
        };
        log.lines().push(types::status(status), category, text);
    }));
}

unsafe extern "C" {
    /// Sets the function that finds an environment by its address (`logger.c`).
    fn fmufit_set_find(find: extern "C" fn(*const c_void) -> *const Environment);
    /// Sets the environment of the thread. It must not be freed before another one is set.
    fn fmufit_enter(environment: *const Environment);
    /// The logger of FMI 1.0 and 2.0 (`logger.c`).
    pub(super) fn fmufit_log(
        passed: *mut c_void,
        instance: *const c_char,
        status: c_int,
        category: *const c_char,
        message: *const c_char,
        ...
    );
    /// The logger of FMI 3.0, which receives a complete string.
    pub(super) fn fmufit_fmi3_log(
        passed: *mut c_void,
        status: c_int,
        category: *const c_char,
        message: *const c_char,
    );
    /// Allocates memory with `calloc`.
    pub(super) fn fmufit_allocate(count: usize, size: usize) -> *mut c_void;
    /// Frees memory with `free`.
    pub(super) fn fmufit_free(block: *mut c_void);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Status;
    use crate::log::LINES;
    use std::ffi::CStr;
    use std::ptr::null;

    fn texts(log: &Log) -> Vec<String> {
        log.last(LINES).0.into_iter().map(|line| line.text).collect()
    }

    /// Makes the environment the current one of the thread, which ends with the test.
    fn enter(environment: &Environment) {
        // SAFETY: nothing logs after the end of the test.
        unsafe { fmufit_enter(environment) };
    }

    fn send(environment: &Environment, message: *const c_char) {
        enter(environment);
        // SAFETY: the environment is alive; the format takes no arguments.
        unsafe { fmufit_log(std::ptr::null_mut(), null(), 3, null(), message) };
    }

    #[test]
    fn logger_expands_messages() {
        let log = Log::new(LogFilter::All);
        let environment = Environment::new(&log);
        enter(&environment);
        // SAFETY: the arguments fit the format.
        unsafe {
            fmufit_log(
                (&raw const environment).cast_mut().cast(),
                c"name".as_ptr(),
                1,
                c"cat".as_ptr(),
                c"x = %g, n = %d, s = %s, 100 %%\n".as_ptr(),
                1.5f64,
                42 as c_int,
                c"text".as_ptr(),
            );
        }
        let line = &log.last(1).0[0];
        assert_eq!(line.text, "x = 1.5, n = 42, s = text, 100 %");
        assert_eq!((line.status, line.category.as_str()), (Status::Warning, "cat"));
    }

    #[test]
    fn logger_tolerates_null_pointers_and_invalid_formats() {
        let log = Log::new(LogFilter::All);
        let environment = Environment::new(&log);
        enter(&environment);
        send(&environment, null());
        send(&environment, c"100 %".as_ptr());
        send(&environment, c"writes %n".as_ptr());
        send(&environment, c"odd %k".as_ptr());
        send(&environment, c"caf\xe9 \x1b[31m".as_ptr());
        assert_eq!(texts(&log), ["", "100 %", "writes %n", "odd %k", "caf\u{fffd} \u{fffd}[31m"]);
    }

    #[test]
    fn logger_keeps_texts_with_unsupported_conversions() {
        for text in [
            c"100 % successfully",
            c"% s and % d",
            c"%5$s %1$n",
            c"%*d %.*s %-5d %+d %#x %'d",
            c"50 %, then 100 %",
            c"%hhn %ln %lln %zn",
            c"%Lf %LF %jd %td %qd",
            c"%ls %lc %hs %lls %zs %lp %hf %llf %zg",
            c"%C %S %m %a %A %o %X %E %G %F",
            c"%99999999999d %.123456789f %1234s",
            c"%.",
            c"%l",
            c"%5",
            c"%.-3f",
            c"%%%",
            c"%v",
        ] {
            let log = Log::new(LogFilter::All);
            send(&Environment::new(&log), text.as_ptr());
            assert_eq!(texts(&log), [text.to_str().unwrap()], "{text:?}");
        }
    }

    #[test]
    fn logger_expands_conversions_of_all_sizes() {
        let log = Log::new(LogFilter::All);
        let environment = Environment::new(&log);
        enter(&environment);
        let environment: *mut c_void = (&raw const environment).cast_mut().cast();
        // SAFETY: the arguments fit the formats.
        unsafe {
            let (null, format) = (null(), c"%5d|%03d|%ld|%lld|%zu|%hd|%u|%x|%lx|%i".as_ptr());
            let (int, long, long_long) = (7 as c_int, -8 as std::ffi::c_long, -9i64);
            let (size, short, unsigned, hex) = (10usize, 11 as c_int, 12u32, 255u32);
            fmufit_log(
                environment,
                null,
                0,
                null,
                format,
                int,
                int,
                long,
                long_long,
                size,
                short,
                unsigned,
                hex,
                255 as std::ffi::c_ulong,
                int,
            );
            let format = c"%.3f|%8.2e|%g|%lf|%c|%.2s|%6s|%%|%.0f".as_ptr();
            let (x, text) = (1.5f64, c"text".as_ptr());
            fmufit_log(environment, null, 0, null, format, x, x, x, x, 65 as c_int, text, text, 2.0f64);
        }
        assert_eq!(
            texts(&log),
            ["    7|007|-8|-9|10|11|12|ff|ff|7", "1.500|1.50e+00|1.5|1.500000|A|te|  text|%|2"]
        );
    }

    #[test]
    fn log_admits_errors_beyond_rate_limit() {
        let log = Log::new(LogFilter::All);
        let environment = Environment::new(&log);
        enter(&environment);
        // SAFETY: the environment is alive; the format takes no arguments.
        let say = |status, text: &CStr| unsafe {
            let environment = (&raw const environment).cast_mut().cast();
            fmufit_log(environment, null(), status, null(), text.as_ptr());
        };
        for _ in 0..1000 {
            say(1, c"warning");
        }
        assert_eq!(log.refused.load(Ordering::Relaxed), 936);
        say(3, c"error");
        say(1, c"warning");
        let (lines, others) = log.last(2);
        assert_eq!(lines.last().unwrap().text, "error");
        assert_eq!(others, 1000);
        for _ in 0..100 {
            say(4, c"fatal");
        }
        assert_eq!(log.refused.load(Ordering::Relaxed), 937 + 100 - 63);
        // Every time point allows some more lines.
        log.go_on();
        say(1, c"not yet");
        assert!(texts(&log).iter().all(|text| text != "not yet"));
        for _ in 0..16 {
            log.go_on();
        }
        for _ in 0..5 {
            say(0, c"again");
        }
        assert_eq!(texts(&log).iter().filter(|text| *text == "again").count(), 4);
        log.clear();
        say(0, c"new");
        assert_eq!(log.last(9).1, 0);
    }

    #[test]
    fn log_does_not_count_filtered_lines() {
        for (filter, expected) in [
            (LogFilter::All, &["0", "1", "2", "3", "4", "9"][..]),
            (LogFilter::Warnings, &["1", "2", "3", "4", "9"]),
            (LogFilter::Errors, &["3", "4", "9"]),
            (LogFilter::Nothing, &[]),
        ] {
            let log = Log::new(filter);
            let environment = Environment::new(&log);
            enter(&environment);
            for (status, text) in [(0, c"0"), (1, c"1"), (2, c"2"), (3, c"3"), (4, c"4"), (9, c"9")] {
                // SAFETY: the environment is alive; the formats take no arguments.
                unsafe {
                    let environment: *mut c_void = (&raw const environment).cast_mut().cast();
                    fmufit_log(environment, null(), status, null(), text.as_ptr());
                    fmufit_fmi3_log(environment, status, null(), text.as_ptr());
                }
            }
            let twice: Vec<&str> = expected.iter().flat_map(|text| [*text, *text]).collect();
            assert_eq!(texts(&log), twice, "{filter:?}");
            assert_eq!(log.last(99).1, 0);
        }
    }

    #[test]
    fn logger_uses_instance_of_thread_for_any_environment() {
        let (first, second) = (Log::new(LogFilter::All), Log::new(LogFilter::All));
        let (one, two) = (Environment::new(&first), Environment::new(&second));
        let passed: [*mut c_void; 3] =
            [std::ptr::null_mut(), std::ptr::without_provenance_mut(1), (&raw const two).cast_mut().cast()];
        let say = |text: &CStr| {
            for passed in passed {
                // SAFETY: the environments outlive the calls; the formats take no arguments.
                unsafe {
                    fmufit_log(passed, null(), 1, null(), text.as_ptr());
                    fmufit_fmi3_log(passed, 1, null(), text.as_ptr());
                }
            }
        };
        say(c"lost");
        enter(&one);
        say(c"a");
        enter(&two);
        say(c"b");
        assert_eq!((texts(&first), texts(&second)), (vec!["a".to_owned(); 6], vec!["b".to_owned(); 6]));
    }

    #[test]
    fn logger_uses_passed_environment_on_foreign_threads() {
        let (first, second) = (Callbacks::new(LogFilter::All), Callbacks::new(LogFilter::All));
        first.enter();
        let passed = std::ptr::from_ref(second.environment()).addr();
        let say = move || {
            for passed in [0, 1, passed] {
                // SAFETY: callbacks are never freed; the format takes no arguments.
                unsafe {
                    fmufit_log(std::ptr::without_provenance_mut(passed), null(), 1, null(), c"late".as_ptr());
                }
            }
        };
        std::thread::spawn(say).join().unwrap();
        assert_eq!((texts(first.log()), texts(second.log())), (Vec::new(), vec!["late".to_owned()]));
    }

    #[test]
    fn fmi3_logger_does_not_expand_texts() {
        let log = Log::new(LogFilter::All);
        let environment = Environment::new(&log);
        enter(&environment);
        let address: *mut c_void = (&raw const environment).cast_mut().cast();
        // SAFETY: the environment is alive, the strings end in NUL or are NULL.
        unsafe {
            fmufit_fmi3_log(address, 3, c"cat".as_ptr(), c"100 %s".as_ptr());
            fmufit_fmi3_log(address, 0, null(), null());
        }
        assert_eq!(texts(&log), ["100 %s", ""]);
    }

    #[test]
    fn log_truncates_long_messages_and_counts_dropped_lines() {
        let log = Log::new(LogFilter::All);
        let environment = Environment::new(&log);
        enter(&environment);
        let long = std::ffi::CString::new(vec![b'a'; 10_000]).unwrap();
        send(&environment, long.as_ptr());
        let text = &log.last(1).0[0].text;
        assert!(text.len() == 2047 && text.ends_with("a..."));
        for _ in 0..1000 {
            send(&environment, c"flood".as_ptr());
        }
        let (lines, dropped) = log.last(10);
        assert_eq!((lines.len(), dropped), (10, 991));
        log.clear();
        assert_eq!(log.last(10), (Vec::new(), 0));
    }
}
