//! A model for scripts: setting and reading values, and simulations without the interpreter lock.

use crate::convert::error;
use crate::convert::fmu_error;
use crate::convert::record::{PyRecord, read, time_limit};
use crate::convert::values;
use crate::interrupt::interrupt_guard::{EndRequest, InterruptGuard};
use crate::interrupt::lock::lock;
use crate::interrupt::logs;
use crate::model::description::Fmu;
use crate::model::inputs::{self, Callbacks, Function, Table};
use crate::model::trajectory;
use calibration::{ModelProcess, ParameterSet, RunContext};
use fmi::description::Interval;
use fmi::ode::Termination;
use fmi::worker::{Isolation, Launcher, WorkerLimits};
use fmi::{
    FmiError, InterfaceChoice, InterfaceKind, ModelDescription, Session, SimulateOptions, Trajectory, Value,
};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

pyo3::import_exception!(pydfo._errors, Interrupted);

/// Logged once for each model.
const RESTARTED: &str =
    "the process of the model ended in an earlier call; a new process is started with the same values";

/// A model with the values set since it was opened or reset. Code that waits for its session, or frees an
/// instance, does not hold the interpreter lock, because the functions of a simulation may need it.
#[pyclass(frozen, module = "pydfo._core")]
pub(crate) struct Model {
    fmu: fmi::Fmu,
    kind: InterfaceKind,
    slot: Arc<Mutex<Slot>>,
}

/// The values set and the session or process that runs the model.
struct ModelState {
    session: Session,
    kind: InterfaceChoice,
    /// Processes that simulate the model; created on demand.
    process: Option<ModelProcess>,
    /// Options of the last simulation, if it ran in a process.
    last: Option<SimulateOptions>,
    /// True if the process has ended in a call.
    has_ended: bool,
    /// True if this end was logged.
    is_end_logged: bool,
}

/// State of the model. A simulation takes the model out, so that other calls fail instead of waiting for a
/// lock.
enum Slot {
    Here(Box<ModelState>),
    Simulating,
    Closed,
}

/// The model during a simulation. It is returned when this is dropped.
struct Loan {
    state: Option<Box<ModelState>>,
    slot: Arc<Mutex<Slot>>,
}

impl Drop for Loan {
    fn drop(&mut self) {
        let Some(state) = self.state.take() else { return };
        let mut slot = lock(&self.slot);
        if matches!(*slot, Slot::Simulating) {
            *slot = Slot::Here(state);
        }
    }
}

/// Interval between the ticks of a clock: a number, or counter and resolution.
#[derive(FromPyObject)]
enum ClockInterval {
    #[pyo3(transparent, annotation = "tuple[int, int]")]
    Fraction((u64, u64)),
    #[pyo3(transparent, annotation = "float")]
    Decimal(f64),
}

impl From<ClockInterval> for Interval {
    fn from(interval: ClockInterval) -> Self {
        match interval {
            ClockInterval::Fraction((counter, resolution)) => Interval::Fraction(counter, resolution),
            ClockInterval::Decimal(value) => Interval::Decimal(value),
        }
    }
}

/// `pydfo._model.model.Request` by position, because names would cost a lookup each.
#[derive(FromPyObject)]
pub(crate) struct Request<'py> {
    #[pyo3(item(0))]
    start_time: Option<f64>,
    #[pyo3(item(1))]
    final_time: Option<f64>,
    #[pyo3(item(2))]
    times: Option<Bound<'py, PyArray1<f64>>>,
    #[pyo3(item(3))]
    output_interval: Option<f64>,
    #[pyo3(item(4))]
    ncp: Option<usize>,
    #[pyo3(item(5))]
    start_values: Vec<(String, Bound<'py, PyAny>)>,
    #[pyo3(item(6))]
    clock_intervals: Vec<(String, ClockInterval)>,
    /// Recorded outputs; default: the default outputs of the model.
    #[pyo3(item(7))]
    outputs: Option<Vec<String>>,
    #[pyo3(item(8))]
    tables: Vec<Table<'py>>,
    #[pyo3(item(9))]
    functions: Vec<Function>,
    /// Settings of the run that differ from the default.
    #[pyo3(item(10))]
    settings: PyRecord,
    #[pyo3(item(11))]
    max_time: Option<f64>,
    #[pyo3(item(12))]
    record_events: bool,
    #[pyo3(item(13))]
    between_steps: String,
    /// Process isolation; default: as required by the sandbox.
    #[pyo3(item(14))]
    isolation: Option<String>,
    /// An SSP parameter file.
    #[pyo3(item(15))]
    parameter_set: Option<PathBuf>,
    /// The FMU with units that its description does not declare.
    #[pyo3(item(16))]
    described: Option<Bound<'py, Fmu>>,
    #[pyo3(item(17))]
    sandbox: bool,
    /// Names of the start values that are initial states.
    #[pyo3(item(18))]
    initial_states: Vec<String>,
}

impl Request<'_> {
    /// Returns the limits of the simulation process; None if the simulation runs in this process.
    fn worker_limits(&self) -> Result<Option<WorkerLimits>, FmiError> {
        let isolation = self.isolation.as_deref().map(str::parse).transpose()?;
        // If this program cannot start processes, only an explicit request for one is an error.
        let possible = if Launcher::is_set() { Isolation::Process } else { Isolation::None };
        let isolation = isolation.unwrap_or(if self.sandbox { Isolation::Process } else { possible });
        match isolation {
            Isolation::Process => Ok(Some(WorkerLimits { sandbox: self.sandbox, ..WorkerLimits::default() })),
            Isolation::None if self.sandbox => Err(FmiError::BadSetting(
                "sandbox: not available with isolation = \"none\", which runs the model in this process"
                    .to_owned(),
            )),
            Isolation::None => Ok(None),
        }
    }
}

#[pymethods]
impl Model {
    #[new]
    fn new(py: Python<'_>, fmu: &Bound<'_, Fmu>, kind: &str) -> PyResult<Self> {
        let fmu = fmu.get().fmu.clone();
        let kind = kind.parse().map_err(|e| fmu_error::raise(py, &e))?;
        let session = Session::of_kind(fmu.clone(), kind);
        let state =
            ModelState { session, kind, process: None, last: None, has_ended: false, is_end_logged: false };
        let kind = fmu.choose(kind).map_err(|e| fmu_error::raise(py, &e))?;
        let slot = Arc::new(Mutex::new(Slot::Here(Box::new(state))));
        Ok(Self { fmu, kind, slot })
    }

    /// Returns the values of variables.
    fn get<'py>(&self, py: Python<'py>, names: Vec<String>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        // Initial values may require initializing the model, and thus building and loading it.
        let watch = InterruptGuard::without_handler(py);
        let found = watch.run_here(|context| self.with_session(|state| state.values(&names, context)));
        logs::pass_on(py)?;
        if watch.stop().is_requested() {
            return Err(watch.interrupted());
        }
        let found = found?.map_err(|e| fmu_error::raise(py, &e))?;
        let values = names.iter().zip(found);
        values
            .map(|(name, (value, extents))| {
                let kind = values::find(py, self.fmu.description(), name)?.0.kind;
                values::to_python(py, value, kind, &extents)
            })
            .collect()
    }

    /// Sets all variables, or none if one of them cannot be set.
    fn set(&self, py: Python<'_>, names: Vec<String>, given: Vec<Bound<'_, PyAny>>) -> PyResult<()> {
        let pairs = values::all_from_python(py, self.fmu.description(), names.into_iter().zip(given))?;
        let pairs = pairs.iter().map(|(name, value)| (name.as_str(), value.clone()));
        let pairs: Vec<_> = pairs.collect();
        // Without the interpreter lock, because outdated initial values are dropped, and an instance with
        // them.
        let set = py.detach(|| self.with_session(|state| state.session.set_all(pairs)));
        set?.map_err(|e| fmu_error::raise(py, &e))
    }

    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| {
            self.with_session(|state| {
                state.session.reset();
                state.last = None;
            })
        })
    }

    /// Frees the instance. Only the description is available afterwards.
    fn close(&self, py: Python<'_>) {
        py.detach(|| {
            let left = std::mem::replace(&mut *lock(&self.slot), Slot::Closed);
            drop(left);
        });
    }

    #[getter]
    fn closed(&self, py: Python<'_>) -> bool {
        py.detach(|| matches!(*lock(&self.slot), Slot::Closed))
    }

    /// Names of the variables with assigned values.
    fn names_set(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        // The thread that holds the lock may wait for the interpreter lock.
        py.detach(|| {
            self.with_session(|state| state.session.values().map(|(name, _)| name.to_owned()).collect())
        })
    }

    /// Names and values of the assigned variables.
    fn values_set<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
        let set: Vec<(String, fmi::Value)> = py.detach(|| {
            self.with_session(|state| {
                state.session.values().map(|(name, value)| (name.to_owned(), value.clone())).collect()
            })
        })?;
        let description = self.fmu.description();
        let shown = set.into_iter().map(|(name, value)| {
            let kind = values::find(py, description, &name)?.0.kind;
            // Flat, because structural parameters that are also set may determine the sizes.
            Ok((name, values::to_python(py, value, kind, &[])?))
        });
        shown.collect()
    }

    /// Simulates the model, in a worker process by default.
    fn simulate<'py>(&self, py: Python<'py>, request: Request<'py>) -> PyResult<Bound<'py, PyDict>> {
        let limits = request.worker_limits().map_err(|e| fmu_error::raise(py, &e))?;
        let mut loan = self.lend()?;
        // An input function is Python code, so our handler decides how Ctrl-C affects it.
        let watch = match request.functions.is_empty() {
            true => InterruptGuard::without_handler(py),
            false => InterruptGuard::new(py)?,
        };
        let stop = watch.stop();
        let described = request
            .described
            .as_ref()
            .map_or_else(|| self.fmu.clone(), |description| description.get().fmu.clone());
        let (options, callbacks) = self.options(py, request, described.description(), stop)?;
        let outcome = watch.run_here(|context| {
            let state = loan.state.as_mut()?;
            Some(match limits {
                Some(limits) => state.simulate_apart(limits, &options, context),
                None => state.simulate_here(&options, context),
            })
        });
        callbacks.release();
        drop(loan);
        logs::pass_on(py)?;
        if let Some(e) = callbacks.take_raised().or_else(|| stop.take_raised()) {
            return Err(e);
        }
        match outcome {
            Some(Ok(trajectory)) if !stop.is_requested() => {
                if let Some(reported) = trajectory.not_finite() {
                    error::warn_as(py, &py.get_type::<error::SimulationWarning>(), &reported)?;
                }
                trajectory::record(py, described.description(), trajectory)
            }
            Some(Err(e)) if !stop.is_requested() => Err(fmu_error::raise(py, &e)),
            Some(Ok(trajectory)) => Err(interrupted(Some(trajectory.end_time))),
            Some(Err(fmi::FmiError::Simulation(e))) => Err(interrupted(Some(e.time))),
            _ => Err(interrupted(None)),
        }
    }
}

impl ModelState {
    /// Returns the processes of the model with these limits.
    fn process(&mut self, limits: WorkerLimits) -> Result<&ModelProcess, FmiError> {
        if self.has_ended && !self.is_end_logged {
            let model = &self.session.fmu().description().model_name;
            log::warn!("{model}: {RESTARTED}");
            self.is_end_logged = true;
        }
        // A process with other limits is not reused.
        drop(self.process.take_if(|process| *process.limits() != limits));
        Ok(match &mut self.process {
            Some(process) => process,
            none => none.insert(ModelProcess::new(self.session.fmu(), limits)?),
        })
    }

    /// Records whether the process has ended in a call.
    fn note_end<T>(&mut self, outcome: Result<T, FmiError>) -> Result<T, FmiError> {
        self.has_ended |= matches!(outcome, Err(FmiError::WorkerEnded(_)));
        outcome
    }

    fn simulate_apart(
        &mut self,
        limits: WorkerLimits,
        options: &SimulateOptions,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, FmiError> {
        let options = self.session.with_values(options);
        let outcome = self.process(limits)?.simulate(&options, context);
        let trajectory = self.note_end(outcome)?;
        if trajectory.termination != Termination::StoppedByObserver {
            self.session.note_simulated();
            self.last = Some(options);
        }
        Ok(trajectory)
    }

    /// Simulates in this process. If a call fails and the model has logged no reason, the simulation is
    /// repeated. The repetition runs in a worker process with the log of the model switched on.
    fn simulate_here(
        &mut self,
        options: &SimulateOptions,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, FmiError> {
        let mut poll = || match context.is_over() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        };
        let outcome = self.session.simulate_with(options, &mut poll);
        self.last = None;
        let is_silent = |error: &FmiError| error.call_failure().is_some_and(|failure| failure.log.is_empty());
        if !outcome.as_ref().is_err_and(is_silent) {
            return outcome;
        }
        let options = self.session.with_values(options);
        let reported =
            self.process(WorkerLimits::default()).and_then(|process| process.simulate(&options, context));
        match reported {
            Err(FmiError::ReportedError(reported)) if !reported.log.is_empty() => {
                Err(FmiError::ReportedError(reported))
            }
            _ => outcome,
        }
    }

    /// Returns values of variables and their extents: the final values of the last simulation, otherwise the
    /// values set or the initial values.
    fn values(
        &mut self,
        names: &[String],
        context: &RunContext<'_>,
    ) -> Result<Vec<(Value, Vec<usize>)>, FmiError> {
        let is_apart = self.last.is_some() || (!self.session.is_simulated() && Launcher::is_set());
        let mut values = Vec::with_capacity(names.len());
        for name in names {
            values.push(match is_apart {
                true => self.session.value_without_run(name, self.last.is_some())?,
                false => Some(self.session.get(name)?),
            });
        }
        let requested = names.iter().zip(&values).filter(|(_, value)| value.is_none());
        let requested: Vec<String> = requested.map(|(name, _)| name.clone()).collect();
        let mut found =
            if requested.is_empty() { Vec::new() } else { self.ask(&requested, context)? }.into_iter();
        names
            .iter()
            .zip(values)
            .map(|(name, value)| {
                let value = value.or_else(|| found.next()).ok_or(FmiError::Cancelled)?;
                Ok((value, self.session.extents(name)?))
            })
            .collect()
    }

    /// Requests values that only the model knows from one of its processes.
    fn ask(&mut self, names: &[String], context: &RunContext<'_>) -> Result<Vec<Value>, FmiError> {
        let limits = self.process.as_ref().map_or_else(WorkerLimits::default, |process| *process.limits());
        let last = self.last.take();
        let set = self.session.values().map(|(name, value)| (name.to_owned(), value.clone())).collect();
        let kind = self.kind;
        let process = self.process(limits)?;
        let found = match &last {
            Some(options) => process.final_values(options, names, context),
            None => process.initial_values(kind, set, names, context),
        };
        self.last = last;
        self.note_end(found)
    }
}

impl Model {
    fn with_session<T>(&self, work: impl FnOnce(&mut ModelState) -> T) -> PyResult<T> {
        match &mut *lock(&self.slot) {
            Slot::Here(state) => Ok(work(state)),
            Slot::Simulating => Err(busy()),
            Slot::Closed => Err(closed()),
        }
    }

    fn lend(&self) -> PyResult<Loan> {
        let mut slot = lock(&self.slot);
        match std::mem::replace(&mut *slot, Slot::Simulating) {
            Slot::Here(state) => Ok(Loan { state: Some(state), slot: Arc::clone(&self.slot) }),
            Slot::Simulating => Err(busy()),
            Slot::Closed => {
                *slot = Slot::Closed;
                Err(closed())
            }
        }
    }

    fn options(
        &self,
        py: Python<'_>,
        request: Request<'_>,
        description: &ModelDescription,
        stop: &Arc<EndRequest>,
    ) -> PyResult<(SimulateOptions, Callbacks)> {
        let (inputs, callbacks) = inputs::inputs(request.tables, request.functions, &stop.flag())?;
        let mut options = SimulateOptions::new().inputs(inputs).record_events(request.record_events);
        if !request.settings.values.is_empty() {
            options.run = request.settings.settings(py)?.run;
        }
        options.start_time = request.start_time;
        options.final_time = request.final_time;
        options.times = request.times.map(|times| times.to_vec()).transpose()?;
        options.output_interval = request.output_interval;
        options.ncp = request.ncp;
        options.start_values = values::all_from_python(py, description, request.start_values.into_iter())?;
        if let Some(path) = &request.parameter_set {
            let set = ParameterSet::read(path).and_then(|set| set.values(description));
            options.start_values.extend(set.map_err(|e| error::calibration(py, &e))?);
        }
        options.initial_states = request.initial_states;
        options.clock_intervals =
            request.clock_intervals.into_iter().map(|(name, interval)| (name, interval.into())).collect();
        options.outputs = request.outputs;
        options.between_steps = read("between_steps", &request.between_steps)?;
        for ignored in options.without_effect(self.kind) {
            error::warn(py, &ignored)?;
        }
        options.run.timeout = time_limit("max_time", request.max_time)?;
        Ok((options, callbacks))
    }
}

fn busy() -> PyErr {
    PyRuntimeError::new_err(
        "the model is being simulated by another thread or by the caller of this call. Open the model once \
         per thread, which is fast",
    )
}

fn closed() -> PyErr {
    PyValueError::new_err("the model has been closed")
}

/// Creates the exception for Ctrl-C at this time of the simulation.
fn interrupted(time: Option<f64>) -> PyErr {
    let at = time.map_or_else(String::new, |time| format!(" at t = {}", base::Number(time)));
    Interrupted::new_err(format!("the simulation was interrupted{at}"))
}
