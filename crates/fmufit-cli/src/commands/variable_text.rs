//! Values of variables, given as text on the command line.

use crate::error::Error;
use fmi::description::VariableKind;
use fmi::{FmiError, ModelDescription, Value, Variable};

/// Parses the value of a variable: a number, `true` or `false`, a string, or the name of an enumeration item.
/// The elements of an array are separated by commas.
pub(crate) fn value_of(description: &ModelDescription, name: &str, text: &str) -> Result<Value, Error> {
    let array = || name.rsplit_once('[').and_then(|(array, _)| description.variable(array));
    let variable = description.variable(name).or_else(array).ok_or_else(|| {
        let nearest = description.nearest_names(name, 3).into_iter().map(str::to_owned).collect();
        Error::input(calibration::visible_error(&FmiError::UnknownVariable {
            name: name.to_owned(),
            nearest,
        }))
    })?;
    let one = |text: &str| {
        scalar(description, variable, text.trim()).ok_or_else(|| {
            Error::input(format!("'{name}' = '{text}': expected a value of type {}", variable.kind))
        })
    };
    match variable.dimensions.is_empty() || variable.name != name {
        true => one(text),
        false => {
            text.trim_matches(['[', ']']).split(',').map(one).collect::<Result<_, _>>().map(Value::Array)
        }
    }
}

fn scalar(description: &ModelDescription, variable: &Variable, text: &str) -> Option<Value> {
    let number = || text.parse().ok().map(Value::Real);
    match variable.kind {
        VariableKind::String => Some(Value::String(text.to_owned())),
        VariableKind::Boolean | VariableKind::Clock => match text.to_ascii_lowercase().as_str() {
            "true" | "1" => Some(Value::Boolean(true)),
            "false" | "0" => Some(Value::Boolean(false)),
            _ => None,
        },
        VariableKind::Binary => None,
        kind if kind.is_integer() => {
            let types = variable.declared_type.as_ref();
            let definition =
                description.type_definitions.iter().find(|definition| Some(&definition.name) == types);
            let item =
                definition.and_then(|definition| definition.items.iter().find(|item| item.name == text));
            let value = item.map(|item| i128::from(item.value)).or_else(|| text.parse().ok());
            value.map(Value::Integer).or_else(number)
        }
        _ => number(),
    }
}
