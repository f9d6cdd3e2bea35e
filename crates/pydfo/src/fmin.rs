//! `fmin`: a Python function meets the optimiser.

use crate::error;
use crate::interrupt::{Stop, Watch};
use crate::objective::PyObjective;
use crate::report::{self, LastSeen, Listener, Snapshot};
use crate::settings::{Options, Settings};
use dfo::{ByRef, Measure, Progress, Report};
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::sync::Arc;

type Observer<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// A minimisation without its objective: owned, to be moved to another thread.
struct Problem {
    x0: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    settings: Settings,
    workers: usize,
}

impl Problem {
    fn run(
        &self,
        objective: &PyObjective,
        stop: &Stop,
        poll: impl FnMut() -> bool,
        observer: Option<&mut Observer<'_>>,
    ) -> Result<Report, dfo::Error> {
        let Settings { method, tolerances, limits, .. } = self.settings.clone();
        let mut run = dfo::minimize(ByRef(objective))
            .start(&self.x0)
            .bounds(&self.lower, &self.upper)?
            .method(method)
            .tolerances(tolerances)
            .workers(self.workers)
            .cancel(stop.flag())
            .poll(poll)
            // No limit is what the user said when all are None; the optimiser's own defaults shall not step in.
            .max_evaluations(limits.max_evaluations.unwrap_or(usize::MAX));
        if let Some(n) = limits.max_iterations {
            run = run.max_iterations(n);
        }
        if let Some(time) = limits.max_time {
            run = run.max_time(time);
        }
        if let Some(target) = limits.target {
            run = run.target(target);
        }
        if let Some(observer) = observer {
            run = run.observer(observer);
        }
        run.run()
    }
}

/// Minimises a Python function. With one worker it is called on the calling thread, with more on threads of a pool.
#[pyfunction]
#[pyo3(signature = (func, x0, lower, upper, options, *, tolerant=false, observer=None, detail=false))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of a private function")]
pub(crate) fn minimize<'py>(
    py: Python<'py>,
    func: Py<PyAny>,
    x0: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    options: Options,
    tolerant: bool,
    observer: Option<Py<PyAny>>,
    detail: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let settings = options.check(Measure::Absolute)?;
    let workers = settings.workers.unwrap_or(1);
    let problem = Problem { x0, lower, upper, settings, workers };
    let watch = Watch::new(py)?;
    let stop = Arc::clone(watch.stop());
    let objective = Arc::new(PyObjective::new(func, tolerant, Arc::clone(&stop)));
    let listener = observer.map(|function| Arc::new(Listener::new(function, detail)));
    let outcome = if workers == 1 {
        let mut hear = |progress: &Progress<'_>| match &listener {
            Some(listener) => listener.hear(py, &Snapshot::new(progress, detail)),
            None => ControlFlow::Continue(()),
        };
        let observer = listener.is_some().then_some(&mut hear as &mut Observer<'_>);
        problem.run(&objective, &stop, || stop.poll(py), observer)
    } else {
        let last_seen = Arc::new(LastSeen::default());
        let (objective, stop) = (Arc::clone(&objective), Arc::clone(&stop));
        let (seen, hearing) = (Arc::clone(&last_seen), listener.clone());
        let outcome = watch.run(move |desk| {
            let mut hear = |progress: &Progress<'_>| seen.pass_on(progress, desk, hearing.as_ref());
            problem.run(&objective, &stop, || stop.is_asked(), Some(&mut hear))
        })?;
        match outcome {
            Some(outcome) => outcome,
            None => return Err(error::interrupted(py, last_seen.result(py)?.as_ref(), None)),
        }
    };
    let raised = objective.take_raised().or_else(|| listener.and_then(|l| l.take_raised()));
    conclude(py, &stop, raised, outcome)
}

/// The result, or the exception that ended the run with the result attached to it.
fn conclude<'py>(
    py: Python<'py>,
    stop: &Stop,
    raised: Option<PyErr>,
    outcome: Result<Report, dfo::Error>,
) -> PyResult<Bound<'py, PyAny>> {
    let raised = raised.or_else(|| stop.take_raised());
    let result = match outcome {
        Ok(report) => Some(report::to_python(py, &report)?),
        Err(e) if raised.is_none() && !stop.is_asked() => return Err(error::optimiser(py, &e)),
        Err(_) => None,
    };
    error::ended(py, stop, raised, result)
}
