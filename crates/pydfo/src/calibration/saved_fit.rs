//! Fits read from files.

use crate::calibration::calibration_class::{PyCalibration, give_functions};
use crate::calibration::experiment::SignalFunctions;
use crate::calibration::fit;
use crate::calibration::shared::Shared;
use crate::convert::error;
use crate::model::description::Fmu;
use crate::model::files;
use calibration::SavedFit;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Returns the inputs of a saved fit driven by functions: index and name of the experiment, and
/// input.
#[pyfunction]
pub(crate) fn functions_of_fit(py: Python<'_>, path: PathBuf) -> PyResult<Vec<(usize, String, String)>> {
    let saved = py.detach(|| SavedFit::load(&path)).map_err(|e| error::calibration(py, &e))?;
    let names = saved.problem.experiment_names().into_iter().enumerate();
    let lost = names.zip(&saved.problem.experiments).flat_map(|((k, name), experiment)| {
        experiment.lost_functions().map(move |input| (k, name.clone(), input.to_owned())).collect::<Vec<_>>()
    });
    Ok(lost.collect())
}

/// Reads a fit from a file, or from its bytes, with its model. The model is the given one, otherwise the one
/// at its stored path if its content matches. Returns its calibration, and the fields of a `pydfo.Fit`.
#[pyfunction]
#[pyo3(signature = (path, content=None, model=None, functions=Vec::new()))]
pub(crate) fn load_fit<'py>(
    py: Python<'py>,
    path: PathBuf,
    content: Option<&[u8]>,
    model: Option<&Bound<'py, Fmu>>,
    functions: SignalFunctions,
) -> PyResult<(PyCalibration, Bound<'py, PyAny>)> {
    let saved = py.detach(|| match content {
        Some(bytes) => SavedFit::from_bytes(bytes, &path.display().to_string()),
        None => SavedFit::load(&path),
    });
    let mut saved = saved.map_err(|e| error::calibration(py, &e))?;
    let callbacks = give_functions(&mut saved.problem, functions);
    let opened = match model {
        Some(_) => None,
        None => Some(files::try_open(py, saved.problem.model.path.clone(), &saved.open_options)?),
    };
    let model = model.map(|model| model.get().fmu.clone());
    let made = py.detach(|| match (model, opened) {
        (Some(fmu), _) => saved.calibration_with(fmu),
        (None, Some(opened)) => saved.calibration_from(opened),
        (None, None) => saved.calibration(),
    });
    let calibration = Shared::finish(py, made, callbacks)?;
    let result = fit::result(py, &calibration, saved.fit)?;
    Ok((PyCalibration { shared: calibration }, result))
}
