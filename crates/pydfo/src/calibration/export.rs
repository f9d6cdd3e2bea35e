//! Handing a fit on: to a file that is read back, to tables, to other programs.

use crate::calibration::experiment::SignalFunctions;
use crate::calibration::fit::PyFit;
use crate::calibration::native::{PyCalibration, compute_of, give_functions};
use crate::convert::error;
use crate::convert::object;
use crate::convert::record::read;
use crate::model::description::Fmu;
use crate::model::files;
use crate::model::trajectory;
use calibration::{SavedFit, Table};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;

/// Writes a fit to a file.
#[pyfunction]
pub(crate) fn save_fit(py: Python<'_>, fit: &PyFit, path: PathBuf) -> PyResult<()> {
    py.detach(|| fit.inner.save(&fit.calibration, path)).map_err(|e| error::calibration(py, &e))
}

/// The bytes of that file.
#[pyfunction]
pub(crate) fn fit_to_bytes<'py>(py: Python<'py>, fit: &PyFit) -> PyResult<Bound<'py, PyBytes>> {
    let bytes = py.detach(|| fit.inner.to_bytes(&fit.calibration)).map_err(|e| error::calibration(py, &e))?;
    Ok(PyBytes::new(py, &bytes))
}

/// The inputs of a fit in a file that functions drove: number and name of the experiment, input.
#[pyfunction]
pub(crate) fn functions_of_fit(py: Python<'_>, path: PathBuf) -> PyResult<Vec<(usize, String, String)>> {
    let saved = py.detach(|| SavedFit::load(&path)).map_err(|e| error::calibration(py, &e))?;
    let names = saved.problem.experiment_names().into_iter().enumerate();
    let lost = names.zip(&saved.problem.experiments).flat_map(|((k, name), experiment)| {
        experiment.lost_functions().map(move |input| (k, name.clone(), input.to_owned())).collect::<Vec<_>>()
    });
    Ok(lost.collect())
}

/// A fit from a file, or from its bytes, with its model: the one given, else the one at its place if that has
/// the content. Its calibration, and what a `pydfo.Fit` is made of.
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
    let calibration = PyCalibration::finish(py, made, callbacks)?;
    let result = calibration.result(py, saved.fit)?;
    Ok((calibration, result))
}

/// The place of the model of a calibration, and the arguments of the `pydfo.Parameter` of each of its
/// parameters.
#[pyfunction]
pub(crate) fn parameters_of<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
) -> PyResult<(PathBuf, Vec<Bound<'py, PyDict>>)> {
    let problem = calibration.inner.problem();
    let arguments = |parameter: &calibration::Parameter| {
        let record = parameter.record().map_err(|e| error::calibration(py, &e))?;
        object::fields(py, &record)
    };
    let all = problem.parameters.iter().map(arguments).collect::<PyResult<_>>()?;
    Ok((problem.model.path.clone(), all))
}

/// The numbers of a fit as JSON.
#[pyfunction]
pub(crate) fn fit_to_json(py: Python<'_>, fit: &PyFit) -> PyResult<String> {
    fit.inner.to_json(&fit.calibration).map_err(|e| error::calibration(py, &e))
}

/// A table of a fit as text; written to `path`, where there is one.
#[pyfunction]
#[pyo3(signature = (fit, table, path=None))]
pub(crate) fn fit_to_csv(
    py: Python<'_>,
    fit: &PyFit,
    table: &str,
    path: Option<PathBuf>,
) -> PyResult<String> {
    let table: Table = read("what", table)?;
    compute_of(py, fit, move |calibration, fit, context| match path {
        Some(path) => fit.write_csv(calibration, path, table, context).map(|()| String::new()),
        None => fit.csv(calibration, table, context),
    })
}

/// The variables that the parameters set, and their values at `x`.
#[pyfunction]
#[pyo3(signature = (calibration, x, experiment=None))]
pub(crate) fn variable_values(
    py: Python<'_>,
    calibration: &PyCalibration,
    x: Vec<f64>,
    experiment: Option<&str>,
) -> PyResult<Vec<(String, f64)>> {
    calibration.inner.variable_values(&x, experiment).map_err(|e| error::calibration(py, &e))
}

/// Per experiment what `pydfo.SimulationResult` is made of: these variables of the model at `x`.
#[pyfunction]
#[pyo3(signature = (calibration, x, times, variables))]
pub(crate) fn simulate_variables<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    x: Vec<f64>,
    times: Option<Vec<f64>>,
    variables: Vec<String>,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let trajectories = calibration.compute(py, move |calibration, context| {
        let simulate = |k| calibration.simulate_variables(k, &x, times.as_deref(), &variables, context);
        (0..calibration.problem().experiments.len()).map(simulate).collect::<Result<Vec<_>, _>>()
    })?;
    let description = calibration.inner.fmu().description();
    trajectories.into_iter().map(|trajectory| trajectory::record(py, description, trajectory)).collect()
}

/// Writes an SSP parameter file.
#[pyfunction]
#[pyo3(signature = (fit, path, experiment=None))]
pub(crate) fn export_ssv(
    py: Python<'_>,
    fit: &PyFit,
    path: PathBuf,
    experiment: Option<&str>,
) -> PyResult<()> {
    let written = py.detach(|| fit.inner.export_ssv(&fit.calibration, path, experiment));
    written.map_err(|e| error::calibration(py, &e))
}

/// Writes a copy of the FMU: the copy, the parameter file and the warning, as far as there are any.
#[pyfunction]
#[pyo3(signature = (fit, path, experiment=None, keep=false))]
pub(crate) fn export_fmu(
    py: Python<'_>,
    fit: &PyFit,
    path: PathBuf,
    experiment: Option<String>,
    keep: bool,
) -> PyResult<(Option<PathBuf>, Option<PathBuf>, Option<String>)> {
    let written = compute_of(py, fit, move |calibration, fit, context| {
        fit.export_fmu(calibration, path, experiment.as_deref(), keep, context)
    })?;
    Ok((written.fmu, written.ssv, written.warning))
}
