//! Conversion of values between Python and models.

use crate::convert::fmu_error::{self, BadModelValueError, ModelTypeError};
use fmi::description::{Dimension, EnumerationItem, ModelDescription, VariableKind};
use fmi::{Value, Variable};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use std::collections::HashMap;

/// Converts a value of a model to Python. An array becomes a NumPy array with these extents.
pub(crate) fn to_python<'py>(
    py: Python<'py>,
    value: Value,
    kind: VariableKind,
    extents: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Real(x) => x.into_pyobject(py)?.into_any(),
        Value::Integer(i) => i.into_pyobject(py)?.into_any(),
        Value::Boolean(b) => PyBool::new(py, b).to_owned().into_any(),
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        Value::Binary(bytes) => PyBytes::new(py, &bytes).into_any(),
        Value::Array(values) => {
            let count = values.len();
            let items = values
                .into_iter()
                .map(|value| to_python(py, value, kind, &[]))
                .collect::<PyResult<Vec<_>>>()?;
            let dtype = PyDict::new(py);
            dtype.set_item("dtype", dtype_of(kind))?;
            let array =
                py.import("numpy")?.getattr("array")?.call((PyList::new(py, items)?,), Some(&dtype))?;
            // If the sizes are unknown (the model is about to be given others), the array stays flat.
            if !extents.is_empty() && extents.iter().product::<usize>() == count {
                array.call_method1("reshape", (extents.to_vec(),))?
            } else {
                array
            }
        }
        other => other.to_string().into_pyobject(py)?.into_any(),
    })
}

/// Converts names and given values to values for the model.
pub(crate) fn all_from_python<'py>(
    py: Python<'py>,
    description: &ModelDescription,
    given: impl Iterator<Item = (String, Bound<'py, PyAny>)>,
) -> PyResult<Vec<(String, Value)>> {
    given
        .map(|(name, value)| {
            let (variable, whole) = find(py, description, &name)?;
            let value = from_python(description, variable, whole, &value)?;
            Ok((name, value))
        })
        .collect()
}

/// Returns the variable of a name, and whether the name refers to the whole variable instead of an element.
pub(crate) fn find<'a>(
    py: Python<'_>,
    description: &'a ModelDescription,
    name: &str,
) -> PyResult<(&'a Variable, bool)> {
    if let Some(variable) = description.variable(name) {
        return Ok((variable, true));
    }
    let array = name.rsplit_once('[').and_then(|(array, _)| description.variable(array));
    array.filter(|array| !array.dimensions.is_empty()).map(|array| (array, false)).ok_or_else(|| {
        let nearest = description.nearest_names(name, 3).into_iter().map(str::to_owned).collect();
        fmu_error::raise(py, &fmi::FmiError::UnknownVariable { name: name.to_owned(), nearest })
    })
}

/// NumPy type of the values of each kind of variable.
const DTYPES: [(VariableKind, &str); 15] = [
    (VariableKind::Real, "float64"),
    (VariableKind::Float32, "float32"),
    (VariableKind::Int8, "int8"),
    (VariableKind::UInt8, "uint8"),
    (VariableKind::Int16, "int16"),
    (VariableKind::UInt16, "uint16"),
    (VariableKind::Integer, "int32"),
    (VariableKind::UInt32, "uint32"),
    (VariableKind::Int64, "int64"),
    (VariableKind::UInt64, "uint64"),
    (VariableKind::Enumeration, "int64"),
    (VariableKind::Boolean, "bool"),
    (VariableKind::Clock, "bool"),
    (VariableKind::String, "object"),
    (VariableKind::Binary, "object"),
];

fn dtype_of(kind: VariableKind) -> &'static str {
    DTYPES.iter().find(|(listed, _)| *listed == kind).map_or("object", |(_, dtype)| dtype)
}

/// NumPy types by the names of the kinds.
#[pyfunction]
pub(crate) fn dtypes() -> HashMap<&'static str, &'static str> {
    DTYPES.iter().map(|(kind, dtype)| (kind.name(), *dtype)).collect()
}

/// Converts the value given for a variable or for one of its elements. Accepts a Python or NumPy scalar, or a
/// single one in an array, list or tuple. For an array (`whole`), accepts its elements in its shape or one
/// after the other. An item of an enumeration can be given by its name.
fn from_python(
    description: &ModelDescription,
    variable: &Variable,
    whole: bool,
    given: &Bound<'_, PyAny>,
) -> PyResult<Value> {
    if whole && !variable.dimensions.is_empty() {
        return array(description, variable, given);
    }
    scalar(description, variable, given)
}

fn array(description: &ModelDescription, variable: &Variable, given: &Bound<'_, PyAny>) -> PyResult<Value> {
    let objects = PyDict::new(given.py());
    objects.set_item("dtype", "object")?;
    let elements = given.py().import("numpy")?.getattr("asarray")?.call((given,), Some(&objects))?;
    let shape: Vec<usize> = elements.getattr("shape")?.extract()?;
    let fits = shape.len() == variable.dimensions.len()
        && shape.iter().zip(&variable.dimensions).all(|(extent, dimension)| match dimension {
            Dimension::Fixed(fixed) => extent == fixed,
            Dimension::Parameter(_) => true,
        });
    if shape.len() > 1 && !fits {
        let text = format!(
            "{}: the shape {shape:?} of the array does not match the dimensions of the variable",
            variable.name
        );
        return Err(BadModelValueError::new_err(text));
    }
    let flat = elements.call_method0("ravel")?.call_method0("tolist")?;
    let values = flat.try_iter()?.map(|element| scalar(description, variable, &element?));
    Ok(Value::Array(values.collect::<PyResult<_>>()?))
}

fn scalar(description: &ModelDescription, variable: &Variable, given: &Bound<'_, PyAny>) -> PyResult<Value> {
    // NumPy's doubles are also floats. All others are first checked for attributes, which takes a
    // microsecond.
    if let Ok(number) = given.cast::<PyFloat>() {
        return Ok(Value::Real(number.value()));
    }
    let given = &single(variable, given)?;
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

/// Returns the only element of an array, a list or a tuple. Returns other objects unchanged.
fn single<'py>(variable: &Variable, given: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let many = |count: usize| {
        BadModelValueError::new_err(format!("{}: expected one value, got {count}", variable.name))
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
    let available: Vec<String> = items.iter().map(|item| format!("{} ({})", item.name, item.value)).collect();
    BadModelValueError::new_err(format!(
        "{} = {given} is invalid; expected one of the items of its type: {}",
        variable.name,
        available.join(", ")
    ))
}

fn unfit(variable: &Variable, given: &Bound<'_, PyAny>) -> PyErr {
    let kind = given.get_type().name().map_or_else(|_| "?".to_owned(), |name| name.to_string());
    let text = given.repr().map_or_else(|_| String::new(), |text| text.to_string());
    let shown: String = text.chars().take(60).collect();
    let dots = if shown.len() < text.len() { "..." } else { "" };
    ModelTypeError::new_err(format!(
        "{}: expected a value of type {}, got {shown}{dots} ({kind})",
        variable.name, variable.kind
    ))
}
