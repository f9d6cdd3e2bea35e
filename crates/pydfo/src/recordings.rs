//! What a calibration's recordings hold, and what does not fit about them.

use crate::calibration::PyCalibration;
use crate::findings::{self, FindingFields};
use calibration::Experiment;
use numpy::PyArray1;
use pyo3::prelude::*;

/// The findings of a check, the same as a table, how many evaluations were made, and whether there are notes only.
#[pyfunction]
pub(crate) fn check(
    py: Python<'_>,
    calibration: &PyCalibration,
    simulate: bool,
) -> PyResult<(Vec<FindingFields>, String, usize, bool)> {
    let check = calibration.compute(py, move |c, cancelled| c.check_until(simulate, cancelled))?;
    let (table, is_ok) = (check.to_string(), check.is_ok());
    Ok((findings::fields(check.findings), table, check.n_evaluations, is_ok))
}

/// Variable, column, unit, values, whether it is an input.
type Series<'py> = (String, String, Option<String>, Bound<'py, PyArray1<f64>>, bool);

/// Times, columns in use, windows.
type Recording<'py> = (Bound<'py, PyArray1<f64>>, Vec<Series<'py>>, Vec<(f64, f64)>);

/// The recordings of a calibration, in the units of the model.
#[pyfunction]
pub(crate) fn recorded<'py>(py: Python<'py>, calibration: &PyCalibration) -> Vec<Recording<'py>> {
    let description = calibration.inner.fmu().description();
    let recording = |experiment: &Experiment| {
        let data = experiment.data();
        let series = |(variable, column): (&str, &str), is_input| {
            let unit = description.variable(variable).and_then(|v| v.unit.clone());
            let values = data.column(column).unwrap_or_default();
            (variable.to_owned(), column.to_owned(), unit, PyArray1::from_slice(py, values), is_input)
        };
        let outputs = experiment.outputs().map(|pair| series(pair, false));
        let all = outputs.chain(experiment.driving_columns().map(|pair| series(pair, true))).collect();
        (PyArray1::from_slice(py, data.time()), all, experiment.windows_of_measurements().to_vec())
    };
    calibration.inner.problem().experiments.iter().map(recording).collect()
}
