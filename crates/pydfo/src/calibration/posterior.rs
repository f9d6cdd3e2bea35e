//! Samples of the posterior distribution, as the fields of `pydfo.Posterior`.

use crate::calibration::fit::PyFit;
use crate::convert::dict::dict;
use crate::convert::error;
use crate::model::trajectory::Counts;
use calibration::RunContext;
use calibration::{Posterior, PosteriorOptions, WalkerStart};
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Implements `Fit.sample`. `extent`: steps, warm-up and walkers. `is_from_box`: the walkers start in the box
/// of the bounds. `observer` is called with the number of completed steps. An interrupt carries the fields of
/// the partial result.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
#[pyo3(signature = (fit, extent, is_from_box, seed, workers, checkpoint, observer))]
pub(crate) fn sample<'py>(
    py: Python<'py>,
    fit: &PyFit,
    extent: (usize, Option<usize>, Option<usize>),
    is_from_box: bool,
    seed: Option<u64>,
    workers: Option<usize>,
    checkpoint: Option<PathBuf>,
    observer: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (n_steps, n_warmup, n_walkers) = extent;
    let start = if is_from_box { WalkerStart::Box } else { WalkerStart::Fit };
    let options = PosteriorOptions { n_steps, n_warmup, n_walkers, start, seed, workers, checkpoint };
    let inner = fit.inner.clone();
    let work = move |calibration: &calibration::Calibration, context: &RunContext<'_>| {
        let mut progress = |step: usize| {
            if let Some(observer) = &observer {
                // An exception of the display does not end the run.
                Python::attach(|py| {
                    observer.call1(py, (step,)).map_or_else(|e| e.write_unraisable(py, None), drop);
                });
            }
        };
        calibration.sample(&inner, &options, &mut progress, context)
    };
    let (found, was_interrupted) = fit.calibration.compute_to_end(py, work)?;
    let fields = to_python(py, &found)?;
    match was_interrupted {
        true => Err(error::interrupted(py, Some(fields.as_any()), None)),
        false => Ok(fields),
    }
}

fn to_python<'py>(py: Python<'py>, found: &Posterior) -> PyResult<Bound<'py, PyDict>> {
    let n = found.parameters.len();
    let shape = (found.n_steps, found.n_walkers, n);
    let chain = Array3::from_shape_vec(shape, found.draws.clone())
        .map_err(|e| pyo3::exceptions::PyRuntimeError::new_err(e.to_string()))?;
    let of = |of: fn(&calibration::PosteriorParameter) -> f64| {
        PyArray1::from_iter(py, found.parameters.iter().map(of))
    };
    Ok(dict!(py;
        found => acceptance, seed, n_simulations, n_failed, n_warmup;
        "names": found.parameters.iter().map(|p| p.name.clone()).collect::<Vec<_>>(),
        "chain": chain.into_pyarray(py),
        "log_density": PyArray1::from_slice(py, &found.log_densities),
        "mean": of(|p| p.mean),
        "sd": of(|p| p.sd),
        "r_hat": of(|p| p.r_hat),
        "effective_draws": of(|p| p.effective_draws),
        "converged": found.is_converged(),
        "interrupted": found.is_interrupted,
        "stats": Counts::new(&found.stats),
        "text": found.to_string(),
    ))
}
