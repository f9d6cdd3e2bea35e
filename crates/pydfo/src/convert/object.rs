//! Records and results as Python objects, by serialisation.

use ciborium::Value;
use numpy::PyArray1;
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};
use serde::Serialize;
use std::fmt::Display;

/// Returns the serialised form of a value. A structure becomes a dict of its fields, a series of numbers an
/// array.
pub(crate) fn to_python<'py, T: Serialize>(py: Python<'py>, value: &T) -> PyResult<Bound<'py, PyAny>> {
    object(py, Value::serialized(value).map_err(|e| PyValueError::new_err(e.to_string()))?)
}

/// Returns the fields of a structure.
pub(crate) fn fields<'py, T: Serialize>(py: Python<'py>, value: &T) -> PyResult<Bound<'py, PyDict>> {
    Ok(to_python(py, value)?.cast_into()?)
}

/// Returns the fields of a structure, with its `Display` as `text`.
pub(crate) fn with_text<'py, T: Serialize + Display>(
    py: Python<'py>,
    value: &T,
) -> PyResult<Bound<'py, PyDict>> {
    let fields = fields(py, value)?;
    fields.set_item("text", value.to_string())?;
    Ok(fields)
}

/// Returns a value as bytes (CBOR).
pub(crate) fn to_bytes(value: &impl Serialize) -> PyResult<Vec<u8>> {
    let mut bytes = Vec::new();
    ciborium::into_writer(value, &mut bytes).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(bytes)
}

fn object(py: Python<'_>, value: Value) -> PyResult<Bound<'_, PyAny>> {
    match value {
        Value::Bool(flag) => flag.into_bound_py_any(py),
        Value::Integer(number) => i128::from(number).into_bound_py_any(py),
        Value::Float(number) => number.into_bound_py_any(py),
        Value::Text(text) => text.into_bound_py_any(py),
        Value::Bytes(bytes) => Ok(PyBytes::new(py, &bytes).into_any()),
        Value::Array(items) if !items.is_empty() && items.iter().all(Value::is_float) => {
            Ok(PyArray1::from_iter(py, items.iter().filter_map(Value::as_float)).into_any())
        }
        Value::Array(items) => {
            let items = items.into_iter().map(|item| object(py, item)).collect::<PyResult<Vec<_>>>()?;
            Ok(PyList::new(py, items)?.into_any())
        }
        Value::Map(entries) => {
            let fields = PyDict::new(py);
            for (name, value) in entries {
                fields.set_item(object(py, name)?, object(py, value)?)?;
            }
            Ok(fields.into_any())
        }
        _ => Ok(py.None().into_bound(py)),
    }
}
