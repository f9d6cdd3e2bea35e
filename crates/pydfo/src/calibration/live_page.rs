//! The page that shows a running fit.

use calibration::LivePage;
use pyo3::prelude::*;
use std::sync::Arc;

/// The page of a fit. It closes when this object is dropped.
#[pyclass(frozen, module = "pydfo._core", name = "LivePage")]
pub(crate) struct PyLivePage {
    pub(crate) inner: Arc<LivePage>,
}

#[pymethods]
impl PyLivePage {
    /// Address of the page.
    #[getter]
    fn url(&self) -> String {
        self.inner.url()
    }

    /// Shows why there is no fit, in a browser that has shown the running fit.
    fn show_error(&self, py: Python<'_>, message: &str) {
        py.detach(|| self.inner.show_error(message));
    }
}
