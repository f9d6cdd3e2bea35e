//! `Fit`: the native result of a fit with its calibration, which `pydfo.Fit` holds.

use crate::report::{self, ResultKind};
use crate::trajectory::Counts;
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;
use std::sync::Arc;

/// A fit and what was fitted.
#[pyclass(frozen, module = "pydfo._core", name = "Fit")]
pub(crate) struct PyFit {
    pub(crate) inner: Arc<calibration::Fit>,
    pub(crate) calibration: Arc<calibration::Calibration>,
}

impl PyFit {
    /// The `pydfo.OptimizeResult` with what a fit has beyond that, which `pydfo.Fit` is made of; this is its `_native`.
    pub(crate) fn into_python(self, py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
        let fit = &*self.inner;
        let result = report::to_python(py, &fit.report, ResultKind::Cost)?;
        result.setattr("stats", Counts::new(&fit.stats))?;
        let at_bound = fit.at_bound.iter().map(|(i, side)| (&fit.names[*i], side.name()));
        result.setattr("at_bound", at_bound.into_py_dict(py)?)?;
        let inert: Vec<&String> = fit.without_effect.iter().map(|i| &fit.names[*i]).collect();
        result.setattr("without_effect", inert)?;
        result.setattr("start_cost", fit.start_cost)?;
        if let Some(covariance) = fit.report.covariance() {
            result.setattr("cov_message", covariance.message(|index| fit.names[index].clone()))?;
        }
        result.setattr("n_checks", fit.n_checks)?;
        result.setattr("n_beginnings", fit.n_beginnings)?;
        result.setattr("_native", self)?;
        Ok(result)
    }
}
