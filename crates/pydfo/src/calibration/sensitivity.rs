//! Sensitivity analysis of a calibration, as the fields of `pydfo.Sensitivity`.

use crate::calibration::calibration_class::PyCalibration;
use crate::convert::error;
use crate::convert::record::time_limit;
use crate::optimize::sensitivity::{PyAnalysis, fields, method_of};
use calibration::{RunContext, SensitivityOptions};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Implements `Calibration.sensitivity`. An interrupt carries the fields of the partial result.
#[pyfunction]
pub(crate) fn calibration_sensitivity<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    analysis: PyAnalysis,
    seed: Option<u64>,
    workers: Option<usize>,
    max_time: Option<f64>,
    checkpoint: Option<PathBuf>,
) -> PyResult<Bound<'py, PyDict>> {
    let (method, intervals) = method_of(py, analysis)?;
    let max_time = time_limit("max_time", max_time)?;
    let options = SensitivityOptions {
        method,
        intervals,
        seed,
        workers,
        max_time,
        checkpoint,
        ..SensitivityOptions::default()
    };
    let work = move |calibration: &calibration::Calibration, context: &RunContext<'_>| {
        calibration.sensitivity(&options, context)
    };
    let (found, was_interrupted) = calibration.shared.compute_to_end(py, work)?;
    let fields = fields(py, &found)?;
    match was_interrupted {
        true => Err(error::interrupted(py, Some(fields.as_any()), None)),
        false => Ok(fields),
    }
}
