//! Names of the methods and of their options.

use crate::convert::error;
use dfo::{AnyMethod, MethodOptions};
use pyo3::prelude::*;
use std::collections::BTreeSet;

/// Returns the names of the methods, and whether each needs a start point.
#[pyfunction]
pub(crate) fn method_names() -> Vec<(&'static str, bool)> {
    let needs_start = |name: &str| name.parse::<AnyMethod>().is_ok_and(|method| method.needs_start());
    AnyMethod::NAMES.map(|name| (name, needs_start(name))).to_vec()
}

/// Returns the name of the method that has this name or alias, or "auto".
#[pyfunction]
pub(crate) fn method_name(py: Python<'_>, name: &str) -> PyResult<&'static str> {
    name.parse::<AnyMethod>().map(|method| method.name()).map_err(|e| error::optimiser(py, &e))
}

/// Returns the name of the method with this number in `fmin`.
#[pyfunction]
pub(crate) fn method_of_number(py: Python<'_>, number: usize) -> PyResult<&'static str> {
    AnyMethod::by_number(number).map(|method| method.name()).map_err(|e| error::optimiser(py, &e))
}

/// Returns the names of the options of all methods.
#[pyfunction]
pub(crate) fn option_names(py: Python<'_>) -> PyResult<BTreeSet<String>> {
    AnyMethod::all_option_names().map_err(|e| error::optimiser(py, &e))
}
