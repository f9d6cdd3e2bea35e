//! `Calibration`: a model, measurements and parameters; costs, residuals and fits without the interpreter lock.

use crate::description::Fmu;
use crate::error;
use crate::files;
use crate::fmu_error;
use crate::interrupt::{Watch, fits_here};
use crate::logs;
use crate::report::{self, LastSeen, Listener};
use crate::settings::{self, Options, Settings, time_limit};
use crate::trajectory::Counts;
use crate::values;
use calibration::{
    CalibrationError, Data, Entry, Experiment, FitOptions, Parameter, Scale, SimulationSettings, TimeColumn,
    Verdict,
};
use dfo::{Progress, Termination};
use fmi::FmiError;
use fmi::OpenOptions;
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// `pydfo.Parameter`, field by field.
#[derive(FromPyObject)]
pub(crate) struct ParameterFields {
    name: String,
    start: f64,
    lower: f64,
    upper: f64,
    scale: String,
    nominal: Option<f64>,
    kind: String,
    fixed: bool,
}

impl ParameterFields {
    fn check(self, py: Python<'_>) -> PyResult<Parameter> {
        let scale = settings::word("scale", &self.scale, &[("linear", Scale::Linear), ("log", Scale::Log)])?;
        let kind = settings::kind("kind", &self.kind)?;
        let mut parameter = Parameter::new(self.name, self.start)
            .bounds(self.lower, self.upper)
            .scale(scale)
            .kind(kind)
            .fixed(self.fixed);
        if let Some(nominal) = self.nominal {
            parameter = parameter.nominal(nominal);
        }
        parameter.check().map_err(|e| error::calibration(py, &e))?;
        Ok(parameter)
    }
}

/// Checks the numbers of a `pydfo.Parameter`.
#[pyfunction]
pub(crate) fn check_parameter(py: Python<'_>, parameter: ParameterFields) -> PyResult<()> {
    parameter.check(py).map(|_| ())
}

/// `pydfo._calibration.ExperimentFields`, field by field.
#[derive(FromPyObject)]
pub(crate) struct ExperimentFields {
    /// A CSV file; None: `columns`.
    path: Option<PathBuf>,
    columns: Vec<(String, Vec<f64>)>,
    /// Names of columns that are not among them.
    left_out: Vec<String>,
    /// Name of the column of times; None: "time".
    time: Option<String>,
    /// Variable, column, weight.
    outputs: Vec<(String, String, f64)>,
    /// Variable, column.
    inputs: Vec<(String, String)>,
    start_values: Vec<(String, Py<PyAny>)>,
    window: Option<(f64, f64)>,
    kind: String,
    start_time: Option<f64>,
    timeout: Option<f64>,
    relative_tolerance: Option<f64>,
    solver: String,
    step_size: Option<f64>,
    max_step: Option<f64>,
    input_derivatives: bool,
    chattering: String,
    sharing: String,
}

impl ExperimentFields {
    fn settings(&self, py: Python<'_>) -> PyResult<SimulationSettings> {
        Ok(SimulationSettings {
            kind: self.kind.parse().map_err(|e| fmu_error::raise(py, &e))?,
            method: self.solver.parse().map_err(|e| fmu_error::raise(py, &FmiError::Options(e)))?,
            relative_tolerance: self.relative_tolerance,
            step_size: self.step_size,
            max_step: self.max_step,
            input_derivatives: Some(self.input_derivatives),
            timeout: time_limit("timeout", self.timeout)?,
            chattering: self.chattering.parse().map_err(|e| fmu_error::raise(py, &FmiError::Options(e)))?,
            sharing: self.sharing.parse().map_err(|e| fmu_error::raise(py, &e))?,
        })
    }

    fn start_values(&self, py: Python<'_>, fmu: &fmi::Fmu) -> PyResult<Vec<(String, fmi::Value)>> {
        let given = self.start_values.iter().map(|(name, value)| (name.clone(), value.bind(py).clone()));
        values::all_from_python(py, fmu.description(), given)
    }

    fn experiment(self, start_values: Vec<(String, fmi::Value)>) -> Result<Experiment, CalibrationError> {
        let data = match (self.path, &self.time) {
            (Some(path), None) => Data::from_csv(path)?,
            (Some(path), Some(time)) => Data::from_csv_with_time(path, time)?,
            (None, time) => Data::from_table(self.columns, time.as_deref())?.left_out(self.left_out),
        };
        let mut experiment = Experiment::new(data);
        for (variable, column, weight) in self.outputs {
            experiment = experiment.weighted_output(variable, column, weight);
        }
        for (variable, column) in self.inputs {
            experiment = experiment.input(variable, column);
        }
        for (variable, value) in start_values {
            experiment = experiment.start_value(variable, value);
        }
        if let Some((from, to)) = self.window {
            experiment = experiment.window(from, to);
        }
        if let Some(time) = self.start_time {
            experiment = experiment.start_time(time);
        }
        Ok(experiment)
    }
}

/// Position of the column of times among columns of these names, and the length of its unit in s as a fraction.
#[pyfunction]
#[pyo3(signature = (names, time=None))]
pub(crate) fn find_time(names: Vec<String>, time: Option<&str>) -> PyResult<(usize, (f64, f64))> {
    let found = TimeColumn::find(names.iter().map(String::as_str), time);
    found.map(|column| (column.index, column.unit)).map_err(PyValueError::new_err)
}

/// A calibration; `pydfo.Calibration` is its face.
#[pyclass(frozen, module = "pydfo._core", name = "Calibration")]
pub(crate) struct PyCalibration {
    inner: Arc<calibration::Calibration>,
    /// How long the last evaluation took, in ns; 0: there was none.
    last: Arc<AtomicU64>,
}

impl PyCalibration {
    /// Evaluates without the interpreter lock: on the calling thread if the last evaluation was short. Ctrl-C ends it at
    /// the next step.
    fn compute<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&calibration::Calibration, &dyn Fn() -> bool) -> Result<T, CalibrationError>
        + Send
        + 'static,
    ) -> PyResult<T> {
        let last = self.last.load(Ordering::Relaxed);
        let last = (last > 0).then(|| Duration::from_nanos(last));
        let (inner, took) = (Arc::clone(&self.inner), Arc::clone(&self.last));
        let timed = move |cancelled: &dyn Fn() -> bool| {
            let begun = Instant::now();
            let result = work(&inner, cancelled);
            took.store(
                u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX).max(1),
                Ordering::Relaxed,
            );
            result
        };
        let watch;
        let result = if fits_here(last) {
            watch = Watch::without_handler(py);
            Some(watch.run_here(timed))
        } else {
            watch = Watch::new(py)?;
            let flag = watch.stop().flag();
            watch.run_briefly(move || timed(&|| flag.load(Ordering::Relaxed)))?
        };
        logs::pass_on(py)?;
        if let Some(e) = watch.stop().take_raised() {
            return Err(e);
        }
        match result {
            _ if watch.stop().is_asked() => Err(error::interrupted(py, None, None)),
            Some(result) => result.map_err(|e| error::calibration(py, &e)),
            None => Err(error::interrupted(py, None, None)),
        }
    }
}

/// The model: as it was opened, or where it is.
#[derive(FromPyObject)]
enum Source<'py> {
    #[pyo3(transparent)]
    Open(Bound<'py, Fmu>),
    #[pyo3(transparent)]
    Path(PathBuf),
}

#[pymethods]
impl PyCalibration {
    #[new]
    fn new(
        py: Python<'_>,
        model: Source<'_>,
        experiment: ExperimentFields,
        parameters: Vec<ParameterFields>,
    ) -> PyResult<Self> {
        let fmu = match model {
            Source::Open(fmu) => fmu.get().fmu.clone(),
            Source::Path(path) => files::open(py, path, &OpenOptions::default())?,
        };
        let settings = experiment.settings(py)?;
        let parameters = parameters.into_iter().map(|p| p.check(py)).collect::<PyResult<Vec<_>>>()?;
        let start_values = experiment.start_values(py, &fmu)?;
        let built = py.detach(move || {
            let builder = calibration::Calibration::builder(fmu)
                .experiment(experiment.experiment(start_values)?)
                .settings(settings);
            parameters.into_iter().fold(builder, |builder, parameter| builder.parameter(parameter)).build()
        });
        logs::pass_on(py)?;
        let inner = built.map_err(|e| error::calibration(py, &e))?;
        Ok(Self { inner: Arc::new(inner), last: Arc::default() })
    }

    /// What may not be meant as it was given.
    fn warnings(&self) -> Vec<String> {
        self.inner.warnings().iter().map(ToString::to_string).collect()
    }

    #[getter]
    fn n_residuals(&self) -> usize {
        self.inner.n_residuals()
    }

    /// Name of the integration method that is in use; None: not chosen yet.
    fn known_solver(&self) -> Option<&'static str> {
        self.inner.known_solver().map(|solver| solver.method.name())
    }

    /// The same, chosen if it is not yet.
    fn solver(&self, py: Python<'_>) -> PyResult<&'static str> {
        self.compute(py, |calibration, cancelled| {
            calibration.solver_until(cancelled).map(|solver| solver.method.name())
        })
    }

    /// The methods that were compared: name, work, how far from right, what became of it.
    fn race(&self) -> Option<Vec<Raced>> {
        let race = self.inner.known_solver()?.race.as_ref()?;
        let raced = |entry: &Entry| {
            let (deviation, verdict) = match &entry.verdict {
                Verdict::Agrees(distance) => (Some(*distance), "agrees".to_owned()),
                Verdict::Differs(distance) => (Some(*distance), "differs".to_owned()),
                Verdict::GivenUp => (None, "given up".to_owned()),
                Verdict::Failed(why) => (None, format!("failed: {why}")),
                _ => (None, "not compared".to_owned()),
            };
            (entry.method.name(), entry.work, deviation, verdict)
        };
        Some(race.entries.iter().map(raced).collect())
    }

    fn cost(&self, py: Python<'_>, x: Vec<f64>) -> PyResult<f64> {
        self.compute(py, move |calibration, cancelled| calibration.cost_until(&x, cancelled))
    }

    fn residuals<'py>(&self, py: Python<'py>, x: Vec<f64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let residuals =
            self.compute(py, move |calibration, cancelled| calibration.residuals_until(&x, cancelled))?;
        Ok(PyArray1::from_vec(py, residuals))
    }

    /// `time` and the compared outputs, at the measured times or at those given.
    #[pyo3(signature = (x, times=None))]
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        x: Vec<f64>,
        times: Option<Vec<f64>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let trajectories = self.compute(py, move |calibration, cancelled| {
            calibration.simulate_until(&x, times.as_deref(), cancelled)
        })?;
        let columns = PyDict::new(py);
        for trajectory in trajectories {
            columns.set_item("time", PyArray1::from_vec(py, trajectory.time))?;
            for (name, values) in trajectory.names.iter().zip(trajectory.columns) {
                columns.set_item(name, PyArray1::from_vec(py, values))?;
            }
        }
        Ok(columns)
    }

    /// The recording: its times, and per output the variable, the column and its values (NaN where missing).
    fn measurements<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Vec<Measured<'py>>)> {
        let mut times = PyArray1::from_slice(py, &[]);
        let mut measured = Vec::new();
        for (data, outputs) in self.inner.comparisons() {
            times = PyArray1::from_slice(py, data.time());
            for (variable, column) in outputs {
                let values = data.column(column).map_err(|e| error::calibration(py, &e))?;
                measured.push((variable.clone(), column.clone(), PyArray1::from_slice(py, values)));
            }
        }
        Ok((times, measured))
    }

    #[pyo3(signature = (options, *, start=None, observer=None))]
    fn fit<'py>(
        &self,
        py: Python<'py>,
        options: Options,
        start: Option<Vec<f64>>,
        observer: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let Settings { run, .. } = options.check(py)?;
        let watch = Watch::new(py)?;
        let stop = Arc::clone(watch.stop());
        let listener = observer.map(|function| Arc::new(Listener::new(function, false)));
        let last_seen = Arc::new(LastSeen::default());
        let (inner, asked) = (Arc::clone(&self.inner), Arc::clone(&stop));
        let (seen, hearing) = (Arc::clone(&last_seen), listener.clone());
        let outcome = watch.run(move |desk| {
            inner.fit(FitOptions {
                run,
                start,
                observer: Some(Box::new(|progress: &Progress<'_>| {
                    seen.pass_on(progress, desk, hearing.as_ref())
                })),
                cancel: Some(asked.flag()),
                poll: asked.has_parent().then(|| Box::new(|| asked.is_asked()) as Box<dyn FnMut() -> bool>),
                ..FitOptions::default()
            })
        })?;
        logs::pass_on(py)?;
        let Some(outcome) = outcome else {
            return Err(error::interrupted(py, last_seen.result(py)?.as_ref(), None));
        };
        let mut raised = listener.and_then(|l| l.take_raised()).or_else(|| stop.take_raised());
        let result = match outcome {
            Ok(fit) => {
                // No simulation can be made any more.
                if let (None, Termination::Aborted(reason)) = (&raised, &fit.report.termination) {
                    raised = Some(fmu_error::unusable(reason));
                }
                let result = report::to_python(py, &fit.report)?;
                result.setattr("stats", Counts::new(&fit.stats))?;
                let at_bound = fit.at_bound.iter().map(|(i, side)| (&fit.names[*i], side.name()));
                result.setattr("at_bound", at_bound.into_py_dict(py)?)?;
                let inert: Vec<&String> = fit.without_effect.iter().map(|i| &fit.names[*i]).collect();
                result.setattr("without_effect", inert)?;
                result.setattr("n_checks", fit.n_checks)?;
                result.setattr("n_beginnings", fit.n_beginnings)?;
                Some(result)
            }
            Err(e) if raised.is_none() && !stop.is_asked() => return Err(error::calibration(py, &e)),
            Err(_) => None,
        };
        error::ended(py, &stop, raised, result)
    }
}

/// Solver, work, deviation in tolerances, verdict.
type Raced = (&'static str, Option<f64>, Option<f64>, String);

/// Variable, column, values.
type Measured<'py> = (String, String, Bound<'py, PyArray1<f64>>);
