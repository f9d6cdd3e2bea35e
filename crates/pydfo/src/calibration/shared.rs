//! A calibration shared by several Python objects, with computations without the interpreter lock.

use crate::convert::error;
use crate::interrupt::interrupt_guard::InterruptGuard;
use crate::interrupt::logs;
use crate::model::inputs::Callbacks;
use calibration::{Calibration, CalibrationError, RunContext};
use pyo3::prelude::*;
use std::sync::Arc;

/// A calibration, shared.
#[derive(Clone)]
pub(crate) struct Shared {
    pub(crate) inner: Arc<Calibration>,
    /// The functions of time that drive inputs.
    pub(crate) callbacks: Callbacks,
}

impl Shared {
    /// Wraps a new calibration. Raises the exception of a function of time, if any.
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
        Ok(Self { inner: Arc::new(inner), callbacks })
    }

    /// Computes on the calling thread without the interpreter lock. Ctrl-C ends it at the next step.
    pub(crate) fn compute<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Calibration, &RunContext<'_>) -> Result<T, CalibrationError> + Send,
    ) -> PyResult<T> {
        match self.compute_to_end(py, work)? {
            (result, false) => Ok(result),
            (_, true) => Err(error::interrupted(py, None, None)),
        }
    }

    /// Computes like `compute`, for work that still has a result when Ctrl-C ends it. Also returns whether it
    /// was interrupted.
    pub(crate) fn compute_to_end<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Calibration, &RunContext<'_>) -> Result<T, CalibrationError> + Send,
    ) -> PyResult<(T, bool)> {
        let watch = InterruptGuard::new(py)?;
        let result = watch.run_here(|context| work(&self.inner, context));
        logs::pass_on(py)?;
        if let Some(e) = watch.stop().take_raised().or_else(|| self.callbacks.take_raised()) {
            return Err(e);
        }
        match (result, watch.stop().is_requested()) {
            (Ok(result), is_requested) => Ok((result, is_requested)),
            (Err(e), false) => Err(error::calibration(py, &e)),
            (Err(_), true) => Err(error::interrupted(py, None, None)),
        }
    }
}
