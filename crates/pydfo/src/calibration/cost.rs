//! The cost of a fit: a name, or a Python function of the measurements and the simulated values.

use crate::interrupt::interrupt_guard::{EndRequest, Inside};
use crate::interrupt::lock::lock;
use crate::optimize::objective::{number, residuals};
use calibration::{Calibration, Compared, CostKind, CustomCost, CustomFailure};
use numpy::PyArray1;
use pyo3::exceptions::{PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex, OnceLock};

/// The first exception of a Python function that ended a fit.
pub(crate) type Raised = Arc<Mutex<Option<PyErr>>>;

/// A name, or a function with its name and whether it returns residuals.
#[derive(FromPyObject)]
pub(crate) struct CostFields {
    name: String,
    function: Option<Py<PyAny>>,
    gives_residuals: bool,
}

/// Returns one array per output, by its variable. With several experiments, returns a dict of such dicts by
/// the names of the experiments.
pub(crate) fn series<'py, 'a>(
    py: Python<'py>,
    names: &[String],
    outputs: impl Iterator<Item = (usize, &'a str, &'a [f64])>,
) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    for (experiment, variable, values) in outputs {
        let values = PyArray1::from_slice(py, values);
        if names.len() == 1 {
            all.set_item(variable, values)?;
            continue;
        }
        let name = &names[experiment];
        if !all.contains(name)? {
            all.set_item(name, PyDict::new(py))?;
        }
        if let Some(of_experiment) = all.get_item(name)? {
            of_experiment.set_item(variable, values)?;
        }
    }
    Ok(all)
}

/// Creates the requested cost. An exception of a function is stored in `raised` and ends the fit.
pub(crate) fn kind(
    given: CostFields,
    calibration: &Calibration,
    stop: Arc<EndRequest>,
    raised: Raised,
) -> PyResult<CostKind> {
    let CostFields { name, function, gives_residuals } = given;
    let Some(function) = function else {
        return CostKind::of_name(&name).ok_or_else(|| {
            let available = CostKind::named().map(|kind| format!("'{}'", kind.name()));
            let available = available.collect::<Vec<_>>().join(", ");
            PyValueError::new_err(format!(
                "objective = '{name}' is invalid; expected one of {available}, or a function of (measured, \
                 simulated)"
            ))
        });
    };
    let (names, length) = (calibration.problem().experiment_names(), OnceLock::new());
    let call = move |compared: &[Compared<'_>]| {
        let _inside = Inside::new(&stop);
        Python::attach(|py| {
            let of = |pick: for<'c> fn(&Compared<'c>) -> &'c [f64]| {
                series(py, &names, compared.iter().map(|c| (c.experiment, c.variable, pick(c))))
            };
            let returned = || {
                let value = function.bind(py).call1((of(|c| c.measured)?, of(|c| c.simulated)?))?;
                let mut numbers = Vec::new();
                if !gives_residuals {
                    numbers.push(number(&value, "the objective")?);
                    return Ok(numbers);
                }
                residuals(&value, &mut numbers)?;
                let expected = *length.get_or_init(|| numbers.len());
                if numbers.len() == expected {
                    return Ok(numbers);
                }
                let got = numbers.len();
                Err(PyValueError::new_err(format!(
                    "the objective returned {got} residuals, but {expected} in earlier calls; the number \
                     must not change"
                )))
            };
            returned().map_err(|e: PyErr| {
                let message = e.to_string();
                if e.is_instance_of::<PyKeyboardInterrupt>(py) {
                    stop.end_with(e);
                } else {
                    lock(&raised).get_or_insert(e);
                }
                CustomFailure::Abort(message)
            })
        })
    };
    Ok(CostKind::Custom(match gives_residuals {
        true => CustomCost::residuals(name, call),
        false => {
            let first = |numbers: Vec<f64>| numbers.first().copied().unwrap_or(f64::NAN);
            CustomCost::cost(name, move |compared| call(compared).map(first))
        }
    }))
}
