//! `Uncertainty` and the preflight: the uncertainty of a fit, and the findings before it. In Python,
//! `pydfo.Uncertainty` and `pydfo.Preflight`.

use crate::convert::dict::dict;
use crate::convert::error;
use crate::convert::object;
use calibration::{Preflight, Uncertainty};
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::sync::Arc;

/// Uncertainty of the parameters at a point, in the form that a fit returns.
#[pyclass(frozen, module = "pydfo._core", name = "Uncertainty")]
pub(crate) struct PyUncertainty {
    inner: Arc<Uncertainty>,
}

/// Returns the fields of `pydfo.Preflight`.
pub(crate) fn preflight<'py>(py: Python<'py>, found: &Preflight) -> PyResult<Bound<'py, PyDict>> {
    object::with_text(py, found)
}

impl PyUncertainty {
    pub(crate) fn new(inner: Uncertainty) -> Self {
        Self { inner: Arc::new(inner) }
    }
}

#[pymethods]
impl PyUncertainty {
    /// Returns the complete state, which is the content of a pickle.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &object::to_bytes(&*self.inner)?))
    }

    /// Creates an uncertainty from its state.
    #[staticmethod]
    fn restore(state: &[u8]) -> PyResult<Self> {
        let bad = |what: String| PyValueError::new_err(format!("not a pickled Uncertainty: {what}"));
        let uncertainty: Uncertainty = ciborium::from_reader(state).map_err(|e| bad(e.to_string()))?;
        uncertainty.check_lengths().map_err(bad)?;
        Ok(Self::new(uncertainty))
    }

    /// Returns the fields of `pydfo.Uncertainty`.
    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let fields = object::fields(py, &*self.inner)?;
        let computed = dict!(py;;
            "uncorrected_stderr": self.inner.uncorrected_errors().map(|errors| PyArray1::from_vec(py, errors)),
            "verdict": self.inner.verdict(),
        );
        fields.update(computed.as_mapping())?;
        Ok(fields)
    }

    /// Returns lower and upper ends, n x 2. Without `corrected`, uses the standard errors for independent
    /// residuals.
    fn intervals<'py>(
        &self,
        py: Python<'py>,
        level: f64,
        corrected: bool,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let uncertainty = &self.inner;
        let ends = match corrected {
            true => uncertainty.confidence_intervals(level),
            false => uncertainty.uncorrected().confidence_intervals(level),
        };
        let ends = ends.map_err(|e| error::calibration(py, &e))?;
        let ends: Vec<Vec<f64>> = ends.into_iter().map(|(low, high)| vec![low, high]).collect();
        Ok(PyArray2::from_vec2(py, &ends)?)
    }

    /// Returns findings about the covariance as text; empty if there are none.
    fn message(&self) -> String {
        self.inner.message()
    }

    fn text(&self) -> String {
        self.inner.to_string()
    }
}
