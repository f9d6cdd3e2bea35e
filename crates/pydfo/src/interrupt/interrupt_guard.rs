//! Handling of Ctrl-C. The calling thread checks for Python's signals while it waits for a worker process or
//! another thread. It also checks between two steps of a simulation and inside Python functions.
//!
//! While an [`InterruptGuard`] exists, this module handles SIGINT. The first SIGINT sets a flag: no further
//! evaluation starts and simulations stop at their next step, but a running Python function is not
//! interrupted. From the second SIGINT on, KeyboardInterrupt is raised as usual. A handler set by the user
//! stays in place. Work that runs inside other work (a simulation inside an objective) stops with it.

use crate::interrupt::lock::lock;
use crate::interrupt::logs;
use calibration::RunContext;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyTuple;
use std::cell::RefCell;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::Builder;
use std::time::{Duration, Instant};

pyo3::import_exception!(pydfo._errors, Interrupted);

/// Longest time that the calling thread waits before it checks for signals.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Shortest time between two reports of progress on the calling thread.
const TICK: Duration = Duration::from_millis(250);

/// Stack size of a thread that works for the calling thread, because compiled models put large arrays on the
/// stack.
const STACK_SIZE: usize = 16 << 20;

/// A request to end some work.
#[derive(Default)]
pub(crate) struct EndRequest {
    flag: Arc<AtomicBool>,
    requested: AtomicU32,
    /// The work that contains this work.
    parent: Option<Arc<EndRequest>>,
    /// Exception raised by a signal handler of the user.
    raised: Mutex<Option<PyErr>>,
}

impl EndRequest {
    /// Flag that optimisers and simulations check. Work may set it to end itself (an input function that
    /// raised an exception). It is never cleared.
    pub(crate) fn flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.flag)
    }

    /// True if the user, or the surrounding work, has requested the end of this work.
    pub(crate) fn is_requested(&self) -> bool {
        if self.requested.load(Ordering::Relaxed) > 0 {
            return true;
        }
        let by_parent = self.parent.as_ref().is_some_and(|p| p.is_requested());
        if by_parent {
            self.ask();
        }
        by_parent
    }

    /// True if this is part of other work, whose end must also be checked.
    pub(crate) fn has_parent(&self) -> bool {
        self.parent.is_some()
    }

    /// Ends the work with an exception.
    pub(crate) fn end_with(&self, exception: PyErr) {
        lock(&self.raised).get_or_insert(exception);
        self.flag.store(true, Ordering::Relaxed);
    }

    /// Requests the end. Returns the number of earlier requests.
    fn ask(&self) -> u32 {
        self.flag.store(true, Ordering::Relaxed);
        self.requested.fetch_add(1, Ordering::Relaxed)
    }

    /// Passes on log lines and lets Python handle its signals. Returns true if the user has interrupted the
    /// work twice.
    fn look(&self, py: Python<'_>) -> bool {
        let Err(e) = logs::pass_on(py).and_then(|()| py.check_signals()) else {
            self.is_requested();
            return false;
        };
        if !e.is_instance_of::<PyKeyboardInterrupt>(py) {
            lock(&self.raised).get_or_insert(e);
        }
        self.ask() > 0
    }

    /// Handles signals in a loop on the calling thread. Returns true if the loop must end.
    pub(crate) fn poll(&self, py: Python<'_>) -> bool {
        self.look(py);
        self.is_requested()
    }

    /// Takes the exception with which a signal handler of the user, or a handler of log lines, ended the
    /// work.
    pub(crate) fn take_raised(&self) -> Option<PyErr> {
        lock(&self.raised).take()
    }
}

thread_local! {
    /// End requests of the work whose Python functions this thread is calling.
    static AROUND: RefCell<Vec<Arc<EndRequest>>> = const { RefCell::new(Vec::new()) };
}

/// Guard: work that this thread starts before the guard is dropped counts as part of the given work.
pub(crate) struct Inside;

impl Inside {
    pub(crate) fn new(work: &Arc<EndRequest>) -> Self {
        AROUND.with_borrow_mut(|around| around.push(Arc::clone(work)));
        Self
    }
}

impl Drop for Inside {
    fn drop(&mut self) {
        AROUND.with_borrow_mut(|around| around.pop());
    }
}

/// Python's handling of SIGINT: the C module behind `signal`, because its Python wrappers cost as much as a
/// short simulation.
struct Signals {
    module: Py<PyModule>,
    sigint: Py<PyAny>,
    raising: Py<PyAny>,
}

impl Signals {
    fn get(py: Python<'_>) -> PyResult<&'static Self> {
        static FOUND: PyOnceLock<Signals> = PyOnceLock::new();
        FOUND.get_or_try_init(py, || {
            let module = py.import("_signal")?;
            let sigint = module.getattr("SIGINT")?.unbind();
            let raising = module.getattr("default_int_handler")?.unbind();
            Ok(Self { module: module.unbind(), sigint, raising })
        })
    }

    fn handler<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.module.bind(py).call_method1(intern!(py, "getsignal"), (&self.sigint,))
    }

    /// Sets the handler. Fails on threads other than the main thread, which receive no signals.
    fn handle_by(&self, py: Python<'_>, handler: &Bound<'_, PyAny>) -> PyResult<()> {
        self.module.bind(py).call_method1(intern!(py, "signal"), (&self.sigint, handler)).map(drop)
    }

    /// True if `handler` is Python's default handler, which raises KeyboardInterrupt.
    fn is_raising(&self, handler: &Bound<'_, PyAny>) -> bool {
        handler.is(&self.raising)
    }
}

/// Signal handler for SIGINT.
#[pyclass(frozen, module = "pydfo._core", name = "_SigintHandler")]
pub(crate) struct SigintHandler {
    active: Mutex<Vec<Arc<EndRequest>>>,
}

#[pymethods]
impl SigintHandler {
    #[pyo3(signature = (*_args))]
    fn __call__(&self, _args: &Bound<'_, PyTuple>) -> PyResult<()> {
        let active = lock(&self.active);
        // No work is left to end, so this behaves like Python's default handler.
        let mut raise = active.is_empty();
        for stop in active.iter() {
            raise |= stop.ask() > 0;
        }
        if raise { Err(PyKeyboardInterrupt::new_err(())) } else { Ok(()) }
    }
}

/// Handles SIGINT for some work until it is dropped.
pub(crate) struct InterruptGuard<'py> {
    py: Python<'py>,
    stop: Arc<EndRequest>,
    handler: Option<Bound<'py, SigintHandler>>,
    /// The handler to restore, if ours was installed for this work.
    previous: Option<Bound<'py, PyAny>>,
}

impl<'py> InterruptGuard<'py> {
    /// Keeps the current SIGINT handler. This is for work on the calling thread that calls no Python
    /// function. Such work checks for signals itself; later code handles signals that it does not notice.
    pub(crate) fn without_handler(py: Python<'py>) -> Self {
        let parent = AROUND.with_borrow(|around| around.last().cloned());
        let stop = Arc::new(EndRequest { parent, ..EndRequest::default() });
        Self { py, stop, handler: None, previous: None }
    }

    pub(crate) fn new(py: Python<'py>) -> PyResult<Self> {
        let mut watch = Self::without_handler(py);
        let signals = Signals::get(py)?;
        let current = signals.handler(py)?;
        if let Ok(handler) = current.cast::<SigintHandler>() {
            // This is inside other work on the main thread, or on another thread while the main thread works.
            // In the second case, the surrounding work, if any, is known as the parent.
            let threading = py.import("threading")?;
            let main = threading.call_method0("main_thread")?;
            if threading.call_method0("current_thread")?.is(&main) {
                lock(&handler.get().active).push(Arc::clone(&watch.stop));
                watch.handler = Some(handler.clone());
            }
        } else if signals.is_raising(&current) {
            let handler =
                Bound::new(py, SigintHandler { active: Mutex::new(vec![Arc::clone(&watch.stop)]) })?;
            match signals.handle_by(py, handler.as_any()) {
                Ok(()) => {
                    watch.handler = Some(handler);
                    watch.previous = Some(current);
                }
                // A pending signal was handled before our handler was installed.
                Err(e) if e.is_instance_of::<PyKeyboardInterrupt>(py) => return Err(e),
                Err(_) => {}
            }
        }
        Ok(watch)
    }

    pub(crate) fn stop(&self) -> &Arc<EndRequest> {
        &self.stop
    }

    /// Exception to raise if the work was ended: the exception of a signal handler, otherwise `Interrupted`.
    pub(crate) fn interrupted(&self) -> PyErr {
        self.stop.take_raised().unwrap_or_else(|| Interrupted::new_err("interrupted"))
    }

    /// Returns a function that handles signals every 20 ms, for the calling thread without the interpreter
    /// lock. The function returns true if the work must end.
    pub(crate) fn poller(&self) -> impl Fn() -> bool + Send + Sync + use<> {
        let (stop, next) = (Arc::clone(&self.stop), Mutex::new(Instant::now() + POLL_INTERVAL));
        move || {
            if Instant::now() >= *lock(&next) {
                Python::attach(|py| stop.look(py));
                *lock(&next) = Instant::now() + POLL_INTERVAL;
            }
            stop.is_requested()
        }
    }

    /// Runs `work` on the calling thread without the interpreter lock. Its context checks for signals every
    /// 20 ms.
    pub(crate) fn run_here<T: Send>(&self, work: impl FnOnce(&RunContext<'_>) -> T + Send) -> T {
        let (flag, ask) = (self.stop.flag(), self.poller());
        self.py.detach(|| work(&RunContext::new().flagged(&flag).polling(&ask)))
    }

    /// Runs work that calls Python functions on several threads. The work runs on a separate thread without
    /// the interpreter lock. Meanwhile, this thread handles signals, runs the jobs sent to the
    /// [`CallingThread`], and calls `tick` every quarter of a second. Returns `None` if the user has
    /// interrupted it twice; `work` then ends later without being joined.
    pub(crate) fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&CallingThread) -> T + Send + 'static,
        mut tick: impl FnMut(Python<'_>) -> PyResult<()>,
    ) -> PyResult<Option<T>> {
        let (sender, mut jobs) = channel();
        let caller = CallingThread { sender };
        let thread = Builder::new().name("pydfo-run".to_owned()).stack_size(STACK_SIZE);
        // The channel closes when the work ends, because `caller` is then dropped.
        let thread = thread.spawn(move || work(&caller))?;
        let mut last = Instant::now();
        loop {
            let job;
            (job, jobs) = self.py.detach(move || (jobs.recv_timeout(POLL_INTERVAL), jobs));
            match job {
                Ok(job) => job(self.py),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    // Short work can end before the first check for signals.
                    self.stop.look(self.py);
                    let result = self.py.detach(|| thread.join());
                    return result.map(Some).or_else(|panic| resume_unwind(panic));
                }
            }
            if last.elapsed() >= TICK {
                last = Instant::now();
                tick(self.py).unwrap_or_else(|e| self.stop.end_with(e));
            }
            if self.stop.look(self.py) {
                return Ok(None);
            }
        }
    }
}

impl InterruptGuard<'_> {
    /// Restores the previous handler, unless ours has been replaced.
    fn restore(&self, handler: &Bound<'_, SigintHandler>, previous: &Bound<'_, PyAny>) -> PyResult<()> {
        let signals = Signals::get(self.py)?;
        match signals.handler(self.py)?.is(handler) {
            true => signals.handle_by(self.py, previous),
            false => Ok(()),
        }
    }
}

impl Drop for InterruptGuard<'_> {
    fn drop(&mut self) {
        let Some(handler) = &self.handler else { return };
        let mut came_late = false;
        if let Some(previous) = &self.previous {
            // Python handles pending signals before it changes a handler. A signal that arrived after the
            // last check reaches this work, which has ended.
            let requested = self.stop.requested.load(Ordering::Relaxed);
            let restored = match self.restore(handler, previous) {
                Err(e) if e.is_instance_of::<PyKeyboardInterrupt>(self.py) => self.restore(handler, previous),
                outcome => outcome,
            };
            if let Err(e) = restored {
                e.write_unraisable(self.py, None);
            }
            came_late = self.stop.requested.load(Ordering::Relaxed) > requested;
        }
        lock(&handler.get().active).retain(|s| !Arc::ptr_eq(s, &self.stop));
        if came_late {
            // The signal is therefore passed on to the previous handler.
            let again = self.py.import("_thread").and_then(|thread| thread.call_method0("interrupt_main"));
            if let Err(e) = again {
                e.write_unraisable(self.py, None);
            }
        }
    }
}

type Job = Box<dyn FnOnce(Python<'_>) + Send>;

/// Sender of jobs that other threads run on the calling thread.
pub(crate) struct CallingThread {
    sender: Sender<Job>,
}

impl CallingThread {
    /// Runs `job` on the calling thread, with the interpreter lock. Returns `None` if the calling thread no
    /// longer receives jobs.
    pub(crate) fn call<R: Send + 'static>(
        &self,
        job: impl FnOnce(Python<'_>) -> R + Send + 'static,
    ) -> Option<R> {
        let (sender, answer) = channel();
        let job: Job = Box::new(move |py| {
            let _ = sender.send(job(py));
        });
        self.sender.send(job).ok()?;
        answer.recv().ok()
    }
}
