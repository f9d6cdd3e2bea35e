//! Experiments as users describe them by name: one record for files and the command line, in which a
//! recording is the path of a CSV file.

use crate::data::{CsvRequest, Data};
use crate::error::CalibrationError;
use crate::problem::experiment::{Experiment, InitialState, OutputScale, Weight};
use crate::problem::parameter::Parameter;
use base::RunContext;
use dfo::{Record, RecordError, Value};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// Fields of the record.
const FIELDS: [&str; 15] = [
    "name",
    "data",
    "time",
    "outputs",
    "weights",
    "inputs",
    "start_values",
    "initial_states",
    "windows",
    "warm_up",
    "start_time",
    "mask",
    "resample",
    "delays",
    "hold_inputs",
];

impl Experiment {
    /// The experiment of a record, with its recording, which is read unless the context is over. See the
    /// methods of [`Experiment`] for what is meant:
    ///
    /// - `data`: the path of a CSV file, from `folder` on where it is relative, and `time`, the name of its
    ///   column of times; `mask`, the column that says in which rows measurements count; `resample`, the
    ///   interval over which means are taken;
    /// - `outputs`: the column of each variable. Where their order counts, a list of pairs; where columns are
    ///   called as the variables, a list of names;
    /// - `weights`: a number or a column for a variable among the outputs, or `range`, `mean` or `sd` for all
    ///   of them;
    /// - `inputs`: the column of a variable, or its constant value;
    /// - `initial_states`: a number, `measured`, or the record of a parameter;
    /// - `name`, `start_values`, `windows`, `warm_up`, `start_time`, `delays`, `hold_inputs`.
    ///
    /// # Errors
    /// A field that there is not, or a value that it cannot have; as [`Data::read_csv`].
    pub fn asked(record: &Record, folder: &Path, context: &RunContext<'_>) -> Result<Self, CalibrationError> {
        if let Some(name) = record.keys().find(|name| !FIELDS.contains(&name.as_str())) {
            return Err(RecordError::unknown("field of an experiment", name, &FIELDS).into());
        }
        let outputs: Vec<(String, String)> = read_pairs(record, "outputs")?;
        let inputs =
            pairs(record, "inputs")?.into_iter().map(|(input, value)| Ok((source(&value, &input)?, input)));
        let inputs = inputs.collect::<Result<Vec<(Source, String)>, RecordError>>()?;
        let weights = weights(record, &outputs)?;
        let mask: Option<String> = read(record, "mask")?.flatten();

        let measured: Vec<&str> = outputs.iter().map(|(_, column)| column.as_str()).collect();
        let weighing = weights.iter().filter_map(|weight| match weight {
            Weight::Column(column) => Some(column.clone()),
            _ => None,
        });
        let driving = inputs.iter().filter_map(|(source, _)| match source {
            Source::Column(column) => Some(column.clone()),
            Source::Constant(_) => None,
        });
        let columns: Vec<String> = measured
            .iter()
            .map(|&c| c.to_owned())
            .chain(weighing)
            .chain(driving)
            .chain(mask.clone())
            .collect();
        let path: PathBuf = read(record, "data")?
            .ok_or_else(|| RecordError::message("data is missing: give the path of a CSV file"))?;
        let time: Option<String> = read(record, "time")?.flatten();
        let request = CsvRequest { time: time.as_deref(), columns: Some(&columns), context: *context };
        let mut data = Data::read_csv(folder.join(path), request)?;
        if let Some(by) = &mask {
            data = data.masked_by(&measured, by)?;
        }
        if let Some(interval) = read(record, "resample")?.flatten() {
            data = data.resampled(interval)?;
        }

        let mut experiment = Self::new(data);
        experiment.name = read(record, "name")?.flatten();
        for ((variable, column), weight) in outputs.into_iter().zip(weights) {
            experiment = experiment.weighted_output(variable, column, weight);
        }
        for (source, input) in inputs {
            experiment = match source {
                Source::Column(column) => experiment.input(input, column),
                Source::Constant(value) => experiment.constant_input(input, value),
            };
        }
        for (variable, value) in pairs(record, "start_values")? {
            experiment = experiment.start_value(&variable, model_value(&value, &variable)?);
        }
        for (state, initial) in pairs(record, "initial_states")? {
            experiment = experiment.initial_state(&state, initial_state(&initial, &state)?);
        }
        experiment.windows = read(record, "windows")?.unwrap_or_default();
        experiment.warm_up = read(record, "warm_up")?.flatten();
        experiment.start_time = read(record, "start_time")?.flatten();
        experiment.hold_inputs = read(record, "hold_inputs")?.unwrap_or_default();
        experiment.delays = read_pairs(record, "delays")?;
        Ok(experiment)
    }
}

/// Source of the values of an input.
enum Source {
    Column(String),
    Constant(f64),
}

fn source(value: &Value, input: &str) -> Result<Source, RecordError> {
    match value {
        Value::Text(column) => Ok(Source::Column(column.clone())),
        value => value.read(input).map(Source::Constant).map_err(|_| {
            RecordError::message(format!(
                "inputs: '{input}' = {value} must be the name of a column, or a number"
            ))
        }),
    }
}

/// The weight of each output.
fn weights(record: &Record, outputs: &[(String, String)]) -> Result<Vec<Weight>, CalibrationError> {
    if let Some(Value::Text(scale)) = record.get("weights") {
        let scale = OutputScale::named(scale)?;
        return Ok(vec![Weight::Inverse(scale); outputs.len()]);
    }
    let mut weights = vec![Weight::Constant(1.0); outputs.len()];
    for (variable, value) in pairs(record, "weights")? {
        let weight = match &value {
            Value::Text(column) => Weight::Column(column.clone()),
            number => Weight::Constant(number.read(&variable)?),
        };
        let mut own =
            weights.iter_mut().zip(outputs).filter(|(_, (output, _))| *output == variable).peekable();
        if own.peek().is_none() {
            let known: Vec<&String> = outputs.iter().map(|(variable, _)| variable).collect();
            return Err(RecordError::unknown("output for the weight", &variable, &known).into());
        }
        own.for_each(|(own, _)| *own = weight.clone());
    }
    Ok(weights)
}

fn initial_state(value: &Value, state: &str) -> Result<InitialState, CalibrationError> {
    match value {
        Value::Text(word) if word.eq_ignore_ascii_case("measured") => Ok(InitialState::Measured),
        Value::Record(fields) => {
            let mut fields = fields.clone();
            // It plays no part.
            fields.entry("name".to_owned()).or_insert_with(|| Value::Text(state.to_owned()));
            Parameter::asked(&fields).map(InitialState::from)
        }
        value => value.read(state).map(InitialState::Value).map_err(|_| {
            let message = format!(
                "initial_states: '{state}' = {value} must be a number, 'measured', or a parameter with start, lower and upper"
            );
            RecordError::message(message).into()
        }),
    }
}

/// A value for a variable of the model.
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
            let message = format!("start_values: '{variable}' = {other} is no value of a variable");
            return Err(RecordError::message(message));
        }
    })
}

/// The value of a field, if it is given.
fn read<T: DeserializeOwned>(record: &Record, name: &str) -> Result<Option<T>, RecordError> {
    record.get(name).map(|value| value.read(name)).transpose()
}

/// Names and their values: of a record, of a list of pairs, of a list of names that stand for themselves.
fn pairs(record: &Record, name: &str) -> Result<Vec<(String, Value)>, RecordError> {
    let pair = |item: &Value| match item {
        Value::Text(own) => Some((own.clone(), item.clone())),
        Value::List(pair) => match &pair[..] {
            [Value::Text(name), value] => Some((name.clone(), value.clone())),
            _ => None,
        },
        _ => None,
    };
    let given = record.get(name).unwrap_or(&Value::Nothing);
    let found = match given {
        Value::Nothing => Some(Vec::new()),
        Value::Record(fields) => Some(fields.clone().into_iter().collect()),
        Value::List(items) => items.iter().map(pair).collect(),
        _ => None,
    };
    found.ok_or_else(|| {
        RecordError::message(format!(
            "{name} must give a value to each name, {{name = value, ...}}, not {given}"
        ))
    })
}

/// The same with values of a type.
fn read_pairs<T: DeserializeOwned>(record: &Record, name: &str) -> Result<Vec<(String, T)>, RecordError> {
    let read = |(own, value): (String, Value)| {
        let read = value.read(&format!("{name}: '{own}'"))?;
        Ok((own, read))
    };
    pairs(record, name)?.into_iter().map(read).collect()
}
