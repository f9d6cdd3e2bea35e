//! `Uncertainty` and the preflight: the uncertainty of a fit, and what is found before it;
//! `pydfo.Uncertainty` and `pydfo.Preflight` in Python.

use crate::calibration::fit::PyFit;
use crate::calibration::native::PyCalibration;
use crate::convert::error;
use crate::convert::findings;
use crate::convert::record::read;
use calibration::{Preflight, PreflightOptions, Uncertainty, UncertaintyOptions};
use numpy::{PyArray1, PyArray2, PyArrayMethods};
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
    let fields = PyDict::new(py);
    let name = |i: usize| &found.parameters[i].name;
    let checks = found.parameters.iter().map(|check| {
        let fields = PyDict::new(py);
        fields.set_item("name", &check.name)?;
        fields.set_item("start", check.start)?;
        fields.set_item("moved_to", check.moved_to)?;
        fields.set_item("sensitivity", check.sensitivity)?;
        fields.set_item("has_effect", check.has_effect)?;
        fields.set_item("failure", check.failure.as_deref())?;
        Ok(fields)
    });
    fields.set_item("parameters", checks.collect::<PyResult<Vec<_>>>()?)?;
    let pairs = found.confounded.iter().map(|(i, j, c)| (name(*i), name(*j), *c));
    fields.set_item("confounded", pairs.collect::<Vec<_>>())?;
    fields.set_item("cost", found.cost)?;
    fields.set_item("accurate_cost", found.accurate_cost)?;
    fields.set_item("noise", found.noise)?;
    fields.set_item("seconds_per_evaluation", found.seconds_per_evaluation)?;
    fields.set_item("expected_evaluations", found.expected_evaluations)?;
    fields.set_item("expected_seconds", found.expected_seconds)?;
    fields.set_item("workers", found.workers)?;
    fields.set_item("messages", &found.messages)?;
    fields.set_item("n_simulations", found.n_simulations)?;
    fields.set_item("text", found.to_string())?;
    Ok(fields)
}

fn matrix<'py>(py: Python<'py>, rows: &[f64], n: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
    PyArray1::from_slice(py, rows).reshape([rows.len() / n.max(1), n])
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
        let (uncertainty, fields) = (&*self.inner, PyDict::new(py));
        let n = uncertainty.x.len();
        let names =
            |indices: &[usize]| indices.iter().map(|i| uncertainty.names[*i].clone()).collect::<Vec<_>>();
        fields.set_item("estimator", uncertainty.estimator.name())?;
        fields.set_item("names", &uncertainty.names)?;
        fields.set_item("x", PyArray1::from_slice(py, &uncertainty.x))?;
        fields.set_item("covariance", matrix(py, &uncertainty.covariance, n)?)?;
        fields.set_item("correlation", matrix(py, &uncertainty.correlation, n)?)?;
        fields.set_item("jacobian", matrix(py, &uncertainty.jacobian, n)?)?;
        fields.set_item("stderr", PyArray1::from_slice(py, &uncertainty.standard_errors))?;
        let uncorrected = uncertainty.uncorrected_errors().map(|errors| PyArray1::from_vec(py, errors));
        fields.set_item("uncorrected_stderr", uncorrected)?;
        fields.set_item("autocorrelations", PyArray1::from_slice(py, &uncertainty.autocorrelations))?;
        let degrees = PyArray1::from_slice(py, &uncertainty.effective_degrees_of_freedom);
        fields.set_item("effective_degrees_of_freedom", degrees)?;
        let checks = uncertainty.residual_checks.iter().map(|check| {
            let fields = PyDict::new(py);
            fields.set_item("experiment", &check.experiment)?;
            fields.set_item("variable", &check.variable)?;
            fields.set_item("n", check.n)?;
            fields.set_item("mean", check.mean)?;
            fields.set_item("deviation", check.deviation)?;
            fields.set_item("autocorrelation", check.autocorrelation)?;
            fields.set_item("n_outliers", check.n_outliers)?;
            fields.set_item("runs", check.runs)?;
            Ok(fields)
        });
        fields.set_item("residual_checks", checks.collect::<PyResult<Vec<_>>>()?)?;
        fields.set_item("degrees_of_freedom", uncertainty.degrees_of_freedom)?;
        for (name, indices) in [
            ("held", &uncertainty.held),
            ("undetermined", &uncertainty.undetermined),
            ("without_effect", &uncertainty.without_effect),
            ("weakest", &uncertainty.weakest),
            ("identifiable", &uncertainty.identifiable),
        ] {
            fields.set_item(name, names(indices))?;
        }
        let pairs = uncertainty
            .confounded
            .iter()
            .map(|(i, j, c)| (&uncertainty.names[*i], &uncertainty.names[*j], *c));
        fields.set_item("confounded", pairs.collect::<Vec<_>>())?;
        fields.set_item("verdict", uncertainty.verdict())?;
        fields.set_item("findings", findings::fields(uncertainty.findings.clone()))?;
        fields.set_item("cost", uncertainty.cost)?;
        fields.set_item("accurate_cost", uncertainty.accurate_cost)?;
        fields.set_item("n_simulations", uncertainty.n_simulations)?;
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
        matrix(py, &ends.iter().flat_map(|(low, high)| [*low, *high]).collect::<Vec<_>>(), 2)
    }

    /// Findings about the covariance in words; empty if there are none.
    fn message(&self) -> String {
        self.inner.message()
    }

    fn text(&self) -> String {
        self.inner.to_string()
    }
}
