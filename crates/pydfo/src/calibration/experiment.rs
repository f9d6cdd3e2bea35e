//! Parameters, experiments and settings of a calibration, from the fields of their Python classes.

use crate::calibration::data_files::PyTable;
use crate::convert::error;
use crate::convert::object;
use crate::convert::record::PyRecord;
use crate::convert::values;
use crate::model::inputs::{Callback, Callbacks};
use calibration::RunContext;
use calibration::{
    CalibrationError, CsvRequest, Data, Experiment, Goal, InitialState, OutputScale, Parameter, ParameterSet,
    Series, Sigma, Weight,
};
use fmi::SteadyStart;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;
use std::sync::Arc;

/// A `pydfo.Parameter`.
pub(crate) struct PyParameter(PyRecord);

impl<'a, 'py> FromPyObject<'a, 'py> for PyParameter {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        object.call_method0("_record")?.extract().map(Self)
    }
}

impl PyParameter {
    pub(crate) fn check(&self, py: Python<'_>) -> PyResult<Parameter> {
        self.0.parameter(py)
    }
}

/// Checks the fields of a `pydfo.Parameter` and fills in the defaults.
#[pyfunction]
pub(crate) fn check_parameter(py: Python<'_>, given: PyRecord) -> PyResult<Bound<'_, PyDict>> {
    let record = given.parameter(py)?.record().map_err(|e| error::calibration(py, &e))?;
    object::fields(py, &record)
}

/// True if a weight of this name is the inverse of a scale of the measurements, not a column.
#[pyfunction]
pub(crate) fn is_output_scale(name: &str) -> bool {
    OutputScale::named(name).is_ok()
}

/// True if a text given as sigma is an error model or the word "log", not a column.
#[pyfunction]
pub(crate) fn is_sigma_text(text: &str) -> bool {
    Weight::is_sigma(text)
}

/// True if an objective of a design is maximised.
#[pyfunction]
pub(crate) fn is_maximised(objective: &str) -> bool {
    objective.parse::<Goal>().is_ok_and(|goal| goal.is_maximum())
}

/// `pydfo.Experiment`, field by field.
#[derive(FromPyObject)]
pub(crate) struct ExperimentFields {
    pub(crate) name: Option<String>,
    /// Path of a CSV file; `None` if the data are in `table`.
    path: Option<PathBuf>,
    table: Option<Py<PyTable>>,
    /// Name of the time column of the file; default: "time".
    time: Option<String>,
    /// Variable, column, weight.
    outputs: Vec<(String, String, WeightFields)>,
    /// Variable and the source of its values.
    inputs: Vec<(String, InputFields)>,
    start_values: Vec<(String, Py<PyAny>)>,
    /// An SSP parameter file.
    parameter_set: Option<PathBuf>,
    initial_states: Vec<(String, StateFields)>,
    is_steady: bool,
    steady_limit: Option<f64>,
    windows: Vec<(f64, f64)>,
    warm_up: Option<f64>,
    start_time: Option<f64>,
    final_time: Option<f64>,
    weight: Option<f64>,
    /// Rows whose measurements count, or the column that marks them.
    mask: Option<Vec<bool>>,
    mask_column: Option<String>,
    /// Averaging interval in s.
    resample: Option<f64>,
    delays: Vec<(String, f64)>,
    hold_inputs: bool,
}

/// Weight of the residuals of an output.
#[derive(FromPyObject)]
enum WeightFields {
    #[pyo3(transparent)]
    Constant(f64),
    #[pyo3(transparent)]
    Column(String),
    /// Name of a scale; the weight is its inverse.
    #[pyo3(transparent)]
    Inverse((String,)),
    /// The word "sigma" and a known standard deviation.
    #[pyo3(transparent)]
    Sigma((String, SigmaFields)),
    #[pyo3(transparent)]
    Rows(Numbers),
}

/// Known standard deviation of the noise of an output.
#[derive(FromPyObject)]
enum SigmaFields {
    #[pyo3(transparent)]
    Constant(f64),
    /// A column, an error model or the word "log".
    #[pyo3(transparent)]
    Text(String),
    #[pyo3(transparent)]
    Rows(Numbers),
}

/// Numbers as bytes.
struct Numbers(Series);

impl<'a, 'py> FromPyObject<'a, 'py> for Numbers {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let bytes = object.cast::<PyBytes>()?;
        let words = bytes.as_bytes().as_chunks::<8>().0;
        Ok(Self(words.iter().map(|word| f64::from_ne_bytes(*word)).collect()))
    }
}

/// Source of the values of an input.
#[derive(FromPyObject)]
enum InputFields {
    #[pyo3(transparent)]
    Column(String),
    #[pyo3(transparent)]
    Held((String,)),
    #[pyo3(transparent)]
    Constant(f64),
    #[pyo3(transparent)]
    Function(Py<PyAny>),
}

/// Initial value of a state.
// The value exists only while it is read.
#[allow(clippy::large_enum_variant)]
#[derive(FromPyObject)]
enum StateFields {
    #[pyo3(transparent)]
    Value(f64),
    #[pyo3(transparent)]
    Word(String),
    #[pyo3(transparent)]
    Fitted(PyParameter),
}

/// The functions of time among the inputs: index of the experiment, variable, function.
pub(crate) type SignalFunctions = Vec<(usize, String, Py<PyAny>)>;

/// Parts of an experiment that come from Python objects, read with the interpreter lock held.
pub(crate) struct Resolved {
    start_values: Vec<(String, fmi::Value)>,
    initial_states: Vec<(String, InitialState)>,
    functions: Vec<(String, Arc<Callback>)>,
}

impl ExperimentFields {
    /// Reads the start values of the model and of local parameters.
    pub(crate) fn resolve(
        &mut self,
        py: Python<'_>,
        fmu: &fmi::Fmu,
        parameters: &[Parameter],
        callbacks: &mut Callbacks,
    ) -> PyResult<Resolved> {
        let of_parameter = |name: &str| parameters.iter().any(|p| p.is_local() && p.name() == name);
        let (matching, others): (Vec<_>, Vec<_>) =
            self.start_values.drain(..).partition(|(name, _)| of_parameter(name));
        let given = others.into_iter().map(|(name, value)| (name, value.into_bound(py)));
        let mut start_values = values::all_from_python(py, fmu.description(), given)?;
        for (name, value) in matching {
            let number: f64 = value.extract(py).map_err(|_| {
                let message = "its start value in an experiment must be a number".to_owned();
                error::calibration(py, &CalibrationError::Parameter { name: name.clone(), message })
            })?;
            start_values.push((name, fmi::Value::Real(number)));
        }
        let state = |(name, state): (String, StateFields)| {
            let state = match state {
                StateFields::Value(value) => InitialState::Value(value),
                StateFields::Word(word) => {
                    InitialState::named(&name, &word).map_err(|error| error::calibration(py, &error))?
                }
                StateFields::Fitted(fields) => InitialState::from(fields.check(py)?),
            };
            Ok((name, state))
        };
        let initial_states = self.initial_states.drain(..).map(state).collect::<PyResult<_>>()?;
        let functions = self.inputs.iter().filter_map(|(input, source)| match source {
            InputFields::Function(function) => Some((input.clone(), callbacks.add(function.clone_ref(py)))),
            _ => None,
        });
        Ok(Resolved { start_values, initial_states, functions: functions.collect() })
    }

    /// Names of the columns in use.
    fn columns(&self) -> Vec<String> {
        let measured = self.outputs.iter().map(|(_, column, _)| column);
        let weights = self.outputs.iter().filter_map(|(_, _, weight)| match weight {
            WeightFields::Column(name) if !is_output_scale(name) => Some(name),
            WeightFields::Sigma((_, SigmaFields::Text(text))) if !is_sigma_text(text) => Some(text),
            _ => None,
        });
        let driving = self.inputs.iter().filter_map(|(_, source)| match source {
            InputFields::Column(column) | InputFields::Held((column,)) => Some(column),
            _ => None,
        });
        measured.chain(weights).chain(driving).chain(&self.mask_column).cloned().collect()
    }

    /// Creates the experiment with its recording. The recording is read unless the context has ended.
    pub(crate) fn experiment(
        self,
        resolved: Resolved,
        context: &RunContext<'_>,
    ) -> Result<Experiment, CalibrationError> {
        let data = match (&self.path, &self.table) {
            (Some(path), _) => {
                let columns = self.columns();
                // The criteria of a scenario may refer to any column.
                let columns = (!self.outputs.is_empty()).then_some(&columns[..]);
                let request = CsvRequest { time: self.time.as_deref(), columns, context: *context };
                Data::read_csv(path, request)?
            }
            (None, Some(table)) => table.get().inner.clone(),
            (None, None) if self.outputs.is_empty() => Data::default(),
            (None, None) => return Err(CalibrationError::Setup("the recording is missing".to_owned())),
        };
        let measured: Vec<&str> = self.outputs.iter().map(|(_, column, _)| column.as_str()).collect();
        let data = match (&self.mask, &self.mask_column) {
            (Some(keep), _) => data.masked(&measured, keep)?,
            (None, Some(by)) => data.masked_by(&measured, by)?,
            (None, None) => data,
        };
        let mut experiment = Experiment::new(data).windows(self.windows).hold_inputs(self.hold_inputs);
        if let Some(name) = self.name {
            experiment = experiment.named(name);
        }
        if let Some(interval) = self.resample {
            experiment = experiment.resample(interval);
        }
        for (variable, column, weight) in self.outputs {
            let weight = match weight {
                WeightFields::Constant(weight) => Weight::Constant(weight),
                WeightFields::Column(name) => Weight::named(&name),
                WeightFields::Inverse((name,)) => Weight::Inverse(OutputScale::named(&name)?),
                WeightFields::Sigma((_, SigmaFields::Constant(sigma))) => Sigma::Constant(sigma).into(),
                WeightFields::Sigma((_, SigmaFields::Text(text))) => Weight::of_sigma(&text, &column)?,
                WeightFields::Sigma((_, SigmaFields::Rows(Numbers(sigmas)))) => Sigma::Rows(sigmas).into(),
                WeightFields::Rows(Numbers(weights)) => Weight::Rows(weights),
            };
            experiment = experiment.weighted_output(variable, column, weight);
        }
        let mut functions = resolved.functions.into_iter();
        for (variable, source) in self.inputs {
            experiment = match source {
                InputFields::Column(column) => experiment.input(variable, column),
                InputFields::Held((column,)) => experiment.held_input(variable, column),
                InputFields::Constant(value) => experiment.constant_input(variable, value),
                InputFields::Function(_) => match functions.next() {
                    Some((_, callback)) => experiment.function_input(variable, move |t| callback.value(t, 0)),
                    None => experiment,
                },
            };
        }
        for (variable, value) in resolved.start_values {
            experiment = experiment.start_value(variable, value);
        }
        if let Some(path) = &self.parameter_set {
            experiment = experiment.parameter_set(ParameterSet::read(path)?);
        }
        for (state, initial) in resolved.initial_states {
            experiment = experiment.initial_state(state, initial);
        }
        if self.is_steady {
            experiment = experiment.steady_start(SteadyStart { limit: self.steady_limit });
        }
        for (variable, delay) in self.delays {
            experiment = experiment.delay(variable, delay);
        }
        if let Some(seconds) = self.warm_up {
            experiment = experiment.warm_up(seconds);
        }
        if let Some(time) = self.start_time {
            experiment = experiment.start_time(time);
        }
        if let Some(time) = self.final_time {
            experiment = experiment.final_time(time);
        }
        if let Some(weight) = self.weight {
            experiment = experiment.scenario_weight(weight);
        }
        Ok(experiment)
    }
}
