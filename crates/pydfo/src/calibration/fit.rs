//! `Fit`: the native result of a fit and its calibration, stored by `pydfo.Fit`, and its conversions.

use crate::calibration::shared::Shared;
use crate::calibration::uncertainty::{PyUncertainty, preflight};
use crate::convert::dict::dict;
use crate::convert::error;
use crate::convert::object;
use crate::convert::record::read;
use crate::convert::report::{self, ResultKind};
use crate::model::files::allow_replacement;
use crate::model::trajectory::Counts;
use calibration::{BootstrapOptions, Calibration, CalibrationError, Fit, OutputResiduals, RunContext, Table};
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyBytes, PyDict};
use std::path::PathBuf;
use std::sync::Arc;

/// A fit and its calibration.
#[pyclass(frozen, module = "pydfo._core", name = "Fit")]
pub(crate) struct PyFit {
    pub(crate) inner: Arc<Fit>,
    pub(crate) calibration: Shared,
}

/// Returns a fit as `pydfo.OptimizeResult`, with the native fit attached.
pub(crate) fn result<'py>(py: Python<'py>, calibration: &Shared, fit: Fit) -> PyResult<Bound<'py, PyAny>> {
    let kind = if fit.report.front.is_some() { ResultKind::Front } else { ResultKind::Cost };
    let result = report::to_python(py, fit.report.clone(), kind, &|| false)?;
    result.setattr("_native", PyFit { inner: Arc::new(fit), calibration: calibration.clone() })?;
    Ok(result)
}

impl PyFit {
    /// Computes with the fit and its calibration, like [`Shared::compute`].
    pub(crate) fn compute<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Calibration, &Fit, &RunContext<'_>) -> Result<T, CalibrationError> + Send + 'static,
    ) -> PyResult<T> {
        let inner = Arc::clone(&self.inner);
        self.calibration.compute(py, move |calibration, context| work(calibration, &inner, context))
    }

    /// Runs work without simulations, without the interpreter lock.
    fn write<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Fit, &Calibration) -> Result<T, CalibrationError> + Send,
    ) -> PyResult<T> {
        py.detach(|| work(&self.inner, &self.calibration.inner)).map_err(|e| error::calibration(py, &e))
    }
}

#[pymethods]
impl PyFit {
    /// Returns the fields of `pydfo.Fit` that its run does not contain.
    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let fit = &*self.inner;
        let at_bound = fit.at_bound.iter().map(|(i, side)| (&fit.names[*i], side.name()));
        let stages = fit.stages.iter().map(|stage| result(py, &self.calibration, stage.clone()));
        let stats = Counts::new(&fit.stats).into_pyobject(py)?;
        let phases = fit.phases.iter().map(|cost| {
            let taken = &cost.taken;
            let taken = dict!(py; taken => simulations, right_hand_sides; "seconds": taken.seconds.get());
            Ok((cost.phase.key(), taken))
        });
        stats.set_item("phases", phases.collect::<PyResult<Vec<_>>>()?.into_py_dict(py)?)?;
        Ok(dict!(py;
            fit => start_cost, start_rms, rms, objective, n_checks;
            "skipped": &fit.skipped,
            "success": fit.is_success(),
            "usable": fit.is_usable(),
            "stats": stats,
            "at_bound": at_bound.into_py_dict(py)?,
            "without_effect": fit.without_effect.iter().map(|i| &fit.names[*i]).collect::<Vec<_>>(),
            "stages": stages.collect::<PyResult<Vec<_>>>()?,
            "noise": object::to_python(py, &fit.noise)?,
            "tolerance": object::to_python(py, &fit.tolerance)?,
            "outputs": object::to_python(py, &fit.outputs)?,
            "findings": object::to_python(py, &fit.findings())?,
            "preflight": fit.preflight.as_ref().map(|found| preflight(py, found)).transpose()?,
            "uncertainty": fit.uncertainty.clone().map(PyUncertainty::new),
        ))
    }

    /// Start point of the fit.
    #[getter]
    fn start(&self) -> Vec<f64> {
        self.inner.start.clone()
    }

    /// Returns names and standard errors of the derived parameters; empty if the fit has no uncertainty.
    fn derived_errors(&self) -> Vec<(String, f64)> {
        let errors = self.inner.uncertainty.iter().flat_map(|uncertainty| {
            let error = |derived: &calibration::DerivedValue| derived.standard_error(uncertainty);
            self.inner.derived.iter().map(move |derived| (derived.name.clone(), error(derived)))
        });
        errors.collect()
    }

    /// Names of the parameters in reports and figures.
    #[getter]
    fn shown_names(&self) -> Vec<String> {
        self.inner.shown_names().to_vec()
    }

    /// The summary as plain text.
    fn text(&self) -> String {
        self.inner.to_string()
    }

    /// Returns the fields of `pydfo.Goodness`.
    fn goodness<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        object::to_python(py, &self.inner.goodness())
    }

    /// Compares with another fit. Returns the fields of `pydfo.Comparison` and its text.
    fn compare<'py>(&self, py: Python<'py>, other: &Self) -> PyResult<(Bound<'py, PyAny>, String)> {
        let found = self.inner.compare(&other.inner).map_err(PyValueError::new_err)?;
        Ok((object::to_python(py, &found)?, found.to_string()))
    }

    /// Returns the fields of `pydfo.Bootstrap` and its text.
    fn bootstrap<'py>(
        &self,
        py: Python<'py>,
        n: usize,
        kind: &str,
        seed: Option<u64>,
        workers: Option<usize>,
        checkpoint: Option<PathBuf>,
    ) -> PyResult<(Bound<'py, PyAny>, String)> {
        let options = BootstrapOptions { n, kind: read("kind", kind)?, seed, workers, checkpoint };
        let found =
            self.compute(py, move |calibration, fit, context| calibration.bootstrap(fit, &options, context))?;
        Ok((object::to_python(py, &found)?, found.to_string()))
    }

    /// The summary as an HTML element.
    fn html(&self) -> String {
        self.inner.to_html()
    }

    /// Writes the report.
    fn report(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.compute(py, |calibration, fit, context| calibration.report(fit, path, context))
    }

    /// Time unit of the model.
    fn time_unit(&self) -> String {
        self.calibration.inner.fmu().description().time_unit().to_owned()
    }

    /// Returns the curves to plot, per experiment.
    fn curves<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        object::to_python(py, &self.compute(py, Calibration::curves)?)
    }

    /// Returns the changes of each output for a relative change of each parameter. Per output: its name, its
    /// times, and a row per parameter. Empty if unknown.
    fn sensitivities<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let calibration = &self.calibration.inner;
        let names = calibration.problem().experiment_names();
        let output = |(series, columns): (&OutputResiduals, Vec<Vec<f64>>)| {
            let declared = calibration.fmu().description().variable(&series.variable);
            Ok(dict!(py; series => variable;
                "experiment": &names[series.experiment],
                "unit": declared.and_then(|v| v.unit.as_ref()),
                "times": PyArray1::from_slice(py, &series.times),
                "rows": PyArray2::from_vec2(py, &columns)?,
            ))
        };
        let all = calibration.sensitivities(&self.inner);
        calibration.residual_layout().outputs.iter().zip(all).map(output).collect()
    }

    /// Writes the fit to a file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.write(py, |fit, calibration| fit.save(calibration, path))
    }

    /// Returns the bytes of the file that `save` writes.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.write(py, Fit::to_bytes)?))
    }

    /// Returns the numbers as JSON.
    fn to_json(&self, py: Python<'_>) -> PyResult<String> {
        self.write(py, Fit::to_json)
    }

    /// Returns a table as text. If `path` is given, writes the table there instead.
    #[pyo3(signature = (table, path=None))]
    fn to_csv(&self, py: Python<'_>, table: &str, path: Option<PathBuf>) -> PyResult<String> {
        let table: Table = read("what", table)?;
        self.compute(py, move |calibration, fit, context| match path {
            Some(path) => fit.write_csv(calibration, path, table, context).map(|()| String::new()),
            None => fit.csv(calibration, table, context),
        })
    }

    /// Writes an SSP parameter file.
    fn export_ssv(&self, py: Python<'_>, path: PathBuf, experiment: Option<&str>) -> PyResult<()> {
        self.write(py, |fit, calibration| fit.export_ssv(calibration, path, experiment))
    }

    /// Writes a copy of the FMU. Returns the copy, the parameter file and the warning, if there are any.
    fn export_fmu(
        &self,
        py: Python<'_>,
        path: PathBuf,
        experiment: Option<String>,
        keep: bool,
    ) -> PyResult<(Option<PathBuf>, Option<PathBuf>, Option<String>)> {
        allow_replacement(py);
        let written = self.compute(py, move |calibration, fit, context| {
            fit.export_fmu(calibration, path, experiment.as_deref(), keep, context)
        })?;
        Ok((written.fmu, written.ssv, written.warning))
    }
}
