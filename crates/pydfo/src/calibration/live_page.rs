//! The page that shows a fit while it runs.

use calibration::LivePage;
use pyo3::prelude::*;
use std::sync::Arc;

/// The page of a fit; it ends with this.
#[pyclass(frozen, module = "pydfo._core", name = "LivePage")]
pub(crate) struct PyLivePage {
    pub(crate) inner: Arc<LivePage>,
}

#[pymethods]
impl PyLivePage {
    /// Its address.
    #[getter]
    fn url(&self) -> String {
        self.inner.url()
    }

    /// Shows why there is no fit, to a browser that has shown the running one.
    fn show_error(&self, py: Python<'_>, message: &str) {
        py.detach(|| self.inner.show_error(message));
    }
}
