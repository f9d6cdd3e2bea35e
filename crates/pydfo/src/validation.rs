//! Validations and cross-validations of fits, as dicts of what their Python classes hold.

use crate::calibration::PyCalibration;
use crate::error;
use crate::experiment::ExperimentFields;
use crate::fit::PyFit;
use crate::trajectory::Counts;
use calibration::{CalibrationError, Experiment, ValidatedOutput, Validation, ValidationSet};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Recordings from the fields of their Python class; errors name the recording where there are several.
fn experiments(
    py: Python<'_>,
    calibration: &PyCalibration,
    given: Vec<ExperimentFields>,
) -> PyResult<Vec<Experiment>> {
    let is_one = given.len() == 1;
    let made = |(k, fields): (usize, ExperimentFields)| {
        let name = fields.name.clone().unwrap_or_else(|| Experiment::default_name(k));
        let start_values = fields.start_values(py, calibration.inner.fmu())?;
        fields.experiment(start_values).map_err(|e| {
            let named = if is_one { e } else { CalibrationError::Experiment { name, source: Box::new(e) } };
            error::calibration(py, &named)
        })
    };
    given.into_iter().enumerate().map(made).collect()
}

/// `Fit.validate`: on other recordings where there are some, else in these windows.
#[pyfunction]
pub(crate) fn validate<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    fit: &PyFit,
    windows: Vec<(f64, f64)>,
    experiments: Option<Vec<ExperimentFields>>,
) -> PyResult<Bound<'py, PyDict>> {
    let set = match experiments {
        Some(given) => ValidationSet::Experiments(self::experiments(py, calibration, given)?),
        None => ValidationSet::Windows(windows),
    };
    let fit = fit.inner.clone();
    let validation = calibration
        .compute(py, move |calibration, cancelled| calibration.validate_until(&fit, &set, cancelled))?;
    to_python(py, &validation)
}

/// The fields of `pydfo.Validation`.
pub(crate) fn to_python<'py>(py: Python<'py>, validation: &Validation) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    let values = PyDict::new(py);
    for (name, value) in validation.names.iter().zip(&validation.x) {
        values.set_item(name, value)?;
    }
    fields.set_item("parameters", values)?;
    fields.set_item("n", validation.n)?;
    fields.set_item("rms", validation.rms)?;
    fields.set_item("start_rms", validation.start_rms)?;
    fields.set_item("scaled_rms", validation.scaled_rms())?;
    fields.set_item("n_simulations", validation.n_simulations)?;
    fields.set_item("stats", Counts::new(&validation.stats))?;
    fields.set_item("text", validation.to_string())?;
    let outputs = validation.outputs.iter().map(|output| of_output(py, output));
    fields.set_item("outputs", outputs.collect::<PyResult<Vec<_>>>()?)?;
    Ok(fields)
}

/// The fields of `pydfo.ValidatedOutput`.
fn of_output<'py>(py: Python<'py>, output: &ValidatedOutput) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    fields.set_item("experiment", &output.fit.experiment)?;
    fields.set_item("variable", &output.fit.variable)?;
    fields.set_item("column", &output.fit.column)?;
    fields.set_item("unit", &output.fit.unit)?;
    fields.set_item("n", output.fit.n)?;
    fields.set_item("rms", output.fit.rms)?;
    fields.set_item("start_rms", output.fit.start_rms)?;
    fields.set_item("fit_percent", output.fit.fit_percent)?;
    fields.set_item("time", PyArray1::from_slice(py, &output.times))?;
    fields.set_item("measured", PyArray1::from_slice(py, &output.measured))?;
    fields.set_item("simulated", PyArray1::from_vec(py, output.simulated()))?;
    fields.set_item("residuals", PyArray1::from_slice(py, &output.residuals))?;
    let at_start = output.start_residuals.as_deref().map(|r| PyArray1::from_slice(py, r));
    fields.set_item("start_residuals", at_start)?;
    Ok(fields)
}
