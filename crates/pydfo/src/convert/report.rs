//! Runs as Python objects: progress, trace, result.

use crate::interrupt::threads::lock;
use crate::interrupt::watch::CallingThread;
use base::RunContext;
use dfo::{Outcome, Progress, Report, Simplex, Termination, Tests, Trace, TraceEntry};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyStopIteration;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyTuple};
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

/// The state of a run after an iteration, to be kept and passed between threads.
#[derive(Clone)]
pub(crate) struct Snapshot {
    n_iterations: usize,
    n_evaluations: usize,
    n_failed: usize,
    n_speculative: usize,
    x: Vec<f64>,
    fun: f64,
    operation: String,
    seconds: f64,
    tests: Option<Tests>,
    simplex: Option<Simplex>,
    population: Option<Simplex>,
    /// The evaluations of the iteration, if wanted.
    recent: Vec<(Vec<f64>, Outcome, bool)>,
}

impl Snapshot {
    pub(crate) fn new(progress: &Progress<'_>, detail: bool) -> Self {
        let entry = |e: TraceEntry<'_>| (e.x.to_vec(), e.outcome.clone(), e.used);
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
            simplex: progress.simplex.map(|s| s.to_owned()),
            population: progress.population.map(|s| s.to_owned()),
            recent: if detail { progress.recent().map(entry).collect() } else { Vec::new() },
        }
    }

    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let fields = PyDict::new(py);
        fields.set_item("x", PyArray1::from_slice(py, &self.x))?;
        fields.set_item("fun", self.fun)?;
        fields.set_item("nit", self.n_iterations)?;
        fields.set_item("nfev", self.n_evaluations)?;
        fields.set_item("nfail", self.n_failed)?;
        fields.set_item("n_speculative", self.n_speculative)?;
        fields.set_item("solve_time", self.seconds)?;
        fields.set_item("x_size", self.tests.map(|t| t.x_size))?;
        fields.set_item("f_spread", self.tests.and_then(|t| t.f_spread))?;
        fields.set_item("final_simplex", self.simplex.as_ref().map(|s| simplex(py, s)).transpose()?)?;
        let population = self.population.as_ref().map(|s| simplex(py, s)).transpose()?;
        fields.set_item("final_population", population)?;
        Ok(fields)
    }

    /// `pydfo._optimize.progress.Progress`
    fn to_python<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let fields = self.fields(py)?;
        fields.set_item("operation", &self.operation)?;
        let recent = self
            .recent
            .iter()
            .map(|(x, outcome, used)| Ok((PyArray1::from_slice(py, x), describe(outcome), *used)))
            .collect::<PyResult<Vec<_>>>()?;
        fields.set_item("_recent", recent)?;
        py.import("pydfo._optimize.progress")?.getattr("Progress")?.call((), Some(&fields))
    }

    /// A result made of what is known while the run has not ended.
    fn to_result<'py>(&self, py: Python<'py>, kind: ResultKind) -> PyResult<Bound<'py, PyAny>> {
        let fields = self.fields(py)?;
        fields.set_item("termination", "interrupted")?;
        fields.set_item("success", false)?;
        fields.set_item("message", "interrupted twice: the state after the last complete iteration")?;
        result(py, &fields, kind)
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

    /// Ends the run if the function returns True or raises; StopIteration ends it without an error.
    pub(crate) fn notify(&self, py: Python<'_>, snapshot: &Snapshot) -> ControlFlow<()> {
        let answer = snapshot
            .to_python(py)
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

    /// The exception that ended the run.
    pub(crate) fn take_raised(&self) -> Option<PyErr> {
        lock(&self.raised).take()
    }
}

/// The state after the last complete iteration while a run goes on, for a user who interrupts it twice.
#[derive(Default)]
pub(crate) struct LastProgress {
    snapshot: Mutex<Option<Snapshot>>,
    kind: ResultKind,
}

impl LastProgress {
    pub(crate) fn new(kind: ResultKind) -> Self {
        Self { snapshot: Mutex::default(), kind }
    }

    /// Keeps the progress of a run on another thread, and has the listener told on the calling thread.
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
    /// `pydfo.LeastSquaresResult`: `fun` are the residuals.
    Residuals,
}

impl ResultKind {
    /// That of a run in which the user gives residuals, or does not.
    pub(crate) fn of(residuals: bool) -> Self {
        if residuals { Self::Residuals } else { Self::Cost }
    }
}

/// The result from its fields.
fn result<'py>(
    py: Python<'py>,
    fields: &Bound<'py, PyDict>,
    kind: ResultKind,
) -> PyResult<Bound<'py, PyAny>> {
    let class = match kind {
        ResultKind::Cost => "OptimizeResult",
        ResultKind::Residuals => "LeastSquaresResult",
    };
    py.import("pydfo._optimize.result")?.getattr(class)?.call((), Some(fields))
}

/// A run that an observer ended with an exception was not stopped, but aborted.
pub(crate) fn set_raised(report: &mut Report, raised: Option<&PyErr>) {
    if let (Some(e), Termination::StoppedByObserver) = (raised, &report.termination) {
        report.message = format!("aborted by the callback: {e}");
        report.termination = Termination::Aborted(e.to_string());
    }
}

/// The result of a run that has ended.
pub(crate) fn to_python<'py>(
    py: Python<'py>,
    report: &Report,
    kind: ResultKind,
    is_over: &dyn Fn() -> bool,
) -> PyResult<Bound<'py, PyAny>> {
    let fields = PyDict::new(py);
    fields.set_item("x", PyArray1::from_slice(py, &report.x))?;
    fields.set_item("fun", report.fun)?;
    fields.set_item("nit", report.n_iterations)?;
    fields.set_item("nfev", report.n_evaluations)?;
    fields.set_item("nfail", report.n_failed)?;
    fields.set_item("n_speculative", report.n_speculative)?;
    fields.set_item("n_cached", report.n_cached)?;
    fields.set_item("n_batches", report.n_batches)?;
    fields.set_item("solve_time", report.seconds)?;
    fields.set_item("termination", report.termination.name())?;
    fields.set_item("success", report.is_success())?;
    let message = match &report.resumed {
        Some(resumed) => format!("{}; {resumed}", report.message),
        None => report.message.clone(),
    };
    fields.set_item("message", message)?;
    fields.set_item("x_size", report.tests.map(|t| t.x_size))?;
    fields.set_item("f_spread", report.tests.and_then(|t| t.f_spread))?;
    fields.set_item("final_simplex", report.final_simplex.as_ref().map(|s| simplex(py, s)).transpose()?)?;
    let population = report.final_population.as_ref().map(|s| simplex(py, s)).transpose()?;
    fields.set_item("final_population", population)?;
    let stages = report.schedule.iter().map(|s| {
        let x = PyArray1::from_slice(py, &s.x);
        (s.mu, s.barrier, x, s.value, s.n_evaluations)
    });
    fields.set_item("schedule", stages.collect::<Vec<_>>())?;
    fields.set_item("seed", report.seed)?;
    let failures = PyDict::new(py);
    for (reason, count) in &report.failures {
        failures.set_item(reason, count)?;
    }
    fields.set_item("failures", failures)?;
    fields.set_item("trace", trace(py, &report.trace)?)?;
    fields.set_item("method", &*report.method)?;
    fields.set_item("method_reason", report.method_reason.as_deref())?;
    fields.set_item("options", report.options.iter().cloned().into_py_dict(py)?)?;
    let optima = report.optima.iter().map(|o| (PyArray1::from_slice(py, &o.x), o.cost, o.n_starts));
    fields.set_item("optima", optima.collect::<Vec<_>>())?;
    fields.set_item("batch", &*report.batch)?;
    fields.set_item("workers", report.workers)?;
    let n = report.x.len();
    if let Some(jacobian) = &report.jacobian {
        let rows = PyArray1::from_slice(py, jacobian).reshape([jacobian.len() / n.max(1), n])?;
        fields.set_item("jac", rows)?;
        fields
            .set_item("active_mask", PyArray1::from_iter(py, report.active.iter().map(|a| i64::from(*a))))?;
    }
    if let Some(covariance) = report.covariance_unless(&RunContext::new().asking(is_over)) {
        fields.set_item("cov_message", covariance.message(|index| format!("x[{index}]")))?;
        fields.set_item("cov", PyArray1::from_vec(py, covariance.matrix).reshape([n, n])?)?;
    }
    if kind == ResultKind::Residuals {
        let residuals = report.residuals.as_deref().unwrap_or_default();
        fields.set_item("residuals", PyArray1::from_slice(py, residuals))?;
        fields.set_item("sum_of_squares", report.sum_of_squares())?;
    }
    result(py, &fields, kind)
}

/// Vertices (n + 1, n) and costs (n + 1), NaN where the objective failed; best first.
fn simplex<'py>(py: Python<'py>, simplex: &Simplex) -> PyResult<Bound<'py, PyTuple>> {
    let rows = simplex.vertices.len();
    let columns = simplex.vertices.first().map_or(0, Vec::len);
    let vertices = PyArray1::from_vec(py, simplex.vertices.concat()).reshape([rows, columns])?;
    let costs = simplex.costs.iter().map(|c| c.unwrap_or(f64::NAN));
    (vertices, PyArray1::from_iter(py, costs)).into_pyobject(py)
}

fn describe(outcome: &Outcome) -> (f64, String) {
    match outcome {
        Outcome::Value(cost) => (*cost, String::new()),
        Outcome::Above(cutoff) => (f64::NAN, format!("> {cutoff}")),
        Outcome::Failed(failure) => (f64::NAN, failure.message.clone()),
        Outcome::Abort(message) => (f64::NAN, message.clone()),
        Outcome::Skipped => (f64::NAN, "not evaluated".to_owned()),
    }
}

/// `pydfo.Trace`
pub(crate) fn trace<'py>(py: Python<'py>, trace: &Trace) -> PyResult<Bound<'py, PyAny>> {
    let fields = PyDict::new(py);
    let all = || trace.iter().chain(trace.speculative());
    let n_rows = trace.len() + trace.speculative().len();
    let flat: Vec<f64> = all().flat_map(|e| e.x.iter().copied()).collect();
    let points = PyArray1::from_vec(py, flat).reshape([n_rows, trace.n()])?;
    fields.set_item("x", points)?;
    let costs = all().map(|e| e.outcome.value().unwrap_or(f64::NAN));
    fields.set_item("fun", PyArray1::from_iter(py, costs))?;
    let above = all().map(|e| match e.outcome {
        Outcome::Above(cutoff) => *cutoff,
        _ => f64::NAN,
    });
    fields.set_item("above", PyArray1::from_iter(py, above))?;
    fields.set_item("used", PyArray1::from_iter(py, all().map(|e| e.used)))?;
    fields.set_item("id", PyArray1::from_iter(py, all().map(|e| e.id)))?;
    fields.set_item("batch", PyArray1::from_iter(py, all().map(|e| e.batch)))?;
    fields.set_item("seconds", PyArray1::from_iter(py, all().map(|e| e.seconds)))?;
    let messages = PyDict::new(py);
    for (k, entry) in all().enumerate() {
        if matches!(entry.outcome, Outcome::Failed(_) | Outcome::Abort(_)) {
            messages.set_item(k, describe(entry.outcome).1)?;
        }
    }
    fields.set_item("messages", messages)?;
    fields.set_item("n_dropped", trace.n_dropped())?;
    fields.set_item("problem", trace.problem())?;
    py.import("pydfo._optimize.result")?.getattr("Trace")?.call((), Some(&fields))
}
