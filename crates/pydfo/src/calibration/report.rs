//! Results of a fit for display: as text, as a part of a notebook, and as a page.

use crate::calibration::fit::PyFit;
use crate::convert::error;
use crate::convert::findings::{self, FindingFields};
use crate::interrupt::logs;
use crate::interrupt::watch::Watch;
use calibration::RunContext;
use calibration::{Calibration, CalibrationError, ExperimentCurves, Fit, OutputCurves, Signal};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::Arc;

/// The summary of a fit as plain text.
#[pyfunction]
pub(crate) fn fit_text(fit: &PyFit) -> String {
    fit.inner.to_string()
}

/// Findings about a fit, the most severe first.
#[pyfunction]
pub(crate) fn fit_findings(fit: &PyFit) -> Vec<FindingFields> {
    findings::fields(fit.inner.findings())
}

/// The summary of a fit as an HTML element.
#[pyfunction]
pub(crate) fn fit_html(fit: &PyFit) -> String {
    fit.inner.to_html()
}

/// Does what simulates, without the interpreter lock; Ctrl-C ends it at the next step.
fn simulated<T: Send + 'static>(
    py: Python<'_>,
    fit: &PyFit,
    work: impl FnOnce(&Calibration, &Fit, &RunContext<'_>) -> Result<T, CalibrationError> + Send + 'static,
) -> PyResult<T> {
    let watch = Watch::new(py)?;
    let flag = watch.stop().flag();
    let (calibration, fit) = (Arc::clone(&fit.calibration), Arc::clone(&fit.inner));
    let done = watch.run_briefly(move || work(&calibration, &fit, &RunContext::new().flagged(&flag)))?;
    logs::pass_on(py)?;
    if let Some(e) = watch.stop().take_raised() {
        return Err(e);
    }
    match done {
        Some(done) if !watch.stop().is_asked() => done.map_err(|e| error::calibration(py, &e)),
        _ => Err(error::interrupted(py, None, None)),
    }
}

/// Writes the report of a fit.
#[pyfunction]
pub(crate) fn fit_report(py: Python<'_>, fit: &PyFit, path: PathBuf) -> PyResult<()> {
    simulated(py, fit, move |calibration, fit, context| calibration.report(fit, path, context))
}

/// A variable, its unit, times and values.
fn signal<'py>(py: Python<'py>, signal: Signal) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    fields.set_item("variable", signal.variable)?;
    fields.set_item("unit", signal.unit)?;
    fields.set_item("times", PyArray1::from_vec(py, signal.times))?;
    fields.set_item("values", PyArray1::from_vec(py, signal.values))?;
    Ok(fields)
}

/// Curves of a fit to be drawn, per experiment.
#[pyfunction]
pub(crate) fn fit_curves<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let experiments = simulated(py, fit, Calibration::curves)?;
    let output = |curves: OutputCurves| {
        let fields = PyDict::new(py);
        fields.set_item("measured", signal(py, curves.measured)?)?;
        fields.set_item("residuals", PyArray1::from_vec(py, curves.residuals))?;
        fields.set_item("start", curves.start.map(|s| signal(py, s)).transpose()?)?;
        fields.set_item("fitted", curves.fitted.map(|s| signal(py, s)).transpose()?)?;
        Ok(fields)
    };
    let experiment = |curves: ExperimentCurves| {
        let fields = PyDict::new(py);
        fields.set_item("name", curves.name)?;
        fields.set_item("windows", curves.windows)?;
        fields.set_item("outputs", curves.outputs.into_iter().map(output).collect::<PyResult<Vec<_>>>()?)?;
        let inputs = curves.inputs.into_iter().map(|input| signal(py, input));
        fields.set_item("inputs", inputs.collect::<PyResult<Vec<_>>>()?)?;
        Ok(fields)
    };
    experiments.into_iter().map(experiment).collect()
}

/// Changes of each output for a relative change of each parameter: per output its name, its times, and a row
/// per parameter. Empty: not known.
#[pyfunction]
pub(crate) fn fit_sensitivities<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let names = fit.calibration.problem().experiment_names();
    let layout = &fit.calibration.residual_layout().outputs;
    let all = fit.calibration.sensitivities(&fit.inner);
    let output = |(series, columns): (&calibration::OutputResiduals, Vec<Vec<f64>>)| {
        let fields = PyDict::new(py);
        fields.set_item("experiment", &names[series.experiment])?;
        fields.set_item("variable", &series.variable)?;
        let declared = fit.calibration.fmu().description().variable(&series.variable);
        fields.set_item("unit", declared.and_then(|v| v.unit.as_ref()))?;
        fields.set_item("times", PyArray1::from_slice(py, &series.times))?;
        fields.set_item("rows", PyArray2::from_vec2(py, &columns)?)?;
        Ok(fields)
    };
    layout.iter().zip(all).map(output).collect()
}

/// Quality of fit of an output: experiment, variable, column, unit, n, RMS, RMS at the start, fit percentage.
type Output = (String, String, String, Option<String>, usize, f64, Option<f64>, f64);

/// Quality of fit of each output.
#[pyfunction]
pub(crate) fn fit_outputs(fit: &PyFit) -> Vec<Output> {
    let output = |o: &calibration::OutputFit| {
        let names = (o.experiment.clone(), o.variable.clone(), o.column.clone(), o.unit.clone());
        (names.0, names.1, names.2, names.3, o.n, o.rms, o.start_rms, o.fit_percent)
    };
    fit.inner.outputs.iter().map(output).collect()
}
