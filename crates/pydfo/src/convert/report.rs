//! Runs as Python objects: progress, trace, result.

use crate::convert::dict::dict;
use crate::convert::object;
use crate::interrupt::interrupt_guard::CallingThread;
use crate::interrupt::lock::lock;
use base::RunContext;
use dfo::{Outcome, ParetoFront, Progress, Report, Simplex, Termination, ToleranceTests, Trace, TraceEntry};
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyStopIteration;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};
use serde::Serialize;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

/// State of a run after an iteration, for storage and for transfer between threads. Contains the fields of a
/// [`Report`] that are known at that time.
#[derive(Clone, Serialize)]
pub(crate) struct Snapshot {
    n_iterations: usize,
    n_evaluations: usize,
    n_failed: usize,
    n_speculative: usize,
    x: Vec<f64>,
    fun: f64,
    operation: String,
    seconds: f64,
    tests: Option<ToleranceTests>,
    final_simplex: Option<Simplex>,
    final_population: Option<Simplex>,
    front: Option<ParetoFront>,
    /// Evaluations of the iteration, if requested: the point, its outcome, and whether it was used.
    recent: Vec<(Vec<f64>, String, bool)>,
}

impl Snapshot {
    pub(crate) fn new(progress: &Progress<'_>, detail: bool) -> Self {
        let entry = |e: TraceEntry<'_>| (e.x.to_vec(), describe(e.outcome), e.used);
        Self {
            n_iterations: progress.n_iterations,
            n_evaluations: progress.n_evaluations,
            n_failed: progress.n_failed,
            n_speculative: progress.n_speculative,
            x: progress.x.to_vec(),
            fun: progress.fun,
            operation: progress.operation.to_string(),
            seconds: progress.seconds,
            tests: progress.tests,
            final_simplex: progress.simplex.map(|s| s.to_owned()),
            final_population: progress.population.map(|s| s.to_owned()),
            front: progress.front.cloned(),
            recent: if detail { progress.recent().map(entry).collect() } else { Vec::new() },
        }
    }

    /// Creates a result from the known fields while the run has not ended.
    fn to_result<'py>(&self, py: Python<'py>, kind: ResultKind) -> PyResult<Bound<'py, PyAny>> {
        let record = object::fields(py, self)?;
        let ended = dict!(py;;
            "termination": "interrupted",
            "success": false,
            "message": "interrupted twice; the result is the state after the last complete iteration",
        );
        record.update(ended.as_mapping())?;
        kind.made(&record)
    }
}

/// A Python function that is called with the progress of a run, on the calling thread.
pub(crate) struct Listener {
    function: Py<PyAny>,
    detail: bool,
    raised: Mutex<Option<PyErr>>,
}

impl Listener {
    pub(crate) fn new(function: Py<PyAny>, detail: bool) -> Self {
        Self { function, detail, raised: Mutex::new(None) }
    }

    /// Returns the progress with the details that the function needs.
    pub(crate) fn snapshot(&self, progress: &Progress<'_>) -> Snapshot {
        Snapshot::new(progress, self.detail)
    }

    /// Calls the function. The run ends if the function returns True or raises; StopIteration ends it without
    /// an error.
    pub(crate) fn notify(&self, py: Python<'_>, snapshot: &Snapshot) -> ControlFlow<()> {
        let answer = object::fields(py, snapshot)
            .and_then(|record| made(&record, "progress", "Progress"))
            .and_then(|progress| self.function.bind(py).call1((progress,)))
            .map(|answer| answer.extract::<bool>().unwrap_or(false));
        match answer {
            Ok(false) => ControlFlow::Continue(()),
            Ok(true) => ControlFlow::Break(()),
            Err(e) => {
                if !e.is_instance_of::<PyStopIteration>(py) {
                    lock(&self.raised).get_or_insert(e);
                }
                ControlFlow::Break(())
            }
        }
    }

    /// Takes the exception that ended the run.
    pub(crate) fn take_raised(&self) -> Option<PyErr> {
        lock(&self.raised).take()
    }
}

/// State after the last complete iteration of a running run, for a user who interrupts it twice.
#[derive(Default)]
pub(crate) struct LastProgress {
    snapshot: Mutex<Option<Snapshot>>,
    kind: ResultKind,
}

impl LastProgress {
    pub(crate) fn new(kind: ResultKind) -> Self {
        Self { snapshot: Mutex::default(), kind }
    }

    /// Stores the progress of a run on another thread, and notifies the listener on the calling thread.
    pub(crate) fn pass_on(
        &self,
        progress: &Progress<'_>,
        caller: &CallingThread,
        listener: Option<&Arc<Listener>>,
    ) -> ControlFlow<()> {
        let snapshot = Snapshot::new(progress, listener.is_some_and(|l| l.detail));
        *lock(&self.snapshot) = Some(snapshot.clone());
        let Some(listener) = listener.cloned() else { return ControlFlow::Continue(()) };
        caller.call(move |py| listener.notify(py, &snapshot)).unwrap_or(ControlFlow::Break(()))
    }

    pub(crate) fn result<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        lock(&self.snapshot).as_ref().map(|s| s.to_result(py, self.kind)).transpose()
    }
}

/// Class of the result that is returned to the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum ResultKind {
    /// `pydfo.OptimizeResult`: `fun` is the cost.
    #[default]
    Cost,
    /// `pydfo.LeastSquaresResult`: `fun` contains the residuals.
    Residuals,
    /// `pydfo.ParetoFront`.
    Front,
}

impl ResultKind {
    /// Returns the class for a run in which the user gives residuals, or does not.
    pub(crate) fn of(residuals: bool) -> Self {
        if residuals { Self::Residuals } else { Self::Cost }
    }

    /// Creates the result from its record.
    fn made<'py>(self, record: &Bound<'py, PyDict>) -> PyResult<Bound<'py, PyAny>> {
        let (module, class) = match self {
            Self::Cost => ("result", "OptimizeResult"),
            Self::Residuals => ("result", "LeastSquaresResult"),
            Self::Front => ("pareto_front", "ParetoFront"),
        };
        made(record, module, class)
    }
}

/// Creates an object of a Python class, which maps the fields of the record to its names.
fn made<'py>(record: &Bound<'py, PyDict>, module: &str, class: &str) -> PyResult<Bound<'py, PyAny>> {
    let module = record.py().import(format!("pydfo._optimize.{module}"))?;
    module.getattr(class)?.call_method1("_of", (record,))
}

/// Changes the termination of a run that an observer ended with an exception from stopped to aborted.
pub(crate) fn set_raised(report: &mut Report, raised: Option<&PyErr>) {
    if let (Some(e), Termination::StoppedByObserver) = (raised, report.termination.ended()) {
        report.message = format!("aborted by the callback: {e}");
        report.termination = Termination::Aborted(e.to_string());
    }
}

/// Returns the result of a run that has ended: the saved record, with values computed from it. Fields as long
/// as the run or its residuals become arrays.
pub(crate) fn to_python<'py>(
    py: Python<'py>,
    mut report: Report,
    kind: ResultKind,
    is_over: &dyn Fn() -> bool,
) -> PyResult<Bound<'py, PyAny>> {
    let n = report.x.len();
    let covariance = report.covariance_unless(&RunContext::new().polling(is_over));
    let message = covariance.as_ref().map(|covariance| covariance.message(|index| format!("x[{index}]")));
    let covariance = covariance.map(|covariance| matrix(py, covariance.matrix, n)).transpose()?;
    let computed = dict!(py;;
        "termination": report.termination.name(),
        "success": report.is_success(),
        "message": match &report.resumed {
            Some(resumed) => format!("{}; {resumed}", report.message),
            None => report.message.clone(),
        },
        "cov": covariance,
        "cov_message": message.unwrap_or_default(),
        "sum_of_squares": report.sum_of_squares(),
        "trace": trace(py, &std::mem::take(&mut report.trace))?,
        "jacobian": report.jacobian.take().map(|jacobian| matrix(py, jacobian, n)).transpose()?,
        "residuals": PyArray1::from_vec(py, report.residuals.take().unwrap_or_default()),
        "constraints": PyArray1::from_vec(py, std::mem::take(&mut report.constraints)),
    );
    let record = object::fields(py, &report)?;
    record.update(computed.as_mapping())?;
    kind.made(&record)
}

/// Creates an array of `n` columns from consecutive rows.
fn matrix(py: Python<'_>, rows: Vec<f64>, n: usize) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let m = rows.len() / n.max(1);
    PyArray1::from_vec(py, rows).reshape([m, n])
}

fn describe(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Value(cost) => format!("{cost:?}"),
        Outcome::Above(cutoff) => format!("> {cutoff}"),
        Outcome::Failed(failure) => failure.message.clone(),
        Outcome::Abort(message) => message.clone(),
        Outcome::Skipped => "not evaluated".to_owned(),
    }
}

/// `pydfo.Trace`
pub(crate) fn trace<'py>(py: Python<'py>, trace: &Trace) -> PyResult<Bound<'py, PyAny>> {
    let all = || trace.iter().chain(trace.speculative());
    let points: Vec<f64> = all().flat_map(|e| e.x.iter().copied()).collect();
    let above = |outcome: &Outcome| if let Outcome::Above(cutoff) = outcome { *cutoff } else { f64::NAN };
    let failed = |(_, e): &(usize, TraceEntry<'_>)| match e.outcome {
        // Failures that do not belong to the point are left out.
        Outcome::Failed(failure) => failure.kind.is_of_point(),
        outcome => matches!(outcome, Outcome::Abort(_)),
    };
    let messages = all().enumerate().filter(failed).map(|(k, e)| (k, describe(e.outcome)));
    let fields = dict!(py;;
        "x": PyArray1::from_vec(py, points).reshape([all().count(), trace.n()])?,
        "fun": PyArray1::from_iter(py, all().map(|e| e.outcome.value().unwrap_or(f64::NAN))),
        "above": PyArray1::from_iter(py, all().map(|e| above(e.outcome))),
        "used": PyArray1::from_iter(py, all().map(|e| e.used)),
        "id": PyArray1::from_iter(py, all().map(|e| e.id)),
        "batch": PyArray1::from_iter(py, all().map(|e| e.batch)),
        "seconds": PyArray1::from_iter(py, all().map(|e| e.seconds)),
        "messages": messages.into_py_dict(py)?,
        "n_dropped": trace.n_dropped(),
        "problem": trace.problem(),
    );
    py.import("pydfo._optimize.result")?.getattr("Trace")?.call((), Some(&fields))
}
