//! `Uncertainty` and the preflight: the uncertainty of a fit, and what is found before it;
//! `pydfo.Uncertainty` and `pydfo.Preflight` in Python.

use crate::calibration::fit::PyFit;
use crate::calibration::native::PyCalibration;
use crate::convert::error;
use crate::convert::object;
use crate::convert::record::read;
use calibration::{Preflight, PreflightOptions, Uncertainty, UncertaintyOptions};
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::sync::Arc;

/// Uncertainty of the parameters at a point, as the result of a fit.
#[pyclass(frozen, module = "pydfo._core", name = "Uncertainty")]
pub(crate) struct PyUncertainty {
    inner: Arc<Uncertainty>,
}

/// Uncertainty of the parameters of a fit, if it was estimated.
#[pyfunction]
pub(crate) fn uncertainty_of_fit(fit: &PyFit) -> Option<PyUncertainty> {
    fit.inner.uncertainty.clone().map(|uncertainty| PyUncertainty { inner: Arc::new(uncertainty) })
}

/// Uncertainty of the parameters at a point; all but those of the numbers `held` are free.
#[pyfunction]
pub(crate) fn uncertainty_at(
    py: Python<'_>,
    calibration: &PyCalibration,
    x: Vec<f64>,
    covariance: &str,
    held: Vec<usize>,
    workers: Option<usize>,
) -> PyResult<PyUncertainty> {
    let estimator = read("covariance", covariance)?;
    let options = UncertaintyOptions { workers, held, estimator, ..UncertaintyOptions::default() };
    let uncertainty = calibration.compute(py, move |c, context| c.uncertainty(&x, &options, context))?;
    Ok(PyUncertainty { inner: Arc::new(uncertainty) })
}

/// The fields of `pydfo.Preflight`, found at `x`.
#[pyfunction]
pub(crate) fn preflight_at<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    x: Vec<f64>,
    workers: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let options = PreflightOptions { start: Some(x), workers, ..PreflightOptions::default() };
    let found = calibration.compute(py, move |c, context| c.preflight(&options, context))?;
    preflight(py, &found)
}

/// The fields of `pydfo.Preflight` that a fit has, if it was asked for.
#[pyfunction]
pub(crate) fn preflight_of_fit<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Option<Bound<'py, PyDict>>> {
    fit.inner.preflight.as_ref().map(|found| preflight(py, found)).transpose()
}

fn preflight<'py>(py: Python<'py>, found: &Preflight) -> PyResult<Bound<'py, PyDict>> {
    let fields = object::fields(py, found)?;
    fields.set_item("text", found.to_string())?;
    Ok(fields)
}

#[pymethods]
impl PyUncertainty {
    /// All of it: what a pickle holds.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let mut bytes = Vec::new();
        ciborium::into_writer(&*self.inner, &mut bytes).map_err(|e| PyValueError::new_err(e.to_string()))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// From its state.
    #[staticmethod]
    fn restore(state: &[u8]) -> PyResult<Self> {
        let bad = |what: String| PyValueError::new_err(format!("this is no state of a Uncertainty: {what}"));
        let uncertainty: Uncertainty = ciborium::from_reader(state).map_err(|e| bad(e.to_string()))?;
        uncertainty.check_lengths().map_err(bad)?;
        Ok(Self { inner: Arc::new(uncertainty) })
    }

    /// The fields of `pydfo.Uncertainty`.
    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let fields = object::fields(py, &*self.inner)?;
        let uncorrected = self.inner.uncorrected_errors().map(|errors| PyArray1::from_vec(py, errors));
        fields.set_item("uncorrected_stderr", uncorrected)?;
        fields.set_item("verdict", self.inner.verdict())?;
        Ok(fields)
    }

    /// Lower and upper ends, n x 2; not `corrected`: with the standard errors that suppose independent
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

    /// Findings about the covariance in words; empty if there are none.
    fn message(&self) -> String {
        self.inner.message()
    }

    fn text(&self) -> String {
        self.inner.to_string()
    }
}
