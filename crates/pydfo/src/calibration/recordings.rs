//! Recordings of a calibration, and the inputs of a model found in them.

use crate::calibration::calibration_class::PyCalibration;
use crate::calibration::data_files::PyTable;
use crate::convert::error;
use crate::model::description::Fmu;
use calibration::{Data, Experiment, ParameterSet};
use numpy::PyArray1;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Variable, column, unit, values, and whether it is an input.
type Series<'py> = (String, String, Option<String>, Bound<'py, PyArray1<f64>>, bool);

/// Times, columns in use, windows.
type Recording<'py> = (Bound<'py, PyArray1<f64>>, Vec<Series<'py>>, Vec<(f64, f64)>);

/// Returns the recordings of a calibration, in the units of the model.
#[pyfunction]
pub(crate) fn recorded<'py>(py: Python<'py>, calibration: &PyCalibration) -> Vec<Recording<'py>> {
    let description = calibration.inner().fmu().description();
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
    calibration.inner().problem().experiments.iter().map(recording).collect()
}

/// Input, times, values.
type InputSeries<'py> = (String, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// Returns the columns of a recording (a CSV file or a table in memory) with the names of model inputs, in
/// the units of the model and with their times. Warns of inputs without a column, except those with start
/// values in `given` or in a parameter set.
#[pyfunction]
pub(crate) fn recorded_inputs<'py>(
    py: Python<'py>,
    fmu: &Bound<'py, Fmu>,
    path: Option<PathBuf>,
    table: Option<Bound<'py, PyTable>>,
    mut given: Vec<String>,
    parameter_set: Option<PathBuf>,
) -> PyResult<Vec<InputSeries<'py>>> {
    let bad = |e| error::calibration(py, &e);
    let data = match (path, table) {
        (_, Some(table)) => Ok(table.get().inner.clone()),
        (path, None) => Data::from_csv(path.unwrap_or_default()),
    };
    let description = fmu.get().fmu.description();
    // An unreadable parameter set is reported when it is applied.
    let set =
        parameter_set.and_then(|path| ParameterSet::read(path).and_then(|set| set.values(description)).ok());
    given.extend(set.into_iter().flatten().map(|(name, _)| name));
    let (data, pairs, warnings) =
        calibration::recorded_inputs(data.map_err(bad)?, description, &given).map_err(bad)?;
    for warning in warnings {
        error::warn_as(py, &py.get_type::<error::CalibrationWarning>(), &warning.to_string())?;
    }
    let series = |(variable, column): (String, String)| {
        let samples =
            data.time().iter().zip(data.column(&column).map_err(bad)?).filter(|(_, value)| !value.is_nan());
        let (times, values): (Vec<f64>, Vec<f64>) = samples.unzip();
        Ok((variable, PyArray1::from_vec(py, times), PyArray1::from_vec(py, values)))
    };
    pairs.into_iter().map(series).collect()
}
