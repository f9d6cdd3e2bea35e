//! The names of the methods and of their options.

use crate::convert::error;
use dfo::{AnyMethod, MethodOptions};
use pyo3::prelude::*;
use std::collections::BTreeSet;

/// The names of the methods, and whether each needs a start point.
#[pyfunction]
pub(crate) fn method_names() -> Vec<(&'static str, bool)> {
    let needs_start = |name: &str| name.parse::<AnyMethod>().is_ok_and(|method| method.needs_start());
    AnyMethod::NAMES.map(|name| (name, needs_start(name))).to_vec()
}

/// The name of the method that is called so, or "auto".
#[pyfunction]
pub(crate) fn method_name(py: Python<'_>, name: &str) -> PyResult<&'static str> {
    name.parse::<AnyMethod>().map(|method| method.name()).map_err(|e| error::optimiser(py, &e))
}

/// The name of the method that `fmin` has under this number.
#[pyfunction]
pub(crate) fn method_of_number(py: Python<'_>, number: usize) -> PyResult<&'static str> {
    AnyMethod::by_number(number).map(|method| method.name()).map_err(|e| error::optimiser(py, &e))
}

/// The names of the options that there are, of any method.
#[pyfunction]
pub(crate) fn option_names(py: Python<'_>) -> PyResult<BTreeSet<String>> {
    AnyMethod::all_option_names().map_err(|e| error::optimiser(py, &e))
}
