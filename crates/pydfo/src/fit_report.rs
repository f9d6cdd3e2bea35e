//! What a fit found, for people: as text, as a part of a notebook, and as a page.

use crate::error;
use crate::fit::PyFit;
use crate::interrupt::Watch;
use crate::logs;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// The summary of a fit as plain text.
#[pyfunction]
pub(crate) fn fit_text(fit: &PyFit) -> String {
    fit.inner.to_string()
}

/// The summary of a fit as an HTML element.
#[pyfunction]
pub(crate) fn fit_html(fit: &PyFit) -> String {
    fit.inner.to_html()
}

/// Writes the report of a fit.
#[pyfunction]
pub(crate) fn fit_report(py: Python<'_>, fit: &PyFit, path: PathBuf) -> PyResult<()> {
    let watch = Watch::new(py)?;
    let flag = watch.stop().flag();
    let (calibration, fit) = (Arc::clone(&fit.calibration), Arc::clone(&fit.inner));
    let written =
        watch.run_briefly(move || calibration.report_until(&fit, path, &|| flag.load(Ordering::Relaxed)))?;
    logs::pass_on(py)?;
    if let Some(e) = watch.stop().take_raised() {
        return Err(e);
    }
    match written {
        Some(written) if !watch.stop().is_asked() => written.map_err(|e| error::calibration(py, &e)),
        _ => Err(error::interrupted(py, None, None)),
    }
}

/// How well an output is reproduced: experiment, variable, column, unit, n, RMS, RMS at the start, fit percentage.
type Output = (String, String, String, Option<String>, usize, f64, Option<f64>, f64);

/// How well each output is reproduced.
#[pyfunction]
pub(crate) fn fit_outputs(fit: &PyFit) -> Vec<Output> {
    let output = |o: &calibration::OutputFit| {
        let names = (o.experiment.clone(), o.variable.clone(), o.column.clone(), o.unit.clone());
        (names.0, names.1, names.2, names.3, o.n, o.rms, o.start_rms, o.fit_percent)
    };
    fit.inner.outputs.iter().map(output).collect()
}
