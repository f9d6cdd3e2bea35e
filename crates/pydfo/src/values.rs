//! Values on their way between Python and models.

use crate::fmu_error::{BadModelValueError, ModelTypeError};
use fmi::description::{EnumerationItem, ModelDescription, VariableKind};
use fmi::{Value, Variable};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyFloat, PyInt, PyList, PyString, PyTuple};

/// A value of a model in Python.
pub(crate) fn to_python<'py>(py: Python<'py>, value: Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Real(x) => x.into_pyobject(py)?.into_any(),
        Value::Integer(i) => i.into_pyobject(py)?.into_any(),
        Value::Boolean(b) => PyBool::new(py, b).to_owned().into_any(),
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        Value::Binary(bytes) => PyBytes::new(py, &bytes).into_any(),
        Value::Array(values) => {
            let items = values.into_iter().map(|value| to_python(py, value)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, items)?.into_any()
        }
        other => other.to_string().into_pyobject(py)?.into_any(),
    })
}

/// The value given for a variable: a Python or NumPy scalar, or one such in an array, list or tuple; for an array of the
/// model its elements. An item of an enumeration may be given by its name.
pub(crate) fn from_python(
    description: &ModelDescription,
    variable: &Variable,
    given: &Bound<'_, PyAny>,
) -> PyResult<Value> {
    if !variable.dimensions.is_empty() {
        return elements(description, variable, given).map(Value::Array);
    }
    one(description, variable, &single(variable, given)?)
}

/// The elements of an array, given as a NumPy array, a list or a tuple, the last index varying fastest; one that is given
/// alone is an array of one.
fn elements(
    description: &ModelDescription,
    variable: &Variable,
    given: &Bound<'_, PyAny>,
) -> PyResult<Vec<Value>> {
    let flat = match given.hasattr("dtype")? && given.hasattr("ravel")? {
        true => given.call_method0("ravel")?.call_method0("tolist")?,
        false => given.clone(),
    };
    if !flat.is_instance_of::<PyList>() && !flat.is_instance_of::<PyTuple>() {
        return Ok(vec![one(description, variable, &single(variable, &flat)?)?]);
    }
    let mut values = Vec::new();
    for item in flat.try_iter()? {
        values.extend(elements(description, variable, &item?)?);
    }
    Ok(values)
}

fn one(description: &ModelDescription, variable: &Variable, given: &Bound<'_, PyAny>) -> PyResult<Value> {
    if let Ok(flag) = given.cast::<PyBool>() {
        return Ok(Value::Boolean(flag.is_true()));
    }
    if let Ok(number) = given.cast::<PyFloat>() {
        return Ok(Value::Real(number.value()));
    }
    if given.is_instance_of::<PyInt>() {
        return integer(description, variable, given);
    }
    if let Ok(text) = given.cast::<PyString>() {
        let text = text.to_string();
        return match variable.kind {
            VariableKind::Enumeration => item(description, variable, &text),
            _ => Ok(Value::String(text)),
        };
    }
    if let Ok(bytes) = given.cast::<PyBytes>() {
        return Ok(Value::Binary(bytes.as_bytes().to_vec()));
    }
    if given.hasattr("__index__")? {
        return integer(description, variable, given);
    }
    // Fractions, decimals, tensors of other libraries.
    given.extract().map(Value::Real).map_err(|_| unfit(variable, given))
}

/// The only element of an array, a list or a tuple; other objects as they are.
fn single<'py>(variable: &Variable, given: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let many = |count: usize| {
        BadModelValueError::new_err(format!("{}: one value is needed, {count} are given", variable.name))
    };
    if given.is_instance_of::<PyList>() || given.is_instance_of::<PyTuple>() {
        let count = given.len()?;
        return if count == 1 { single(variable, &given.get_item(0)?) } else { Err(many(count)) };
    }
    if given.hasattr("dtype")? && given.hasattr("item")? {
        let count: usize = given.getattr("size")?.extract()?;
        return if count == 1 { given.call_method0("item") } else { Err(many(count)) };
    }
    Ok(given.clone())
}

fn integer(description: &ModelDescription, variable: &Variable, given: &Bound<'_, PyAny>) -> PyResult<Value> {
    if variable.kind.is_float() {
        return given.extract().map(Value::Real);
    }
    let value: i128 = given.extract().map_err(|_| {
        BadModelValueError::new_err(format!("{} = {given} does not fit into 128 bits", variable.name))
    })?;
    let items = items(description, variable);
    if items.is_empty() || items.iter().any(|item| i128::from(item.value) == value) {
        return Ok(value.into());
    }
    Err(no_item(variable, &value.to_string(), items))
}

/// The items of an enumeration; empty for other types.
fn items<'a>(description: &'a ModelDescription, variable: &Variable) -> &'a [EnumerationItem] {
    let declared = variable.declared_type.as_deref().filter(|_| variable.kind == VariableKind::Enumeration);
    let found = declared.and_then(|name| description.type_definitions.iter().find(|t| t.name == name));
    found.map_or(&[], |definition| &definition.items)
}

fn item(description: &ModelDescription, variable: &Variable, name: &str) -> PyResult<Value> {
    let items = items(description, variable);
    match items.iter().find(|item| item.name == name) {
        Some(item) => Ok(item.value.into()),
        None => Err(no_item(variable, name, items)),
    }
}

fn no_item(variable: &Variable, given: &str, items: &[EnumerationItem]) -> PyErr {
    let known: Vec<String> = items.iter().map(|item| format!("{} ({})", item.name, item.value)).collect();
    BadModelValueError::new_err(format!(
        "{} = {given} is none of the items of its type: {}",
        variable.name,
        known.join(", ")
    ))
}

fn unfit(variable: &Variable, given: &Bound<'_, PyAny>) -> PyErr {
    let kind = given.get_type().name().map_or_else(|_| "?".to_owned(), |name| name.to_string());
    let text = given.repr().map_or_else(|_| String::new(), |text| text.to_string());
    let shown: String = text.chars().take(60).collect();
    let dots = if shown.len() < text.len() { "..." } else { "" };
    ModelTypeError::new_err(format!(
        "{} is of type {}, {shown}{dots} ({kind}) does not fit",
        variable.name, variable.kind
    ))
}
