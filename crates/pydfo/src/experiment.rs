//! Parameters, experiments and settings of a calibration, from the fields of their Python classes.

use crate::settings::time_limit;
use crate::words::word;
use crate::{error, fmu_error, values};
use calibration::{CalibrationError, Data, Experiment, Parameter, SimulationSettings};
use fmi::FmiError;
use pyo3::prelude::*;
use std::path::PathBuf;

/// `pydfo.Parameter`, field by field.
#[derive(FromPyObject)]
pub(crate) struct ParameterFields {
    name: String,
    start: f64,
    lower: f64,
    upper: f64,
    scale: String,
    nominal: Option<f64>,
    kind: String,
    fixed: bool,
    local: bool,
}

impl ParameterFields {
    pub(crate) fn check(self, py: Python<'_>) -> PyResult<Parameter> {
        let scale = word("scale", &self.scale)?;
        let kind = word("kind", &self.kind)?;
        let mut parameter = Parameter::new(self.name, self.start)
            .bounds(self.lower, self.upper)
            .scale(scale)
            .kind(kind)
            .fixed(self.fixed)
            .local(self.local);
        if let Some(nominal) = self.nominal {
            parameter = parameter.nominal(nominal);
        }
        parameter.check().map_err(|e| error::calibration(py, &e))?;
        Ok(parameter)
    }
}

/// Checks the numbers of a `pydfo.Parameter`.
#[pyfunction]
pub(crate) fn check_parameter(py: Python<'_>, parameter: ParameterFields) -> PyResult<()> {
    parameter.check(py).map(|_| ())
}

/// `pydfo.Experiment`, field by field.
#[derive(FromPyObject)]
pub(crate) struct ExperimentFields {
    pub(crate) name: Option<String>,
    /// A CSV file; None: `columns`.
    path: Option<PathBuf>,
    columns: Vec<(String, Vec<f64>)>,
    /// Names of columns that are not among them.
    left_out: Vec<String>,
    /// Name of the column of times; None: "time".
    time: Option<String>,
    /// Variable, column, weight.
    outputs: Vec<(String, String, f64)>,
    /// Variable, column.
    inputs: Vec<(String, String)>,
    start_values: Vec<(String, Py<PyAny>)>,
    window: Option<(f64, f64)>,
    start_time: Option<f64>,
    /// Rows whose measurements count, or the column that says so.
    mask: Option<Vec<bool>>,
    mask_column: Option<String>,
    /// Interval in s over which means are taken.
    resample: Option<f64>,
}

/// `pydfo._experiment.Settings`, field by field.
#[derive(FromPyObject)]
pub(crate) struct SettingsFields {
    kind: String,
    max_time: Option<f64>,
    relative_tolerance: Option<f64>,
    solver: String,
    step_size: Option<f64>,
    max_step: Option<f64>,
    input_derivatives: bool,
    chattering: String,
    sharing: String,
}

impl SettingsFields {
    pub(crate) fn check(&self, py: Python<'_>) -> PyResult<SimulationSettings> {
        Ok(SimulationSettings {
            kind: self.kind.parse().map_err(|e| fmu_error::raise(py, &e))?,
            method: self.solver.parse().map_err(|e| fmu_error::raise(py, &FmiError::Options(e)))?,
            relative_tolerance: self.relative_tolerance,
            step_size: self.step_size,
            max_step: self.max_step,
            input_derivatives: Some(self.input_derivatives),
            timeout: time_limit("max_time", self.max_time)?,
            chattering: self.chattering.parse().map_err(|e| fmu_error::raise(py, &FmiError::Options(e)))?,
            sharing: self.sharing.parse().map_err(|e| fmu_error::raise(py, &e))?,
        })
    }
}

impl ExperimentFields {
    pub(crate) fn start_values(&self, py: Python<'_>, fmu: &fmi::Fmu) -> PyResult<Vec<(String, fmi::Value)>> {
        let given = self.start_values.iter().map(|(name, value)| (name.clone(), value.bind(py).clone()));
        values::all_from_python(py, fmu.description(), given)
    }

    pub(crate) fn experiment(
        self,
        start_values: Vec<(String, fmi::Value)>,
    ) -> Result<Experiment, CalibrationError> {
        let data = match (self.path, &self.time) {
            (Some(path), None) => Data::from_csv(path)?,
            (Some(path), Some(time)) => Data::from_csv_with_time(path, time)?,
            (None, time) => Data::from_table(self.columns, time.as_deref())?.left_out(self.left_out),
        };
        let measured: Vec<&str> = self.outputs.iter().map(|(_, column, _)| column.as_str()).collect();
        let data = match (&self.mask, &self.mask_column) {
            (Some(keep), _) => data.masked(&measured, keep)?,
            (None, Some(by)) => data.masked_by(&measured, by)?,
            (None, None) => data,
        };
        let data = match self.resample {
            Some(interval) => data.resampled(interval)?,
            None => data,
        };
        let mut experiment = Experiment::new(data);
        if let Some(name) = self.name {
            experiment = experiment.named(name);
        }
        for (variable, column, weight) in self.outputs {
            experiment = experiment.weighted_output(variable, column, weight);
        }
        for (variable, column) in self.inputs {
            experiment = experiment.input(variable, column);
        }
        for (variable, value) in start_values {
            experiment = experiment.start_value(variable, value);
        }
        if let Some((from, to)) = self.window {
            experiment = experiment.window(from, to);
        }
        if let Some(time) = self.start_time {
            experiment = experiment.start_time(time);
        }
        Ok(experiment)
    }
}
