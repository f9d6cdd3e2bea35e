//! Minimisation of a Python function: on the calling thread, on the threads of a pool, or in whole batches.

use crate::convert::error;
use crate::convert::record::PyRecord;
use crate::convert::report::{self, LastProgress, Listener, ResultKind};
use crate::interrupt::interrupt_guard::{CallingThread, EndRequest, InterruptGuard};
use crate::interrupt::logs;
use crate::optimize::futures;
use crate::optimize::objective::PyObjective;
use calibration::RunContext;
use dfo::{
    AnyMethod, ByRef, Constraints, LinearConstraint, ListedPoints, MethodOptions, Minimize, NelderMead,
    NonlinearConstraint, Nsga2, Progress, Report, RequestedRun, RobustLoss, RunOptions,
};
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::sync::Arc;

type Observer<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// Linear constraints (coefficients, lower, upper), and limits of the nonlinear ones (lower, upper, whether
/// the objective must not be evaluated outside).
pub(crate) type PyConstraints = (Vec<(Vec<f64>, f64, f64)>, Vec<(f64, f64, bool)>);

/// Adds constraints to a run.
pub(crate) fn set_constraints(run: &mut RequestedRun, constraints: Option<PyConstraints>) {
    let Some((linear, nonlinear)) = constraints else { return };
    let linear = linear.into_iter();
    let nonlinear = nonlinear.into_iter();
    run.options.constraints = Constraints {
        linear: linear
            .map(|(coefficients, lower, upper)| LinearConstraint { coefficients, lower, upper })
            .collect(),
        nonlinear: nonlinear
            .map(|(lower, upper, keep_feasible)| NonlinearConstraint { lower, upper, keep_feasible })
            .collect(),
        tolerance: run.options.constraints.tolerance,
    };
}

/// A minimisation without its objective. It is owned, so that it can be moved to another thread.
pub(crate) struct RunSetup {
    x0: Option<Vec<f64>>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    requested: RequestedRun,
    /// Points to evaluate instead of a search.
    listed: Option<ListedPoints>,
}

impl RunSetup {
    pub(crate) fn new(
        x0: Option<Vec<f64>>,
        lower: Vec<f64>,
        upper: Vec<f64>,
        requested: RequestedRun,
    ) -> Self {
        Self { x0, lower, upper, requested, listed: None }
    }

    /// Evaluates these points instead of a search, and keeps their values.
    pub(crate) fn listed(self, points: ListedPoints) -> Self {
        Self { listed: Some(points), ..self }
    }

    /// Passes this setup to the optimiser.
    pub(crate) fn describe<'a, D>(
        self,
        run: Minimize<'a, NelderMead, D>,
    ) -> Result<Minimize<'a, AnyMethod, D>, dfo::Error> {
        let run = match &self.x0 {
            Some(x0) => run.start(x0),
            None => run,
        };
        Ok(run.bounds(&self.lower, &self.upper)?.requested(self.requested))
    }

    fn run(
        mut self,
        run: Minimize<'_, NelderMead>,
        stop: &EndRequest,
        ask: &dyn Fn() -> bool,
        observer: Option<&mut Observer<'_>>,
    ) -> Result<Report, dfo::Error> {
        let flag = stop.flag();
        let listed = self.listed.take();
        let run = self.describe(run)?.context(RunContext::new().flagged(&flag).polling(ask));
        match (listed, observer) {
            (Some(points), _) => run.method(points).unlimited().trace_residuals().run(),
            (None, Some(observer)) => run.observer(observer).run(),
            (None, None) => run.run(),
        }
    }
}

/// Minimises a Python function. With one worker, the function is called on the calling thread; with more
/// workers, on the threads of a pool. With `batches`, it receives whole batches on the calling thread, see
/// [`PyObjective::evaluate_batch`], or points one by one, see [`OnExecutor`](futures::OnExecutor). With
/// `cutoffs`, it receives the cutoff of each point. With a `loss` and its scale among the options, it returns
/// residuals. With `front`, the residuals are criteria, and the result is their Pareto front.
#[pyfunction]
#[pyo3(signature = (
    func, x0, lower, upper, options, *, constraints=None, failures_allowed=false, observer=None, detail=false, batches=false, cutoffs=false, front=false
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of a private function")]
pub(crate) fn minimize<'py>(
    py: Python<'py>,
    func: Py<PyAny>,
    x0: Option<Vec<f64>>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    mut options: PyRecord,
    constraints: Option<PyConstraints>,
    failures_allowed: bool,
    observer: Option<Py<PyAny>>,
    detail: bool,
    batches: bool,
    cutoffs: bool,
    front: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let loss = RobustLoss::from_record(&mut options.values).map_err(|e| options.error(py, &e))?;
    let mut default = RunOptions::<AnyMethod>::default();
    if front {
        options.values.remove("method");
        default.method = Nsga2::default().into();
    }
    let mut requested = options.run(py, default, lower.len())?;
    set_constraints(&mut requested, constraints);
    let is_constrained = !requested.options.constraints.nonlinear.is_empty();
    if loss.is_none() && requested.options.method.needs_residuals() {
        return Err(error::optimiser(py, &dfo::Error::NeedsResiduals { method: "least-squares" }));
    }
    let kind = if front { ResultKind::Front } else { ResultKind::of(loss.is_some()) };
    let listener = observer.map(|function| Arc::new(Listener::new(function, detail)));
    let call = Call { failures_allowed, batches, cutoffs, is_constrained, loss };
    let setup = RunSetup::new(x0, lower, upper, requested);
    let EndedRun { stop, raised, outcome } = run(py, func, call, setup, listener)?;
    conclude(py, &stop, raised, outcome, kind)
}

/// Way to call a Python function, see [`minimize`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Call {
    pub(crate) failures_allowed: bool,
    pub(crate) batches: bool,
    pub(crate) cutoffs: bool,
    pub(crate) is_constrained: bool,
    pub(crate) loss: Option<RobustLoss>,
}

/// A run that has ended, and the exception that ended it.
pub(crate) struct EndedRun {
    pub(crate) stop: Arc<EndRequest>,
    pub(crate) raised: Option<PyErr>,
    pub(crate) outcome: Result<Report, dfo::Error>,
}

/// Runs a setup with a Python function.
///
/// # Errors
/// Returns the exception of an interrupt that the run did not answer in time.
pub(crate) fn run(
    py: Python<'_>,
    func: Py<PyAny>,
    call: Call,
    setup: RunSetup,
    listener: Option<Arc<Listener>>,
) -> PyResult<EndedRun> {
    let Call { failures_allowed, batches, cutoffs, is_constrained, loss } = call;
    let kind = ResultKind::of(loss.is_some());
    let alone = setup.requested.options.workers.is_none_or(|workers| workers == 1);
    let watch = InterruptGuard::new(py)?;
    let stop = Arc::clone(watch.stop());
    let objective = PyObjective::new(func, failures_allowed, cutoffs, loss, Arc::clone(&stop));
    let objective = Arc::new(objective.constrained(is_constrained));
    let outcome = if alone || batches {
        let mut notify = |progress: &Progress<'_>| match &listener {
            Some(listener) => listener.notify(py, &listener.snapshot(progress)),
            None => ControlFlow::Continue(()),
        };
        let observer = listener.is_some().then_some(&mut notify as &mut Observer<'_>);
        let function = objective.function(py);
        let run = match batches {
            true if function.hasattr("submit")? => {
                let evaluator = futures::of_function(&function, &objective, Arc::clone(&stop))?;
                dfo::minimize_by(evaluator).with_residuals(loss.is_some()).loss(loss.unwrap_or_default())
            }
            true => dfo::minimize_batches(|batch| objective.evaluate_batch(py, batch))
                .cutoff_use(objective.cutoff_use())
                .with_residuals(loss.is_some())
                .loss(loss.unwrap_or_default()),
            false => dfo::minimize(ByRef(&*objective)),
        };
        setup.run(run, &stop, &|| stop.poll(py), observer)
    } else {
        let last_progress = Arc::new(LastProgress::new(kind));
        let (objective, stop) = (Arc::clone(&objective), Arc::clone(&stop));
        let (seen, notified) = (Arc::clone(&last_progress), listener.clone());
        let work = move |caller: &CallingThread| {
            let mut notify = |progress: &Progress<'_>| seen.pass_on(progress, caller, notified.as_ref());
            let run = dfo::minimize(ByRef(&*objective));
            setup.run(run, &stop, &|| stop.is_requested(), Some(&mut notify))
        };
        let outcome = watch.run(work, |_| Ok(()))?;
        match outcome {
            Some(outcome) => outcome,
            None => return Err(error::interrupted(py, last_progress.result(py)?.as_ref(), None)),
        }
    };
    // An exception of a log handler must not discard the result.
    let by_log = logs::pass_on(py).err();
    let raised =
        objective.take_raised(&outcome).or_else(|| listener.and_then(|l| l.take_raised())).or(by_log);
    Ok(EndedRun { stop, raised, outcome })
}

/// Returns the result, or the exception that ended the run with the result attached to it.
fn conclude<'py>(
    py: Python<'py>,
    stop: &EndRequest,
    raised: Option<PyErr>,
    outcome: Result<Report, dfo::Error>,
    kind: ResultKind,
) -> PyResult<Bound<'py, PyAny>> {
    let raised = raised.or_else(|| stop.take_raised());
    let result = match outcome {
        Ok(mut report) => {
            report::set_raised(&mut report, raised.as_ref());
            Some(report::to_python(py, report, kind, &|| stop.poll(py))?)
        }
        Err(e) if raised.is_none() && !stop.is_requested() => return Err(error::optimiser(py, &e)),
        Err(_) => None,
    };
    error::ended(py, stop, raised, result)
}

/// Returns the volume that points with these criteria dominate, up to a reference point. None if the numbers
/// of their values differ.
#[pyfunction]
pub(crate) fn hypervolume(points: Vec<Vec<f64>>, reference: Vec<f64>) -> Option<f64> {
    dfo::hypervolume(&points, &reference)
}
