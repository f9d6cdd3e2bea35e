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
}
