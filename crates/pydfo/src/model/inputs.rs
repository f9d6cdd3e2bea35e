//! Inputs from Python: tables as arrays, and functions. The interpreter lock is held only during calls of the
//! functions.

use crate::interrupt::lock::lock;
use fmi::{Inputs, Value};
use numpy::PyReadonlyArray1;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// Columns with their common times.
#[derive(FromPyObject)]
pub(crate) struct Table<'py> {
    times: PyReadonlyArray1<'py, f64>,
    columns: Vec<(String, PyReadonlyArray1<'py, f64>)>,
    values: Vec<(String, Vec<Exact>)>,
}

/// A value of an input that a double cannot represent.
#[derive(FromPyObject)]
enum Exact {
    #[pyo3(transparent, annotation = "str")]
    Text(String),
    #[pyo3(transparent, annotation = "bytes")]
    Bytes(Vec<u8>),
    #[pyo3(transparent, annotation = "int")]
    Integer(i128),
}

impl From<Exact> for Value {
    fn from(exact: Exact) -> Self {
        match exact {
            Exact::Text(text) => Value::String(text),
            Exact::Bytes(bytes) => Value::Binary(bytes),
            Exact::Integer(integer) => Value::Integer(integer),
        }
    }
}

/// A function of time for one input, or a function that returns the values of several inputs.
#[derive(FromPyObject)]
pub(crate) struct Function {
    names: Vec<String>,
    function: Py<PyAny>,
}

/// The functions of one simulation.
#[derive(Clone, Default)]
pub(crate) struct Callbacks {
    all: Vec<Arc<Callback>>,
}

impl Callbacks {
    /// Adds a function that returns one number.
    pub(crate) fn add(&mut self, function: Py<PyAny>) -> Arc<Callback> {
        let callback = Arc::new(Callback::new(function, 1, Arc::default()));
        self.all.push(Arc::clone(&callback));
        callback
    }

    /// True if there is no callback.
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// True if a callback has raised an exception.
    pub(crate) fn has_raised(&self) -> bool {
        self.all.iter().any(|callback| lock(&callback.raised).is_some())
    }

    /// Takes the exception that a callback raised.
    pub(crate) fn take_raised(&self) -> Option<PyErr> {
        self.all.iter().find_map(|callback| lock(&callback.raised).take())
    }

    /// Releases the functions. The results of a simulation must not keep alive the objects that the functions
    /// refer to (the model itself, perhaps).
    pub(crate) fn release(&self) {
        for callback in &self.all {
            drop(lock(&callback.function).take());
        }
    }
}

/// Creates inputs from tables and functions. `stop` is set when a function raises an exception.
pub(crate) fn inputs(
    tables: Vec<Table<'_>>,
    functions: Vec<Function>,
    stop: &Arc<AtomicBool>,
) -> PyResult<(Inputs, Callbacks)> {
    let mut inputs = Inputs::new();
    for Table { times, columns, values } in tables {
        let columns: PyResult<Vec<(String, Vec<f64>)>> =
            columns.into_iter().map(|(name, values)| Ok((name, values.as_slice()?.to_vec()))).collect();
        inputs = inputs.table(times.as_slice()?, columns?);
        for (name, values) in values {
            inputs = inputs.values(name, times.as_slice()?, values);
        }
    }
    let mut callbacks = Callbacks::default();
    for Function { names, function } in functions {
        let callback = Arc::new(Callback::new(function, names.len(), Arc::clone(stop)));
        for (position, name) in names.into_iter().enumerate() {
            let callback = Arc::clone(&callback);
            inputs = inputs.function(name, move |time| callback.value(time, position));
        }
        callbacks.all.push(callback);
    }
    Ok((inputs, callbacks))
}

/// A function of time in Python, callable from any thread.
pub(crate) struct Callback {
    function: Mutex<Option<Py<PyAny>>>,
    /// The last time and its values, because the inputs of one function are evaluated one after the other.
    last: Mutex<Option<(f64, Vec<f64>)>>,
    raised: Mutex<Option<PyErr>>,
    stop: Arc<AtomicBool>,
    count: usize,
}

impl Callback {
    fn new(function: Py<PyAny>, count: usize, stop: Arc<AtomicBool>) -> Self {
        let (last, raised) = (Mutex::new(None), Mutex::new(None));
        Self { function: Mutex::new(Some(function)), last, raised, stop, count }
    }

    /// Returns one of the values at `time`. After an exception, returns NaN, which ends any simulation.
    pub(crate) fn value(&self, time: f64, position: usize) -> f64 {
        let mut last = lock(&self.last);
        if last.as_ref().is_none_or(|(last_time, _)| last_time.to_bits() != time.to_bits()) {
            // After an exception, there is nothing to store.
            *last = Some((time, self.call(time))).filter(|(_, values)| !values.is_empty());
        }
        last.as_ref().and_then(|(_, values)| values.get(position)).copied().unwrap_or(f64::NAN)
    }

    fn call(&self, time: f64) -> Vec<f64> {
        if lock(&self.raised).is_some() {
            return Vec::new();
        }
        Python::attach(|py| {
            let function = lock(&self.function).as_ref().map(|function| function.clone_ref(py));
            let Some(function) = function else { return Vec::new() };
            match function.bind(py).call1((time,)).and_then(|result| self.numbers(time, &result)) {
                Ok(values) => values,
                Err(e) => {
                    lock(&self.raised).get_or_insert(e);
                    self.stop.store(true, Ordering::Relaxed);
                    Vec::new()
                }
            }
        })
    }

    /// Converts the result to a number, or to one number per input.
    fn numbers(&self, time: f64, result: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
        let bad = || {
            let text = result.repr().map_or_else(|_| "?".to_owned(), |text| text.to_string());
            let kind = if self.count == 1 { "a number" } else { "one number per name" };
            PyTypeError::new_err(format!(
                "the input function must return {kind}; at t = {time} it returned {text}"
            ))
        };
        let is_single = result
            .getattr("ndim")
            .and_then(|n| n.extract::<usize>())
            .map_or_else(|_| result.len().is_err(), |dimensions| dimensions == 0);
        let values = if is_single {
            vec![result.extract().map_err(|_| bad())?]
        } else {
            result.extract::<Vec<f64>>().map_err(|_| bad())?
        };
        if values.len() != self.count {
            return Err(bad());
        }
        match values.iter().find(|value| !value.is_finite()) {
            Some(value) => {
                Err(PyValueError::new_err(format!("the input function returned {value} at t = {time}")))
            }
            None => Ok(values),
        }
    }
}
