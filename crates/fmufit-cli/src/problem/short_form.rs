//! Short form of a problem on the command line: a model, a recording and names.

use super::document::value_of_text;
use crate::arguments::Problem;
use crate::error::Error;
use dfo::{Record, Value};
use std::path::Path;

/// Splits `name=value` into name and value.
pub(crate) fn assignment(text: &str, what: &str) -> Result<(String, String), Error> {
    match text.split_once('=') {
        Some((name, value)) if !name.trim().is_empty() => {
            Ok((name.trim().to_owned(), value.trim().to_owned()))
        }
        _ => Err(Error::input(format!("'{text}': expected {what}"))),
    }
}

/// Splits several assignments. Each name may occur once.
pub(crate) fn assignments(given: &[String], what: &str) -> Result<Vec<(String, String)>, Error> {
    let mut pairs: Vec<(String, String)> = Vec::with_capacity(given.len());
    for text in given {
        let (name, value) = assignment(text, what)?;
        if let Some((_, first)) = pairs.iter().find(|(earlier, _)| *earlier == name) {
            return Err(Error::input(format!("'{name}' is specified twice: {first} and {value}")));
        }
        pairs.push((name, value));
    }
    Ok(pairs)
}

/// Returns the options given as `name=value`.
pub(crate) fn options(given: &[String]) -> Result<Vec<(String, Value)>, Error> {
    let pairs = assignments(given, "name=value")?;
    let is_given = |word: &str| pairs.iter().any(|(name, _)| name == word);
    if is_given("rng") && is_given("seed") {
        return Err(Error::input("rng and seed are the same option; specify only one of them"));
    }
    Ok(pairs.into_iter().map(|(name, value)| (name, value_of_text(&value))).collect())
}

/// Converts a path to its form in a problem.
pub(crate) fn text_of(path: &Path) -> Result<String, Error> {
    path.to_str().map(str::to_owned).ok_or_else(|| {
        let path = path.display();
        Error::input(format!("{path}: the name is not valid UTF-8; rename the file"))
    })
}

/// Returns the record of a parameter `name=start:lower:upper`. The bounds are optional.
fn parameter(text: &str) -> Result<Value, Error> {
    const FORM: &str = "name=start:lower:upper, as in --parameter armFriction=0.012:0:0.022";
    let (name, numbers) = assignment(text, FORM)?;
    let mut record = start_and_bounds(text, &numbers, FORM)?;
    record.insert("name".to_owned(), Value::Text(name));
    Ok(Value::Record(record))
}

/// Returns the record of `start:lower:upper`.
fn start_and_bounds(text: &str, numbers: &str, form: &str) -> Result<Record, Error> {
    let mut record = Record::new();
    let parts: Vec<&str> = numbers.split(':').collect();
    if parts.len() > 3 {
        return Err(Error::input(format!("'{text}': expected {form}")));
    }
    for (field, part) in
        ["start", "lower", "upper"].into_iter().zip(parts).filter(|(_, part)| !part.trim().is_empty())
    {
        let number = part.trim().parse();
        let number = number.map_err(|_| {
            Error::input(format!("'{text}': {field} '{part}' is not a number; expected {form}"))
        })?;
        record.insert(field.to_owned(), Value::Number(number));
    }
    Ok(record)
}

/// Returns the initial value of each state: a number, a word that starts with `measured`, or the record of
/// `start:lower:upper`.
fn initial_states(given: &[String]) -> Result<Record, Error> {
    const FORM: &str =
        "name=number, name=measured or name=start:lower:upper, as in --initial-state T=20:0:40";
    let of = |(name, text): (String, String)| {
        let is_fitted = text.contains(':') && !text.starts_with("measured");
        let value = match is_fitted {
            true => Value::Record(start_and_bounds(&text, &text, FORM)?),
            false => value_of_text(&text),
        };
        Ok((name, value))
    };
    assignments(given, FORM)?.into_iter().map(of).collect()
}

/// Returns a variable and its column. A single name denotes both.
fn column(text: &str) -> Result<Value, Error> {
    if !text.contains('=') {
        return Ok(Value::Text(text.to_owned()));
    }
    let (variable, column) = assignment(text, "variable=column")?;
    Ok(Value::List(vec![Value::Text(variable), Value::Text(column)]))
}

/// Like `column`, for an input, which may have a number instead of a column. The values of inputs in `hold`
/// are held between the rows.
fn source(text: &str, hold: &[String]) -> Result<Value, Error> {
    let (input, column) = match text.contains('=') {
        true => assignment(text, "variable=column")?,
        false => (text.to_owned(), text.to_owned()),
    };
    let source = match column.parse::<f64>() {
        Ok(_) if text.contains('=') => value_of_text(&column),
        _ if hold.contains(&input) => Value::Record(Record::from([
            ("column".to_owned(), Value::Text(column)),
            ("hold".to_owned(), Value::Flag(true)),
        ])),
        _ => Value::Text(column),
    };
    Ok(Value::List(vec![Value::Text(input), source]))
}

/// Returns the record of a problem with one recording, which drives these inputs.
pub(crate) fn record(arguments: &Problem, data: &Path, inputs: &[String]) -> Result<Record, Error> {
    let Problem { problem: model, output, hold, parameter: parameters, time, start_time, .. } = arguments;
    let path = |path: &Path| text_of(path).map(Value::Text);
    let is_driven = |held: &&String| {
        inputs.iter().any(|text| text.split_once('=').map_or(&text[..], |(input, _)| input.trim()) == **held)
    };
    if let Some(unknown) = hold.iter().find(|held| !is_driven(held)) {
        return Err(Error::input(format!(
            "--hold {unknown}: no column drives this input. Specify one: --input {unknown}=COLUMN"
        )));
    }
    let outputs = output.iter().map(|text| column(text)).collect::<Result<_, _>>()?;
    let inputs = inputs.iter().map(|text| source(text, hold)).collect::<Result<_, _>>()?;
    let mut experiment = Record::from([
        ("data".to_owned(), path(data)?),
        ("outputs".to_owned(), Value::List(outputs)),
        ("inputs".to_owned(), Value::List(inputs)),
        ("initial_states".to_owned(), Value::Record(initial_states(&arguments.initial_state)?)),
    ]);
    experiment.extend(time.iter().map(|time| ("time".to_owned(), Value::Text(time.clone()))));
    experiment.extend(start_time.map(|time| ("start_time".to_owned(), Value::Number(time))));
    let parameters = parameters.iter().map(|text| parameter(text)).collect::<Result<_, _>>()?;
    Ok(Record::from([
        ("model".to_owned(), path(model)?),
        ("experiments".to_owned(), Value::List(vec![Value::Record(experiment)])),
        ("parameters".to_owned(), Value::List(parameters)),
    ]))
}
