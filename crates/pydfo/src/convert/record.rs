//! Conversion of the options that a Python user gives by name into the record that the crates read. This is
//! the only place where Python objects become plain data.

use crate::convert::error;
use calibration::{CalibrationError, Parameter, SimulationSettings};
use dfo::{AnyMethod, RecordError, RequestedRun, RunOptions, Value};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyMapping, PyString};
use serde::de::DeserializeOwned;
use std::time::Duration;

/// Values by name, and the dict they come from.
pub(crate) struct PyRecord {
    pub(crate) values: dfo::Record,
    given: Py<PyDict>,
}

impl<'a, 'py> FromPyObject<'a, 'py> for PyRecord {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let given = object.cast::<PyDict>()?;
        let value =
            |(name, value): (Bound<'py, PyAny>, Bound<'py, PyAny>)| Ok((name.extract()?, plain(&value)));
        let values = given.iter().map(value).collect::<PyResult<_>>()?;
        Ok(Self { values, given: given.to_owned().unbind() })
    }
}

impl PyRecord {
    /// Reads the run of the record for `n_parameters` parameters. `default` applies to options that are not
    /// given.
    pub(crate) fn run(
        &self,
        py: Python<'_>,
        default: RunOptions<AnyMethod>,
        n_parameters: usize,
    ) -> PyResult<RequestedRun> {
        RequestedRun::new(default, &self.values, n_parameters).map_err(|e| self.error(py, &e))
    }

    /// Reads the settings of simulations.
    pub(crate) fn settings(&self, py: Python<'_>) -> PyResult<SimulationSettings> {
        SimulationSettings::from_record(&self.values).map_err(|e| self.refused(py, &e))
    }

    /// Reads the parameter of the record.
    pub(crate) fn parameter(&self, py: Python<'_>) -> PyResult<Parameter> {
        Parameter::from_record(&self.values).map_err(|e| match &e {
            CalibrationError::Record(e) => self.refused(py, e),
            _ => error::calibration(py, &e),
        })
    }

    /// Converts an error of the optimiser. An error about a value of the record shows the value as the user
    /// wrote it.
    pub(crate) fn error(&self, py: Python<'_>, error: &dfo::Error) -> PyErr {
        match error {
            dfo::Error::Record(e) => self.refused(py, e),
            _ => error::optimiser(py, error),
        }
    }

    fn refused(&self, py: Python<'_>, error: &RecordError) -> PyErr {
        let given = error.name().and_then(|name| self.given.bind(py).get_item(name).ok().flatten());
        let shown = given.and_then(|given| {
            py.import("pydfo._args.text").ok()?.call_method1("show", (given,)).ok()?.extract::<String>().ok()
        });
        error::refused(error, &shown.map_or_else(|| error.to_string(), |given| error.with_given(&given)))
    }
}

/// Reads a string given in Python for the argument `name`.
pub(crate) fn read<T: DeserializeOwned>(name: &str, given: &str) -> PyResult<T> {
    Value::Text(given.to_owned()).read(name).map_err(|e| error::refused(&e, &e.to_string()))
}

/// Converts a Python value to plain data.
fn plain(value: &Bound<'_, PyAny>) -> Value {
    if value.is_none() {
        Value::Nothing
    } else if let Ok(flag) = value.cast::<PyBool>() {
        Value::Flag(flag.is_true())
    } else if let Ok(text) = value.cast::<PyString>() {
        text.extract().map_or_else(|_| other(value), Value::Text)
    } else if let Ok(number) = value.cast::<PyFloat>() {
        Value::Number(number.value())
    } else if let Ok(list) = value.call_method0("tolist") {
        plain(&list)
    } else if let Ok(count) = value.extract::<u64>() {
        Value::Count(count)
    } else if let Ok(number) = value.extract::<i64>() {
        Value::Negative(number)
    } else if let Ok(number) = value.extract::<f64>() {
        Value::Number(number)
    } else if let Ok(fields) = value.cast::<PyMapping>() {
        let field = |pair: Bound<'_, PyAny>| {
            let (name, value): (String, Bound<'_, PyAny>) = pair.extract()?;
            Ok((name, plain(&value)))
        };
        let fields = fields.items().and_then(|pairs| pairs.iter().map(field).collect::<PyResult<_>>());
        fields.map_or_else(|_| other(value), Value::Record)
    } else if let Ok(items) = value.extract::<Vec<Bound<'_, PyAny>>>() {
        Value::List(items.iter().map(plain).collect())
    } else {
        other(value)
    }
}

/// Converts an object that is not plain data to its representation.
fn other(value: &Bound<'_, PyAny>) -> Value {
    Value::Other(value.repr().map_or_else(|_| "?".to_owned(), |shown| shown.to_string()))
}

/// Reads a limit of wall-clock time in s; None and infinity mean no limit.
pub(crate) fn time_limit(name: &str, seconds: Option<f64>) -> PyResult<Option<Duration>> {
    let seconds = seconds.map_or(Value::Nothing, Value::Number);
    seconds.read_time(name).map_err(|e| error::refused(&e, &e.to_string()))
}
