//! A calibration that several Python objects share, and how it is computed with without the interpreter lock.

use crate::convert::error;
use crate::interrupt::interrupt_guard::{InterruptGuard, fits_here};
use crate::interrupt::logs;
use crate::model::inputs::Callbacks;
use calibration::{Calibration, CalibrationError, RunContext};
use pyo3::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A calibration, shared.
#[derive(Clone)]
pub(crate) struct Shared {
    pub(crate) inner: Arc<Calibration>,
    /// Duration of the last evaluation in ns; 0 before the first one.
    last: Arc<AtomicU64>,
    /// The functions of time that drive inputs.
    pub(crate) callbacks: Callbacks,
}

impl Shared {
    /// One that was built, unless a function of time has raised an exception.
    pub(crate) fn finish(
        py: Python<'_>,
        built: Result<Calibration, CalibrationError>,
        callbacks: Callbacks,
    ) -> PyResult<Self> {
        logs::pass_on(py)?;
        if let Some(e) = callbacks.take_raised() {
            return Err(e);
        }
        let inner = built.map_err(|e| error::calibration(py, &e))?;
        Ok(Self { inner: Arc::new(inner), last: Arc::default(), callbacks })
    }

    /// Evaluates without the interpreter lock: on the calling thread if the last evaluation was short. Ctrl-C
    /// ends it at the next step.
    pub(crate) fn compute<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Calibration, &RunContext<'_>) -> Result<T, CalibrationError> + Send + 'static,
    ) -> PyResult<T> {
        let last = self.last.load(Ordering::Relaxed);
        let last = (last > 0).then(|| Duration::from_nanos(last));
        let (inner, took) = (Arc::clone(&self.inner), Arc::clone(&self.last));
        let timed = move |context: &RunContext<'_>| {
            let begun = Instant::now();
            let result = work(&inner, context);
            let nanoseconds = u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX);
            took.store(nanoseconds.max(1), Ordering::Relaxed);
            result
        };
        let watch;
        let result = if fits_here(last) {
            watch = InterruptGuard::without_handler(py);
            Some(watch.run_here(timed))
        } else {
            watch = InterruptGuard::new(py)?;
            let flag = watch.stop().flag();
            watch.run_briefly(move || timed(&RunContext::new().flagged(&flag)))?
        };
        self.raise_of(py, &watch)?;
        match result.filter(|_| !watch.stop().is_asked()) {
            Some(result) => result.map_err(|e| error::calibration(py, &e)),
            None => Err(error::interrupted(py, None, None)),
        }
    }

    /// The same on another thread; the work ends on its own when Ctrl-C asks for it. Whether it did comes
    /// with its result.
    pub(crate) fn compute_to_end<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Calibration, &RunContext<'_>) -> Result<T, CalibrationError> + Send + 'static,
    ) -> PyResult<(T, bool)> {
        let (watch, inner) = (InterruptGuard::new(py)?, Arc::clone(&self.inner));
        let flag = watch.stop().flag();
        let result = watch.run(move |_| work(&inner, &RunContext::new().flagged(&flag)))?;
        self.raise_of(py, &watch)?;
        match (result, watch.stop().is_asked()) {
            (Some(Ok(result)), is_asked) => Ok((result, is_asked)),
            (Some(Err(e)), false) => Err(error::calibration(py, &e)),
            (Some(Err(_)) | None, _) => Err(error::interrupted(py, None, None)),
        }
    }

    /// Raises what a signal handler or a function of time has raised during the work.
    fn raise_of(&self, py: Python<'_>, watch: &InterruptGuard<'_>) -> PyResult<()> {
        logs::pass_on(py)?;
        watch.stop().take_raised().or_else(|| self.callbacks.take_raised()).map_or(Ok(()), Err)
    }
}
