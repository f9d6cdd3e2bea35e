//! Experiments as users describe them by name: one record for files and the command line. A recording is the
//! path of a CSV file.

use crate::data::{CsvRequest, Data, ParameterSet, how_to_convert};
use crate::error::CalibrationError;
use crate::problem::experiment::{Experiment, InitialState, OutputScale, STEADY, Sigma, Weight};
use crate::problem::input::ColumnRecord;
use crate::problem::parameter::Parameter;
#[cfg(feature = "schema")]
use crate::problem::schema::{
    InitialStates, InputRecord, NumberOr, OutputWeight, Pairs, StartValues, Weights,
};
use base::RunContext;
use dfo::{Record, RecordError, Value, read_record};
use fmi::SteadyStart;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// Name that stands for all states without another initial value.
const OTHERS: &str = "*";

/// Description of an experiment by name; see [`Experiment::from_record`].
#[derive(Debug, Default, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ExperimentRecord {
    /// Name in results; default: the name of the recording.
    name: Option<String>,
    /// Path of the CSV file with the recording.
    data: Option<PathBuf>,
    /// The column of times, if it is not called `time`.
    time: Option<String>,
    /// The column that measured each output, variable = column; a list of pairs; or a list of names if
    /// columns and variables have the same names.
    #[cfg_attr(feature = "schema", schemars(with = "Pairs<String>"))]
    outputs: Value,
    /// A number, a column or a scale for each output, which multiplies its residuals; or a scale for all
    /// outputs.
    #[cfg_attr(feature = "schema", schemars(with = "Weights"))]
    weights: Value,
    /// The known standard deviation of the noise of each output: a number, a column, or a function of
    /// the simulated value such as `a + b*abs(y)`; `log` compares logarithms.
    #[cfg_attr(feature = "schema", schemars(with = "Pairs<OutputWeight>"))]
    sigma: Value,
    /// The column that drives each input, a column with `hold`, or its constant value.
    #[cfg_attr(feature = "schema", schemars(with = "Pairs<NumberOr<InputRecord>>"))]
    inputs: Value,
    /// Values of other parameters and start values of variables, or the path of an SSP parameter file (.ssv).
    #[cfg_attr(feature = "schema", schemars(with = "StartValues"))]
    start_values: Value,
    /// `steady` for a start from steady state, or initial values of states: a number, `measured`, `measured:`
    /// and the name of an output, or a parameter of this experiment only.
    #[cfg_attr(feature = "schema", schemars(with = "InitialStates"))]
    initial_states: Value,
    /// Longest approach to steady state; default: 1000 times the simulated time span.
    steady_limit: Option<f64>,
    /// Windows in which measurements count, each from and to. All times are in the time unit of the model,
    /// usually s.
    windows: Vec<(f64, f64)>,
    /// Warm-up after the start of the simulation that is not compared.
    warm_up: Option<f64>,
    /// Start time of the simulation.
    start_time: Option<f64>,
    /// End of the simulation of a scenario; default: the last row of the data, otherwise the stop time of the
    /// model.
    final_time: Option<f64>,
    /// Factor of the objective in a scenario; default: 1.
    weight: Option<f64>,
    /// The column that selects the rows in which measurements count.
    mask: Option<String>,
    /// Interval over which means are taken.
    resample: Option<f64>,
    /// Delays of outputs and inputs.
    #[cfg_attr(feature = "schema", schemars(with = "Pairs<f64>"))]
    delays: Value,
    /// Keeps the first and last recorded values of inputs outside their recordings.
    hold_inputs: bool,
}

impl Experiment {
    /// Creates the experiment of a record and reads its recording, unless the context has been interrupted.
    /// The methods of [`Experiment`] explain the fields:
    ///
    /// - `data`: the path of a CSV file, relative to `folder`; `time`, the name of its column of times;
    ///   `mask`, the column that selects the rows in which measurements count; `resample`, the interval over
    ///   which means are taken;
    /// - `outputs`: the column of each variable. Use a list of pairs if their order matters. Use a list of
    ///   names if columns and variables have the same names;
    /// - `weights`: a number, a column, or `range`, `mean` or `sd` for an output variable or for all outputs;
    /// - `sigma`: the known standard deviation of the noise of an output variable, as a number, a column, an
    ///   [`ErrorModel`](crate::ErrorModel) such as `0.1 + 0.05*abs(y)`, or `log` for log-normal noise. It
    ///   replaces the weight, see [`Weight::of_sigma`];
    /// - `inputs`: the column of a variable, its constant value, or a column whose values are held between
    ///   the rows: `{ column = "u", hold = true }`;
    /// - `initial_states`: a number, `measured`, `measured:` and the name of an output, or the record of a
    ///   parameter; `steady` for all states, or for `*`, the other states; `steady_limit`, the longest
    ///   approach to steady state;
    /// - `start_values`: a value for each variable, or the path of an SSP parameter file;
    /// - `name`, `windows`, `warm_up`, `start_time`, `delays`, `hold_inputs`;
    /// - `final_time` and `weight` of a [scenario](crate::Design), which needs no data.
    ///
    /// # Errors
    /// Returns an error if a field is unknown or has an invalid value, and the errors of [`Data::read_csv`].
    pub fn from_record(
        record: &Record,
        folder: &Path,
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        if let Some(sheet) = record.get("sheet") {
            let sheet = sheet.read::<String>("sheet")?;
            let workbook: String =
                record.get("data").and_then(|data| data.read("data").ok()).unwrap_or_default();
            let message = format!(
                "sheet = '{sheet}': only Python reads workbooks; the data of a problem file are CSV files. {}",
                how_to_convert(&workbook, Some(&sheet))
            );
            return Err(RecordError::message(message).into());
        }
        let record: ExperimentRecord = read_record(record, "field of an experiment")?;
        let outputs: Vec<(String, String)> = read_pairs(&record.outputs, "outputs")?;
        let inputs = pairs(&record.inputs, "inputs")?
            .into_iter()
            .map(|(input, value)| Ok((source(&value, &input)?, input)));
        let inputs = inputs.collect::<Result<Vec<(Source, String)>, RecordError>>()?;
        let mut weights = weights(&record.weights, &outputs)?;
        for (variable, value) in pairs(&record.sigma, "sigma")? {
            let column =
                outputs.iter().find(|(output, _)| *output == variable).map_or("", |(_, column)| column);
            let sigma = match &value {
                Value::Text(text) => Weight::of_sigma(text, column)?,
                number => Sigma::Constant(number.read(&variable)?).into(),
            };
            for weight_of_output in of_output(&mut weights, &outputs, &variable, "sigma")? {
                if !matches!(weight_of_output, Weight::Constant(1.0)) {
                    let message =
                        format!("output '{variable}' has a weight and a sigma. Specify one of them");
                    return Err(RecordError::message(message).into());
                }
                *weight_of_output = sigma.clone();
            }
        }

        let measured: Vec<&str> = outputs.iter().map(|(_, column)| column.as_str()).collect();
        let weighing = weights.iter().filter_map(|weight| weight.column().map(str::to_owned));
        let driving = inputs.iter().filter_map(|(source, _)| match source {
            Source::Column { column, .. } => Some(column.clone()),
            Source::Constant(_) => None,
        });
        let columns: Vec<String> = measured
            .iter()
            .map(|&c| c.to_owned())
            .chain(weighing)
            .chain(driving)
            .chain(record.mask.clone())
            .collect();
        let is_scenario = outputs.is_empty();
        let mut data = match record.data {
            Some(path) => {
                // The criteria of a scenario may refer to any column.
                let columns = (!is_scenario).then_some(&columns[..]);
                let request = CsvRequest { time: record.time.as_deref(), columns, context: *context };
                Data::read_csv(folder.join(path), request)?
            }
            None if is_scenario && columns.is_empty() => Data::default(),
            None => {
                return Err(RecordError::message("data is missing. Specify the path of a CSV file").into());
            }
        };
        if let Some(by) = &record.mask {
            data = data.masked_by(&measured, by)?;
        }

        let mut experiment = Self::new(data);
        experiment.name = record.name;
        experiment.resample = record.resample;
        for ((variable, column), weight) in outputs.into_iter().zip(weights) {
            experiment = experiment.weighted_output(variable, column, weight);
        }
        for (source, input) in inputs {
            experiment = match source {
                Source::Column { column, hold: true } => experiment.held_input(input, column),
                Source::Column { column, hold: false } => experiment.input(input, column),
                Source::Constant(value) => experiment.constant_input(input, value),
            };
        }
        match &record.start_values {
            Value::Text(file) => {
                experiment = experiment.parameter_set(ParameterSet::read(folder.join(file))?);
            }
            values => {
                for (variable, value) in pairs(values, "start_values")? {
                    experiment = experiment.start_value(&variable, model_value(&value, &variable)?);
                }
            }
        }
        let is_steady = |word: &Value| matches!(word, Value::Text(text) if text.eq_ignore_ascii_case(STEADY));
        let (mut given, mut steady) = (Vec::new(), is_steady(&record.initial_states));
        if !steady {
            given = pairs(&record.initial_states, "initial_states")?;
            steady = given.iter().any(|(state, word)| state == OTHERS && is_steady(word));
            given.retain(|(state, word)| state != OTHERS || !is_steady(word));
        }
        if steady {
            experiment = experiment.steady_start(SteadyStart { limit: record.steady_limit });
        } else if record.steady_limit.is_some() {
            let message = "steady_limit requires initial_states = \"steady\"";
            return Err(RecordError::message(message).into());
        }
        for (state, initial) in given {
            experiment = experiment.initial_state(&state, initial_state(&initial, &state)?);
        }
        experiment.windows = record.windows;
        experiment.warm_up = record.warm_up;
        experiment.start_time = record.start_time;
        (experiment.final_time, experiment.weight) = (record.final_time, record.weight);
        experiment.hold_inputs = record.hold_inputs;
        experiment.delays = read_pairs(&record.delays, "delays")?;
        Ok(experiment)
    }
}

/// Source of the values of an input.
enum Source {
    Column { column: String, hold: bool },
    Constant(f64),
}

fn source(value: &Value, input: &str) -> Result<Source, RecordError> {
    match value {
        Value::Text(column) => Ok(Source::Column { column: column.clone(), hold: false }),
        Value::Record(fields) => {
            let ColumnRecord { column, hold } = read_record(fields, "field of an input")?;
            Ok(Source::Column { column: column.unwrap_or_else(|| input.to_owned()), hold })
        }
        value => value.read(input).map(Source::Constant).map_err(|_| {
            RecordError::message(format!(
                "inputs: '{input}' = {value} must be the name of a column, {{ column = \"name\", hold = true }}, or a number"
            ))
        }),
    }
}

/// Returns the weight of each output.
fn weights(given: &Value, outputs: &[(String, String)]) -> Result<Vec<Weight>, CalibrationError> {
    if let Value::Text(scale) = given {
        let scale = OutputScale::named(scale)?;
        return Ok(vec![Weight::Inverse(scale); outputs.len()]);
    }
    let mut weights = vec![Weight::Constant(1.0); outputs.len()];
    for (variable, value) in pairs(given, "weights")? {
        let weight = match &value {
            Value::Text(name) => Weight::named(name),
            number => Weight::Constant(number.read(&variable)?),
        };
        for weight_of_output in of_output(&mut weights, outputs, &variable, "weight")? {
            *weight_of_output = weight.clone();
        }
    }
    Ok(weights)
}

/// Returns the weights of an output variable.
fn of_output<'w>(
    weights: &'w mut [Weight],
    outputs: &[(String, String)],
    variable: &str,
    field: &str,
) -> Result<Vec<&'w mut Weight>, RecordError> {
    let matching = weights.iter_mut().zip(outputs).filter(|(_, (output, _))| output == variable);
    let matching: Vec<&mut Weight> = matching.map(|(matching, _)| matching).collect();
    if matching.is_empty() {
        let available: Vec<&String> = outputs.iter().map(|(variable, _)| variable).collect();
        return Err(RecordError::unknown(&format!("output for the {field}"), variable, &available));
    }
    Ok(matching)
}

fn initial_state(value: &Value, state: &str) -> Result<InitialState, CalibrationError> {
    match value {
        Value::Text(word) => InitialState::named(state, word),
        Value::Record(fields) => {
            let mut fields = fields.clone();
            // The name is ignored, but a parameter requires one.
            fields.entry("name".to_owned()).or_insert_with(|| Value::Text(state.to_owned()));
            Parameter::from_record(&fields).map(InitialState::from)
        }
        value => value.read(state).map(InitialState::Value).map_err(|_| {
            let message = format!(
                "initial_states: '{state}' = {value} must be a number, 'measured', or a parameter with start, lower and upper"
            );
            RecordError::message(message).into()
        }),
    }
}

/// Converts a value to a value of a variable of the model.
fn model_value(value: &Value, variable: &str) -> Result<fmi::Value, RecordError> {
    Ok(match value {
        Value::Flag(truth) => fmi::Value::Boolean(*truth),
        Value::Count(count) => fmi::Value::Integer(i128::from(*count)),
        Value::Negative(number) => fmi::Value::Integer(i128::from(*number)),
        Value::Number(number) => fmi::Value::Real(*number),
        Value::Text(text) => fmi::Value::String(text.clone()),
        Value::List(items) => {
            fmi::Value::Array(items.iter().map(|item| model_value(item, variable)).collect::<Result<_, _>>()?)
        }
        other => {
            let message = format!("start_values: '{variable}' = {other} is not a value of a variable");
            return Err(RecordError::message(message));
        }
    })
}

/// Returns names and values from a record, a list of pairs, or a list of names that are also their values.
fn pairs(given: &Value, name: &str) -> Result<Vec<(String, Value)>, RecordError> {
    let pair = |item: &Value| match item {
        Value::Text(name) => Some((name.clone(), item.clone())),
        Value::List(pair) => match &pair[..] {
            [Value::Text(name), value] => Some((name.clone(), value.clone())),
            _ => None,
        },
        _ => None,
    };
    let found = match given {
        Value::Nothing => Some(Vec::new()),
        Value::Record(fields) => Some(fields.clone().into_iter().collect()),
        Value::List(items) => items.iter().map(pair).collect(),
        _ => None,
    };
    found.ok_or_else(|| {
        RecordError::message(format!(
            "{name} must assign a value to each name, {{name = value, ...}}, not {given}"
        ))
    })
}

/// Returns names and values, with the values converted to a type.
fn read_pairs<T: DeserializeOwned>(given: &Value, name: &str) -> Result<Vec<(String, T)>, RecordError> {
    let read = |(item, value): (String, Value)| {
        let read = value.read(&format!("{name}: '{item}'"))?;
        Ok((item, read))
    };
    pairs(given, name)?.into_iter().map(read).collect()
}
