//! The check of model, recordings and parameters.

use crate::calibration::calibration_class::PyCalibration;
use crate::convert::object;
use crate::convert::record::time_limit;
use calibration::{CheckOptions, FindingId};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Returns the findings of a check, the findings as a table, the number of evaluations, and whether there are
/// only notes.
#[pyfunction]
pub(crate) fn check<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    simulate: bool,
    max_time: Option<f64>,
) -> PyResult<(Bound<'py, PyAny>, String, usize, bool)> {
    let options = CheckOptions { simulate, max_time: time_limit("max_time", max_time)? };
    let check = calibration.shared.compute(py, move |c, context| c.check_with(&options, context))?;
    let (table, is_ok) = (check.to_string(), check.is_ok());
    Ok((object::to_python(py, &check.findings)?, table, check.n_evaluations, is_ok))
}

/// Returns the name of a kind of finding by its identifier.
#[pyfunction]
pub(crate) fn name_of_finding(id: String) -> PyResult<&'static str> {
    FindingId::try_from(id).map(FindingId::name).map_err(PyValueError::new_err)
}
