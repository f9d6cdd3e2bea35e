//! A model as scripts use it: values set and read, simulations on a thread of their own without the interpreter lock.

use crate::description::Fmu;
use crate::inputs::{self, Callbacks, Function, Table};
use crate::interrupt::{Stop, Watch, lock};
use crate::trajectory::Record;
use crate::{fmu_error, logs, values};
use fmi::description::Interval;
use fmi::{Session, SimulateOptions};
use numpy::PyReadonlyArray1;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex};
use std::time::Duration;

pyo3::import_exception!(pydfo._errors, Interrupted);

/// A model with the values set since it was opened or reset. Whatever waits for its session, or frees an instance, does so
/// without the lock of the interpreter, which the functions of a simulation may need.
#[pyclass(frozen, module = "pydfo._core")]
pub(crate) struct Model {
    fmu: fmi::Fmu,
    slot: Arc<Mutex<Slot>>,
}

/// Where the session is. A simulation takes it away, so that nobody waits for a lock that a simulation holds.
enum Slot {
    Here(Box<Session>),
    Simulating,
    Closed,
}

/// A session on loan; goes back when it is dropped.
struct Loan {
    session: Option<Box<Session>>,
    slot: Arc<Mutex<Slot>>,
}

impl Drop for Loan {
    fn drop(&mut self) {
        let Some(session) = self.session.take() else { return };
        let mut slot = lock(&self.slot);
        if matches!(*slot, Slot::Simulating) {
            *slot = Slot::Here(session);
        }
    }
}

/// The interval between the ticks of a clock: a number, or counter and resolution.
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

/// `pydfo._model.Request`, field by field.
#[derive(FromPyObject)]
pub(crate) struct Request<'py> {
    start_time: Option<f64>,
    final_time: Option<f64>,
    times: Option<PyReadonlyArray1<'py, f64>>,
    output_interval: Option<f64>,
    ncp: Option<usize>,
    start_values: Vec<(String, Bound<'py, PyAny>)>,
    clock_intervals: Vec<(String, ClockInterval)>,
    /// None: those that the model shows by default.
    outputs: Option<Vec<String>>,
    tables: Vec<Table<'py>>,
    functions: Vec<Function>,
    relative_tolerance: Option<f64>,
    solver: String,
    step_size: Option<f64>,
    max_step: Option<f64>,
    timeout: Option<f64>,
    record_events: bool,
    input_derivatives: bool,
    chattering: String,
}

#[pymethods]
impl Model {
    #[new]
    fn new(py: Python<'_>, fmu: &Bound<'_, Fmu>, kind: &str) -> PyResult<Self> {
        let fmu = fmu.get().fmu.clone();
        let kind = kind.parse().map_err(|e| fmu_error::raise(py, &e))?;
        let session = Box::new(Session::of_kind(fmu.clone(), kind));
        Ok(Self { fmu, slot: Arc::new(Mutex::new(Slot::Here(session))) })
    }

    /// Values of variables.
    fn get<'py>(&self, py: Python<'py>, names: Vec<String>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        // Initial values may need the model to be initialized, and for that to be built and loaded.
        let found = py.detach(|| {
            self.with_session(|session| {
                let get = |name: &String| Ok((session.get(name)?, session.extents(name)?));
                names.iter().map(get).collect::<Result<Vec<_>, fmi::FmiError>>()
            })
        });
        logs::pass_on(py)?;
        let found = found?.map_err(|e| fmu_error::raise(py, &e))?;
        let values = names.iter().zip(found);
        values
            .map(|(name, (value, extents))| {
                let kind = values::find(py, self.fmu.description(), name)?.0.kind;
                values::to_python(py, value, kind, &extents)
            })
            .collect()
    }

    /// Sets variables: all of them, or none if one of them cannot be set.
    fn set(&self, py: Python<'_>, names: Vec<String>, given: Vec<Bound<'_, PyAny>>) -> PyResult<()> {
        let pairs = values::all_from_python(py, self.fmu.description(), names.into_iter().zip(given))?;
        let pairs = pairs.iter().map(|(name, value)| (name.as_str(), value.clone()));
        let pairs: Vec<_> = pairs.collect();
        // Without the lock of the interpreter: initial values that are out of date go, and an instance with them.
        let set = py.detach(|| self.with_session(|session| session.set_all(pairs)));
        set?.map_err(|e| fmu_error::raise(py, &e))
    }

    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.with_session(Session::reset))
    }

    /// Frees the instance; everything but the description is refused afterwards.
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

    fn simulate<'py>(&self, py: Python<'py>, request: Request<'py>) -> PyResult<Record<'py>> {
        let watch = Watch::new(py)?;
        let stop = Arc::clone(watch.stop());
        let (options, callbacks) = self.options(py, request, &stop)?;
        let mut loan = self.lend()?;
        let releasing = callbacks.clone();
        let outcome = watch.run(move |_| {
            let outcome = loan.session.as_mut().map(|session| session.simulate(&options));
            releasing.release();
            drop(loan);
            outcome
        });
        logs::pass_on(py)?;
        let outcome = outcome?;
        if let Some(e) = callbacks.take_raised().or_else(|| stop.take_raised()) {
            return Err(e);
        }
        match outcome.flatten() {
            Some(Ok(trajectory)) if !stop.is_asked() => Record::new(py, self.fmu.description(), trajectory),
            Some(Err(e)) if !stop.is_asked() => Err(fmu_error::raise(py, &e)),
            outcome => Err(interrupted(outcome.and_then(Result::err).as_ref())),
        }
    }
}

impl Model {
    fn with_session<T>(&self, work: impl FnOnce(&mut Session) -> T) -> PyResult<T> {
        match &mut *lock(&self.slot) {
            Slot::Here(session) => Ok(work(session)),
            Slot::Simulating => Err(busy()),
            Slot::Closed => Err(closed()),
        }
    }

    fn lend(&self) -> PyResult<Loan> {
        let mut slot = lock(&self.slot);
        match std::mem::replace(&mut *slot, Slot::Simulating) {
            Slot::Here(session) => Ok(Loan { session: Some(session), slot: Arc::clone(&self.slot) }),
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
        stop: &Arc<Stop>,
    ) -> PyResult<(SimulateOptions, Callbacks)> {
        let flag = stop.flag();
        let (inputs, callbacks) = inputs::inputs(request.tables, request.functions, &flag)?;
        let mut options = SimulateOptions::new()
            .inputs(inputs)
            .cancel(flag)
            .record_events(request.record_events)
            .input_derivatives(request.input_derivatives);
        options.start_time = request.start_time;
        options.final_time = request.final_time;
        options.times = request.times.map(|times| times.as_slice().map(<[f64]>::to_vec)).transpose()?;
        options.output_interval = request.output_interval;
        options.ncp = request.ncp;
        options.start_values =
            values::all_from_python(py, self.fmu.description(), request.start_values.into_iter())?;
        options.clock_intervals =
            request.clock_intervals.into_iter().map(|(name, interval)| (name, interval.into())).collect();
        options.outputs = request.outputs;
        options.relative_tolerance = request.relative_tolerance;
        options.method =
            request.solver.parse().map_err(|e: ode::OptionsError| fmu_error::raise(py, &e.into()))?;
        options.chattering =
            request.chattering.parse().map_err(|e: ode::OptionsError| fmu_error::raise(py, &e.into()))?;
        options.step_size = request.step_size;
        options.max_step = request.max_step;
        options.timeout = match request.timeout {
            None => None,
            Some(f64::INFINITY) => None,
            Some(seconds) => Some(Duration::try_from_secs_f64(seconds).map_err(|_| {
                PyValueError::new_err(format!("timeout = {seconds} must be a number of seconds, at least 0"))
            })?),
        };
        Ok((options, callbacks))
    }
}

fn busy() -> PyErr {
    PyRuntimeError::new_err(
        "the model is being simulated, by another thread or around this call; \
         open it once for each thread, that costs next to nothing",
    )
}

fn closed() -> PyErr {
    PyValueError::new_err("the model has been closed")
}

/// Ctrl-C; `at` is the error with which the simulation ended, which knows the time.
fn interrupted(at: Option<&fmi::FmiError>) -> PyErr {
    match at {
        Some(fmi::FmiError::Simulation(e)) => {
            Interrupted::new_err(format!("the simulation was interrupted at t = {}", e.time))
        }
        _ => Interrupted::new_err("the simulation was interrupted"),
    }
}
