//! Profile likelihoods, as the fields of `pydfo.Profile`.

use crate::calibration::fit::PyFit;
use crate::calibration::native::PyCalibration;
use crate::convert::error;
use crate::model::trajectory::Counts;
use calibration::RunContext;
use calibration::{ParameterProfile, Profile, ProfileOptions};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// `Fit.profile`, to an extent of a level, whether it is corrected for autocorrelated residuals, and a number
/// of points per side; an interrupt carries the fields of what there is.
#[pyfunction]
pub(crate) fn profile<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    fit: &PyFit,
    parameters: Option<Vec<usize>>,
    extent: (f64, bool, Option<usize>),
    workers: Option<usize>,
    checkpoint: Option<PathBuf>,
) -> PyResult<Bound<'py, PyDict>> {
    let fit = fit.inner.clone();
    let (level, is_corrected, max_points) = extent;
    let max_points = max_points.unwrap_or_else(|| ProfileOptions::default().max_points);
    let options = ProfileOptions { parameters, level, is_corrected, max_points, workers, checkpoint };
    let work = move |calibration: &calibration::Calibration, context: &RunContext<'_>| {
        calibration.profile(&fit, &options, context)
    };
    let (found, was_interrupted) = calibration.compute_to_end(py, work)?;
    let fields = to_python(py, &found)?;
    match was_interrupted {
        true => Err(error::interrupted(py, Some(fields.as_any()), None)),
        false => Ok(fields),
    }
}

fn to_python<'py>(py: Python<'py>, found: &Profile) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    let of = |profile: &ParameterProfile| {
        let fields = PyDict::new(py);
        let rows: Vec<Vec<f64>> = profile.points.iter().map(|point| point.x.clone()).collect();
        fields.set_item("name", &profile.name)?;
        fields.set_item("optimum", profile.optimum)?;
        fields.set_item("values", PyArray1::from_iter(py, profile.points.iter().map(|p| p.value)))?;
        fields.set_item("costs", PyArray1::from_iter(py, profile.points.iter().map(|p| p.statistic)))?;
        fields.set_item("points", PyArray2::from_vec2(py, &rows)?)?;
        fields.set_item("interval", profile.interval())?;
        fields.set_item("message", profile.message())?;
        Ok(fields)
    };
    fields.set_item("parameters", found.parameters.iter().map(of).collect::<PyResult<Vec<_>>>()?)?;
    fields.set_item("level", found.level)?;
    fields.set_item("threshold", found.threshold)?;
    fields.set_item("degrees_of_freedom", found.degrees_of_freedom)?;
    fields.set_item("x", PyArray1::from_slice(py, &found.x))?;
    fields.set_item("interrupted", found.is_interrupted)?;
    fields.set_item("autocorrelated", found.is_autocorrelated)?;
    fields.set_item("n_simulations", found.n_simulations)?;
    fields.set_item("stats", Counts::new(&found.stats))?;
    fields.set_item("text", found.to_string())?;
    Ok(fields)
}
