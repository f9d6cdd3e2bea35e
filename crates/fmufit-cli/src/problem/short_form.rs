//! Short form of a problem on the command line: a model, a recording and names.

use super::document::value_of_text;
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
    let mut record = Record::from([("name".to_owned(), Value::Text(name))]);
    let parts: Vec<&str> = numbers.split(':').collect();
    if parts.len() > 3 {
        return Err(Error::input(format!("'{text}': expected {FORM}")));
    }
    for (field, part) in
        ["start", "lower", "upper"].into_iter().zip(parts).filter(|(_, part)| !part.trim().is_empty())
    {
        let number = part.trim().parse();
        let number = number.map_err(|_| {
            Error::input(format!("'{text}': {field} '{part}' is not a number; expected {FORM}"))
        })?;
        record.insert(field.to_owned(), Value::Number(number));
    }
    Ok(Value::Record(record))
}

/// Returns a variable and its column. A single name denotes both.
fn column(text: &str) -> Result<Value, Error> {
    if !text.contains('=') {
        return Ok(Value::Text(text.to_owned()));
    }
    let (variable, column) = assignment(text, "variable=column")?;
    Ok(Value::List(vec![Value::Text(variable), Value::Text(column)]))
}

/// Like `column`, for an input, which may have a number instead of a column.
fn source(text: &str) -> Result<Value, Error> {
    match column(text)? {
        Value::List(pair) => match &pair[..] {
            [input, Value::Text(column)] if column.parse::<f64>().is_ok() => {
                Ok(Value::List(vec![input.clone(), value_of_text(column)]))
            }
            _ => Ok(Value::List(pair)),
        },
        own => Ok(own),
    }
}

/// Returns the record of a problem with one recording.
pub(crate) fn record(
    model: &Path,
    data: &Path,
    (time, start_time): (Option<&str>, Option<f64>),
    parameters: &[String],
    outputs: &[String],
    inputs: &[String],
) -> Result<Record, Error> {
    let path = |path: &Path| text_of(path).map(Value::Text);
    let mut experiment = Record::from([
        ("data".to_owned(), path(data)?),
        (
            "outputs".to_owned(),
            Value::List(outputs.iter().map(|text| column(text)).collect::<Result<_, _>>()?),
        ),
        ("inputs".to_owned(), Value::List(inputs.iter().map(|text| source(text)).collect::<Result<_, _>>()?)),
    ]);
    experiment.extend(time.map(|time| ("time".to_owned(), Value::Text(time.to_owned()))));
    experiment.extend(start_time.map(|time| ("start_time".to_owned(), Value::Number(time))));
    let parameters = parameters.iter().map(|text| parameter(text)).collect::<Result<_, _>>()?;
    Ok(Record::from([
        ("model".to_owned(), path(model)?),
        ("experiments".to_owned(), Value::List(vec![Value::Record(experiment)])),
        ("parameters".to_owned(), Value::List(parameters)),
    ]))
}
