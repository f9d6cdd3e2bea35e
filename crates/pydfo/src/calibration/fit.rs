//! `Fit`: the native result of a fit with its calibration, which `pydfo.Fit` holds.

use pyo3::prelude::*;
use std::sync::Arc;

/// A fit and what was fitted.
#[pyclass(frozen, module = "pydfo._core", name = "Fit")]
pub(crate) struct PyFit {
    pub(crate) inner: Arc<calibration::Fit>,
    pub(crate) calibration: Arc<calibration::Calibration>,
}

#[pymethods]
impl PyFit {
    /// Where it started.
    #[getter]
    fn start(&self) -> Vec<f64> {
        self.inner.start.clone()
    }

    /// Names of the parameters in reports and figures.
    #[getter]
    fn shown_names(&self) -> Vec<String> {
        self.inner.shown_names().to_vec()
    }
}
