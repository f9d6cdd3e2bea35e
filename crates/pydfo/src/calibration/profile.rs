//! Profile likelihoods, as the fields of `pydfo.Profile`.

use crate::calibration::fit::PyFit;
use crate::convert::dict::dict;
use crate::convert::error;
use crate::model::trajectory::Counts;
use calibration::RunContext;
use calibration::{ParameterProfile, Profile, ProfileOptions};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Implements `Fit.profile`. `extent`: level, correction for autocorrelated residuals, and number of points
/// per side. An interrupt carries the fields of the partial result.
#[pyfunction]
pub(crate) fn profile<'py>(
    py: Python<'py>,
    fit: &PyFit,
    parameters: Option<Vec<usize>>,
    extent: (f64, bool, Option<usize>),
    workers: Option<usize>,
    checkpoint: Option<PathBuf>,
) -> PyResult<Bound<'py, PyDict>> {
    let (level, is_corrected, max_points) = extent;
    let max_points = max_points.unwrap_or_else(|| ProfileOptions::default().max_points);
    let options = ProfileOptions { parameters, level, is_corrected, max_points, workers, checkpoint };
    let inner = fit.inner.clone();
    let work = move |calibration: &calibration::Calibration, context: &RunContext<'_>| {
        calibration.profile(&inner, &options, context)
    };
    let (found, was_interrupted) = fit.calibration.compute_to_end(py, work)?;
    let fields = to_python(py, &found)?;
    match was_interrupted {
        true => Err(error::interrupted(py, Some(fields.as_any()), None)),
        false => Ok(fields),
    }
}

fn to_python<'py>(py: Python<'py>, found: &Profile) -> PyResult<Bound<'py, PyDict>> {
    let of = |profile: &ParameterProfile| {
        let rows: Vec<Vec<f64>> = profile.points.iter().map(|point| point.x.clone()).collect();
        Ok(dict!(py;
            profile => name, optimum, factor;
            "values": PyArray1::from_iter(py, profile.points.iter().map(|p| p.value)),
            "costs": PyArray1::from_iter(py, profile.points.iter().map(|p| p.statistic)),
            "points": PyArray2::from_vec2(py, &rows)?,
            "interval": profile.interval(),
            "message": profile.message(),
        ))
    };
    Ok(dict!(py;
        found => level, threshold, degrees_of_freedom, n_simulations;
        "profiles": found.parameters.iter().map(of).collect::<PyResult<Vec<_>>>()?,
        "x": PyArray1::from_slice(py, &found.x),
        "interrupted": found.is_interrupted,
        "autocorrelated": found.is_autocorrelated,
        "stats": Counts::new(&found.stats),
        "text": found.to_string(),
    ))
}
