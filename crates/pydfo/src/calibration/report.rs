//! Results of a fit for display: as text, as a part of a notebook, and as a page.

use crate::calibration::fit::PyFit;
use crate::calibration::native::compute_of;
use crate::convert::dict::dict;
use crate::convert::object;
use calibration::{Calibration, OutputResiduals};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// The summary of a fit as plain text.
#[pyfunction]
pub(crate) fn fit_text(fit: &PyFit) -> String {
    fit.inner.to_string()
}

/// Findings about a fit, the most severe first.
#[pyfunction]
pub(crate) fn fit_findings<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Bound<'py, PyAny>> {
    object::to_python(py, &fit.inner.findings())
}

/// The summary of a fit as an HTML element.
#[pyfunction]
pub(crate) fn fit_html(fit: &PyFit) -> String {
    fit.inner.to_html()
}

/// Writes the report of a fit.
#[pyfunction]
pub(crate) fn fit_report(py: Python<'_>, fit: &PyFit, path: PathBuf) -> PyResult<()> {
    compute_of(py, fit, move |calibration, fit, context| calibration.report(fit, path, context))
}

/// Curves of a fit to be drawn, per experiment.
#[pyfunction]
pub(crate) fn fit_curves<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Bound<'py, PyAny>> {
    object::to_python(py, &compute_of(py, fit, Calibration::curves)?)
}

/// Changes of each output for a relative change of each parameter: per output its name, its times, and a row
/// per parameter. Empty: not known.
#[pyfunction]
pub(crate) fn fit_sensitivities<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let names = fit.calibration.problem().experiment_names();
    let layout = &fit.calibration.residual_layout().outputs;
    let all = fit.calibration.sensitivities(&fit.inner);
    let output = |(series, columns): (&OutputResiduals, Vec<Vec<f64>>)| {
        let declared = fit.calibration.fmu().description().variable(&series.variable);
        Ok(dict!(py; series => variable;
            "experiment": &names[series.experiment],
            "unit": declared.and_then(|v| v.unit.as_ref()),
            "times": PyArray1::from_slice(py, &series.times),
            "rows": PyArray2::from_vec2(py, &columns)?,
        ))
    };
    layout.iter().zip(all).map(output).collect()
}

/// Quality of fit of each output.
#[pyfunction]
pub(crate) fn fit_outputs<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Bound<'py, PyAny>> {
    object::to_python(py, &fit.inner.outputs)
}
