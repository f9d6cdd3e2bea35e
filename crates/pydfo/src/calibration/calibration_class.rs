//! `Calibration`: a model, measurements and parameters. Costs, residuals and fits are computed without the
//! interpreter lock.

use crate::calibration::cost::{self, CostFields};
use crate::calibration::experiment::{ExperimentFields, PyParameter, SignalFunctions};
use crate::calibration::fit;
use crate::calibration::live_page::PyLivePage;
use crate::calibration::shared::Shared;
use crate::calibration::uncertainty::{self, PyUncertainty};
use crate::convert::error;
use crate::convert::fmu_error;
use crate::convert::object;
use crate::convert::record::{PyRecord, read};
use crate::convert::report::{self, LastProgress, Listener};
use crate::interrupt::interrupt_guard::{CallingThread, InterruptGuard};
use crate::interrupt::lock::lock;
use crate::interrupt::logs;
use crate::model::description::Fmu;
use crate::model::files;
use crate::model::inputs::Callbacks;
use crate::model::trajectory;
use crate::optimize::futures::{PySimulationExecutor, state};
use calibration::RunContext;
use calibration::{
    CalibrationError, Design, Experiment, FitOptions, LivePage, PreflightOptions, Problem, Severity,
    SimulationExecutor, UncertaintyOptions,
};
use dfo::{EvaluationKind, Progress, Query, RobustLoss, Termination, Value};
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyBytes, PyDict};
use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A calibration; `pydfo.Calibration` is its Python class.
#[pyclass(frozen, module = "pydfo._core", name = "Calibration")]
pub(crate) struct PyCalibration {
    pub(crate) shared: Shared,
}

impl PyCalibration {
    pub(crate) fn inner(&self) -> &calibration::Calibration {
        &self.shared.inner
    }
}

/// Adds the functions of time that drive inputs to the experiments of a stored problem.
pub(crate) fn give_functions(problem: &mut Problem, functions: SignalFunctions) -> Callbacks {
    let mut callbacks = Callbacks::default();
    for (k, input, function) in functions {
        let callback = callbacks.add(function);
        if let Some(experiment) = problem.experiments.get_mut(k) {
            *experiment = experiment.clone().function_input(input, move |t| callback.value(t, 0));
        }
    }
    callbacks
}

/// Options of a fit that do not belong to its run.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct FitFields {
    start: Option<Vec<f64>>,
    observer: Option<Py<PyAny>>,
    stages: Option<Vec<PyRecord>>,
    objective: Option<CostFields>,
    /// A `_engine.Simulations`.
    engine: Option<Py<PyAny>>,
    /// Callable that receives the live page once the options are checked.
    page: Option<Py<PyAny>>,
}

/// The model: opened, or its path.
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
        experiments: Vec<ExperimentFields>,
        settings: PyRecord,
        parameters: Vec<PyParameter>,
        constraints: Vec<String>,
        design: (Vec<String>, String),
    ) -> PyResult<Self> {
        // Objectives of a design, and their combination over the scenarios.
        let (goals, combine) = design;
        let settings = settings.settings(py)?;
        let fmu = match model {
            Source::Open(fmu) => fmu.get().fmu.clone(),
            Source::Path(path) => files::open(py, path, &settings.open_options())?,
        };
        let parameters = parameters.into_iter().map(|p| p.check(py)).collect::<PyResult<Vec<_>>>()?;
        let constraint = |text: String| {
            text.parse::<calibration::Relation>().map_err(|e| {
                let message = format!("constraint '{text}': {e}");
                error::calibration(py, &CalibrationError::Setup(message))
            })
        };
        let constraints = constraints.into_iter().map(constraint).collect::<PyResult<Vec<_>>>()?;
        let goal = |text: String| {
            text.parse::<calibration::Goal>().map_err(|e| {
                error::calibration(py, &CalibrationError::Setup(format!("objective '{text}': {e}")))
            })
        };
        let goals = goals.into_iter().map(goal).collect::<PyResult<Vec<_>>>()?;
        let combination =
            calibration::Combination::named(&combine).map_err(|e| error::calibration(py, &e))?;
        // The name of the experiment, if there are several.
        let is_one = experiments.len() == 1;
        let mut callbacks = Callbacks::default();
        let mut named = |(k, mut experiment): (usize, ExperimentFields)| {
            let name = || experiment.name.clone().unwrap_or_else(|| Experiment::default_name(k));
            let name = (!is_one).then(name);
            let resolved =
                experiment.resolve(py, &fmu, &parameters, &mut callbacks).map_err(|e| match &name {
                    Some(name) => {
                        let message = format!("{name}: {}", e.value(py));
                        error::reworded(py, e, message)
                    }
                    None => e,
                })?;
            Ok((name, resolved, experiment))
        };
        let experiments =
            experiments.into_iter().enumerate().map(&mut named).collect::<PyResult<Vec<_>>>()?;
        let built = files::watched(py, move |cancel| {
            let ask = || cancel.is_requested();
            let context = RunContext::new().polling(&ask);
            let mut builder =
                calibration::Calibration::builder(fmu).settings(settings).combination(combination);
            builder = goals.into_iter().fold(builder, calibration::CalibrationBuilder::goal);
            for (name, resolved, experiment) in experiments {
                let made = experiment.experiment(resolved, &context).map_err(|e| match name {
                    Some(name) => CalibrationError::Experiment { name, source: Box::new(e) },
                    None => e,
                });
                builder = builder.experiment(made?);
            }
            let builder = parameters.into_iter().fold(builder, calibration::CalibrationBuilder::parameter);
            constraints.into_iter().fold(builder, calibration::CalibrationBuilder::constraint).build()
        })?;
        Ok(Self { shared: Shared::finish(py, built, callbacks)? })
    }

    /// Returns the problem, which is the content of a pickle.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &state(self.inner())?))
    }

    /// Simulates at `x` for a fit in another process, and returns the serialised answer. `loss` is the
    /// serialised loss of the residuals. `seconds` is the remaining time of the fit, if it has a limit.
    #[pyo3(signature = (x, cutoff, loss, seconds = None))]
    fn answer<'py>(
        &self,
        py: Python<'py>,
        x: Vec<f64>,
        cutoff: f64,
        loss: &[u8],
        seconds: Option<f64>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let loss: RobustLoss =
            ciborium::from_reader(loss).map_err(|e| PyValueError::new_err(e.to_string()))?;
        let left = seconds.map(|seconds| Duration::try_from_secs_f64(seconds).unwrap_or_default());
        let deadline = left.and_then(|left| Instant::now().checked_add(left));
        let watch = InterruptGuard::new(py)?;
        let stop = Arc::clone(watch.stop());
        let inner = Arc::clone(&self.shared.inner);
        let answer = move |_: &CallingThread| {
            let mut stats = ode::Stats::default();
            let flag = stop.flag();
            let query = Query::new(0, 0, cutoff).kind(EvaluationKind::Residuals).cancellable(&flag, deadline);
            let answer = inner.answer_counted(&x, &query, loss, &mut stats);
            (answer, stats)
        };
        let Some(answered) = watch.run(answer, |_| Ok(()))? else {
            return Err(error::interrupted(py, None, None));
        };
        Ok(PyBytes::new(py, &object::to_bytes(&answered)?))
    }

    /// Returns the path and the content hash of the model of a state.
    #[staticmethod]
    fn model_of(state: &[u8]) -> PyResult<(PathBuf, String)> {
        let problem = stored(state)?;
        Ok((problem.model.path, problem.model.content_hash))
    }

    /// Creates a calibration from a state, its model, and the functions, which a state does not contain.
    #[staticmethod]
    fn restore(
        py: Python<'_>,
        state: &[u8],
        fmu: &Bound<'_, Fmu>,
        functions: SignalFunctions,
    ) -> PyResult<Self> {
        let mut problem = stored(state)?;
        let fmu = fmu.get().fmu.clone();
        let callbacks = give_functions(&mut problem, functions);
        let built = py.detach(move || calibration::Calibration::from_problem(fmu, problem));
        Ok(Self { shared: Shared::finish(py, built, callbacks)? })
    }

    /// Returns the start and the end of the simulation of an experiment.
    fn span(&self, experiment: usize) -> (f64, f64) {
        self.inner().span(experiment)
    }

    /// Returns the objectives of a design as written.
    fn goals(&self) -> Vec<&str> {
        self.inner().problem().goals.iter().map(calibration::Goal::text).collect()
    }

    /// Simulates all scenarios of a design at `x`. Returns the objectives, criteria and constraints.
    fn design_point<'py>(&self, py: Python<'py>, x: Vec<f64>) -> PyResult<Bound<'py, PyDict>> {
        let design = Design::of(Arc::clone(&self.shared.inner)).map_err(|e| error::calibration(py, &e))?;
        let point = self.shared.compute(py, move |_, context| design.evaluate(&x, context))?;
        object::fields(py, &point)
    }

    /// Names of the entries of `x`.
    fn names(&self) -> Vec<&str> {
        self.inner().parameters().iter().map(|p| p.name()).collect()
    }

    /// Returns the constraints as written.
    fn constraints(&self) -> Vec<&str> {
        self.inner().problem().constraints.iter().map(calibration::Relation::text).collect()
    }

    /// Returns names and values of the derived parameters.
    fn derived(&self, x: Vec<f64>) -> Vec<(String, f64)> {
        self.inner().derived_values(&x)
    }

    /// Returns the variables set in the model at `x` for the simulation of an experiment, and their values.
    fn model_values(&self, experiment: usize, x: Vec<f64>) -> Vec<(String, f64)> {
        self.inner().model_values(experiment, &x)
    }

    /// Start values of the entries of `x`.
    fn start(&self) -> Vec<f64> {
        self.inner().start()
    }

    /// Names of the experiments.
    fn experiments(&self) -> Vec<String> {
        self.inner().problem().experiment_names()
    }

    /// Warnings about the setup, without notes.
    fn warnings(&self) -> Vec<String> {
        let warnings = self.inner().warnings().iter();
        warnings
            .filter(|w| w.severity() != Severity::Note)
            .map(|w| calibration::visible_line(&w.to_string()).into_owned())
            .collect()
    }

    #[getter]
    fn n_residuals(&self) -> usize {
        self.inner().n_residuals()
    }

    #[getter]
    fn n_measurements(&self) -> usize {
        self.inner().n_measurements()
    }

    /// Returns the rms at `x`, from the cost without a loss.
    fn rms(&self, x: Vec<f64>, cost: f64) -> f64 {
        self.inner().rms(&x, cost)
    }

    /// Time unit of the model.
    fn time_unit(&self) -> String {
        self.inner().fmu().description().time_unit().to_owned()
    }

    /// Returns the name of the integration method.
    fn solver(&self) -> &'static str {
        self.inner().solver().name()
    }

    fn cost(&self, py: Python<'_>, x: Vec<f64>) -> PyResult<f64> {
        self.shared.compute(py, move |calibration, context| calibration.cost(&x, context))
    }

    fn residuals<'py>(&self, py: Python<'py>, x: Vec<f64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let residuals =
            self.shared.compute(py, move |calibration, context| calibration.residuals(&x, context))?;
        Ok(PyArray1::from_vec(py, residuals))
    }

    /// Simulates all experiments, or one of them. Returns per experiment `time` and the compared outputs, at
    /// the measured times or at `times`.
    #[pyo3(signature = (x, times=None, experiment=None))]
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        x: Vec<f64>,
        times: Option<Vec<f64>>,
        experiment: Option<usize>,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let trajectories = self.shared.compute(py, move |calibration, context| match experiment {
            Some(k) => calibration.simulate_experiment(k, &x, times.as_deref(), context).map(|t| vec![t]),
            None => calibration.simulate(&x, times.as_deref(), context),
        })?;
        let columns = |trajectory: fmi::Trajectory| {
            let time = std::iter::once(("time".to_owned(), trajectory.time));
            let columns = time.chain(trajectory.names.into_iter().zip(trajectory.columns));
            columns.map(|(name, values)| (name, PyArray1::from_vec(py, values))).into_py_dict(py)
        };
        trajectories.into_iter().map(columns).collect()
    }

    /// Returns per experiment its times, and per output the variable and its values (NaN if missing).
    fn measurements<'py>(&self, py: Python<'py>) -> PyResult<Vec<Recording<'py>>> {
        let recording = |experiment: &Experiment| {
            let data = experiment.data();
            let measured = experiment.outputs().map(|(variable, column)| {
                let values = data.column(column).map_err(|e| error::calibration(py, &e))?;
                Ok((variable.to_owned(), PyArray1::from_slice(py, values)))
            });
            Ok((PyArray1::from_slice(py, data.time()), measured.collect::<PyResult<_>>()?))
        };
        self.inner().problem().experiments.iter().map(recording).collect()
    }

    /// Returns the measurements that count, in the form passed to a cost function of the user.
    fn measured_series<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let outputs = &self.inner().residual_layout().outputs;
        let values: Vec<Vec<f64>> = outputs.iter().map(|output| output.measured_values()).collect();
        let measured =
            outputs.iter().zip(&values).map(|(o, values)| (o.experiment, o.variable.as_str(), &values[..]));
        cost::series(py, &self.inner().problem().experiment_names(), measured)
    }

    /// Returns the path of the model, and the arguments of `pydfo.Parameter` for each parameter.
    fn arguments<'py>(&self, py: Python<'py>) -> PyResult<(PathBuf, Vec<Bound<'py, PyDict>>)> {
        let problem = self.inner().problem();
        let arguments = |parameter: &calibration::Parameter| {
            let record = parameter.record().map_err(|e| error::calibration(py, &e))?;
            object::fields(py, &record)
        };
        let all = problem.parameters.iter().map(arguments).collect::<PyResult<_>>()?;
        Ok((problem.model.path.clone(), all))
    }

    /// Returns the variables that the parameters set, and their values at `x`.
    fn variable_values(
        &self,
        py: Python<'_>,
        x: Vec<f64>,
        experiment: Option<&str>,
    ) -> PyResult<Vec<(String, f64)>> {
        self.inner().variable_values(&x, experiment).map_err(|e| error::calibration(py, &e))
    }

    /// Simulates all experiments at `x` and records the given variables. Returns per experiment the fields of
    /// `pydfo.SimulationResult`.
    fn simulate_variables<'py>(
        &self,
        py: Python<'py>,
        x: Vec<f64>,
        times: Option<Vec<f64>>,
        variables: Vec<String>,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let trajectories = self.shared.compute(py, move |calibration, context| {
            let simulate = |k| calibration.simulate_variables(k, &x, times.as_deref(), &variables, context);
            (0..calibration.problem().experiments.len()).map(simulate).collect::<Result<Vec<_>, _>>()
        })?;
        let description = self.inner().fmu().description();
        trajectories.into_iter().map(|trajectory| trajectory::record(py, description, trajectory)).collect()
    }

    /// Computes the uncertainty of the parameters at a point. `held` contains the indices of the fixed
    /// parameters; all others are free.
    fn uncertainty(
        &self,
        py: Python<'_>,
        x: Vec<f64>,
        covariance: &str,
        held: Vec<usize>,
        workers: Option<usize>,
    ) -> PyResult<PyUncertainty> {
        let estimator = read("covariance", covariance)?;
        let options = UncertaintyOptions { workers, held, estimator, ..UncertaintyOptions::default() };
        let found = self.shared.compute(py, move |c, context| c.uncertainty(&x, &options, context))?;
        Ok(PyUncertainty::new(found))
    }

    /// Returns the fields of `pydfo.Preflight` at `x`.
    fn preflight<'py>(
        &self,
        py: Python<'py>,
        x: Vec<f64>,
        workers: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let options = PreflightOptions { start: Some(x), workers, ..PreflightOptions::default() };
        let found = self.shared.compute(py, move |c, context| c.preflight(&options, context))?;
        uncertainty::preflight(py, &found)
    }

    /// Runs a fit. `page` receives the live page before the fit starts.
    fn fit<'py>(
        &self,
        py: Python<'py>,
        requested: PyRecord,
        objects: FitFields,
    ) -> PyResult<Bound<'py, PyAny>> {
        let FitFields { start, observer, stages, objective, engine, page } = objects;
        let n_parameters = self.inner().parameters().len();
        let mut values = requested.values.clone();
        let is_front = values.get("method").is_some_and(|method| *method == Value::Text(FRONT.to_owned()))
            && !self.inner().problem().goals.is_empty();
        let options = match is_front {
            true => {
                let design = Design::of(Arc::clone(&self.shared.inner));
                let checked = design.and_then(|design| design.check_several());
                checked.map_err(|e| error::calibration(py, &e))?;
                values.remove("method");
                FitOptions::of_front(values, n_parameters)
            }
            false => FitOptions::from_record(values, n_parameters),
        };
        let FitOptions { run, loss, noise, preflight, uncertainty, .. } =
            options.map_err(|e| requested.error(py, &e))?;
        let stage = |requested: PyRecord| {
            calibration::Stage::from_record(requested.values.clone(), n_parameters, run.workers)
                .map_err(|e| requested.error(py, &e))
        };
        let stages: Option<Vec<calibration::Stage>> =
            stages.map(|stages| stages.into_iter().map(stage).collect()).transpose()?;
        let watch = InterruptGuard::new(py)?;
        let stop = Arc::clone(watch.stop());
        let tick = observer.as_ref().and_then(|observer| observer.getattr(py, "tick").ok());
        let of_objective = cost::Raised::default();
        let kind = |given| cost::kind(given, self.inner(), Arc::clone(&stop), Arc::clone(&of_objective));
        let objective = objective.map(kind).transpose()?.unwrap_or_default();
        let engine =
            engine.map(|engine| PySimulationExecutor::new(engine.bind(py), Arc::clone(&stop))).transpose()?;
        let listener = observer.map(|function| Arc::new(Listener::new(function, false)));
        let last_progress = Arc::new(LastProgress::default());
        let (inner, requested) = (Arc::clone(&self.shared.inner), Arc::clone(&stop));
        let (seen, notified) = (Arc::clone(&last_progress), listener.clone());
        let callbacks = self.shared.callbacks.clone();
        let open = |opened: Py<PyAny>| -> PyResult<_> {
            let requested = FitOptions {
                run: run.clone(),
                start: start.clone(),
                objective: objective.clone(),
                loss,
                noise,
                ..FitOptions::default()
            };
            let checked = self.inner().check_fit(stages.as_deref(), requested);
            checked.map_err(|e| error::calibration(py, &e))?;
            let inner = Arc::new(LivePage::start(self.inner())?);
            opened.call1(py, (PyLivePage { inner: Arc::clone(&inner) },))?;
            Ok(inner)
        };
        let page = page.map(open).transpose()?;
        let mut shown = FitOptions::default();
        page.iter().for_each(|page| page.attach(&mut shown));
        let FitOptions { phase, live, .. } = shown;
        let (reported, stopped) = (Arc::clone(&phase), page.clone());
        let outcome = watch.run(
            move |caller| {
                let is_stop_requested = || page.as_ref().is_some_and(|page| page.is_stop_requested());
                let (flag, ask) = (requested.flag(), || {
                    requested.is_requested() || callbacks.has_raised() || is_stop_requested()
                });
                let context = RunContext::new().flagged(&flag);
                let is_requested = requested.has_parent() || !callbacks.is_empty() || page.is_some();
                let context = if is_requested { context.polling(&ask) } else { context };
                let options = FitOptions {
                    run,
                    start,
                    objective,
                    loss,
                    noise,
                    preflight,
                    uncertainty,
                    phase: reported,
                    live,
                    engine: engine
                        .map(|engine| Rc::new(RefCell::new(engine)) as Rc<RefCell<dyn SimulationExecutor>>),
                    observer: Some(Box::new(|progress: &Progress<'_>| {
                        seen.pass_on(progress, caller, notified.as_ref())
                    })),
                    context,
                    ..FitOptions::default()
                };
                let fit = match stages {
                    Some(stages) => inner.fit_stages(&stages, options),
                    None => inner.fit(options),
                };
                if let (Ok(fit), Some(page)) = (&fit, &page)
                    && !requested.is_requested()
                {
                    // The page only shows an existing fit, so its errors do not fail the fit.
                    page.show_report(&inner, fit, &RunContext::new().flagged(&flag))
                        .unwrap_or_else(|error| log::warn!("cannot show the report on the page: {error}"));
                }
                fit
            },
            |py| match &tick {
                Some(tick) => tick.call1(py, (phase.get().name(),)).map(|_| ()),
                None => Ok(()),
            },
        )?;
        logs::pass_on(py)?;
        let Some(outcome) = outcome else {
            return Err(error::interrupted(py, last_progress.result(py)?.as_ref(), None));
        };
        let mut raised = listener.and_then(|l| l.take_raised()).or_else(|| stop.take_raised());
        raised =
            raised.or_else(|| lock(&of_objective).take()).or_else(|| self.shared.callbacks.take_raised());
        let result = match outcome {
            Ok(mut fit) => {
                // No further simulation is possible.
                if let (None, Termination::Aborted(reason)) = (&raised, &fit.report.termination) {
                    raised = Some(fmu_error::unusable(reason));
                }
                report::set_raised(&mut fit.report, raised.as_ref());
                Some(fit::result(py, &self.shared, fit)?)
            }
            // The button of the page acts like Ctrl-C.
            Err(e) if e.is_interrupt() && stopped.is_some_and(|page| page.is_stop_requested()) => {
                return Err(error::interrupted(py, None, raised));
            }
            Err(e) if raised.is_none() && !stop.is_requested() => return Err(error::calibration(py, &e)),
            Err(_) => None,
        };
        error::ended(py, &stop, raised, result)
    }
}

/// Method of a search for a Pareto front.
const FRONT: &str = "nsga2";

/// Times; variables and their values.
type Recording<'py> = (Bound<'py, PyArray1<f64>>, Vec<(String, Bound<'py, PyArray1<f64>>)>);

fn stored(state: &[u8]) -> PyResult<Problem> {
    ciborium::from_reader(state)
        .map_err(|e| PyValueError::new_err(format!("not a pickled Calibration of this version: {e}")))
}
