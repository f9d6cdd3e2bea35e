//! `pydfo.ode.solve`: integrates hybrid systems written in Python.

use crate::convert::dict::dict;
use crate::convert::error;
use crate::convert::record::time_limit;
use crate::interrupt::interrupt_guard::{EndRequest, InterruptGuard};
use crate::model::trajectory::Counts;
use crate::ode::system::{
    Event, JacobianSource, PySystem, SparseJacobian, is_sparse, matrix, sparse_entries,
};
use base::Number;
use numpy::{PyArray1, PyArrayMethods};
use ode::{
    AbsoluteTolerance, DenseOutput, Direction, Driver, ErrorKind, Evaluated, HybridSystem, JacobianPattern,
    Limits, Method, Observer, Options, OptionsError, Report, Sample, SimulationError, StepView, Termination,
};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Arguments of an integration, by name.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Problem<'py> {
    rhs: Bound<'py, PyAny>,
    start: f64,
    end: f64,
    x0: Vec<f64>,
    method: String,
    times: Option<Vec<f64>>,
    dense_output: bool,
    events: Vec<(Bound<'py, PyAny>, f64, usize)>,
    on_event: Option<Bound<'py, PyAny>>,
    jacobian: Option<Bound<'py, PyAny>>,
    sparsity: Option<Vec<(usize, usize)>>,
    mass: Option<Bound<'py, PyAny>>,
    rtol: f64,
    atol: Vec<f64>,
    first_step: Option<f64>,
    max_step: Option<f64>,
    step: Option<f64>,
    interior_samples: Option<u32>,
    chattering: String,
    max_steps: Option<u64>,
    max_events: Option<u64>,
    max_time: Option<f64>,
    slopes: Option<Vec<f64>>,
    exclude_algebraic: bool,
}

/// Stores the reports of the driver: requested samples, and each step as its values at nodes.
struct Keeper<'a, 'py> {
    py: Python<'py>,
    stop: &'a EndRequest,
    times: Vec<f64>,
    states: Vec<f64>,
    dense: Option<DenseOutput>,
}

impl Observer for Keeper<'_, '_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.times.push(sample.time);
        self.states.extend_from_slice(sample.states);
        ControlFlow::Continue(())
    }

    fn needs_steps(&self) -> bool {
        self.dense.is_some()
    }

    fn step(&mut self, step: &StepView<'_>) {
        if let Some(dense) = &mut self.dense {
            dense.push(step);
        }
    }

    fn poll(&mut self) -> ControlFlow<()> {
        if self.stop.poll(self.py) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl Problem<'_> {
    fn driver(&self, stop: &EndRequest) -> PyResult<Driver> {
        let bad = |e: OptionsError| PyValueError::new_err(in_words_of_solve(e).to_string());
        let absolute_tolerance = match self.atol[..] {
            [one] => AbsoluteTolerance::Scalar(one),
            _ => AbsoluteTolerance::PerState(self.atol.clone()),
        };
        Driver::new(Options {
            method: self.method.parse::<Method>().map_err(bad)?,
            relative_tolerance: self.rtol,
            absolute_tolerance,
            step_size: self.step,
            max_step: self.max_step,
            first_step: self.first_step,
            interior_samples: self.interior_samples,
            chattering: self.chattering.parse().map_err(bad)?,
            exclude_algebraic: self.exclude_algebraic,
            limits: Limits {
                max_steps: self.max_steps,
                max_events: self.max_events,
                timeout: time_limit("max_time", self.max_time)?,
                ..Limits::default()
            },
            cancel: Some(stop.flag()),
            ..Options::default()
        })
        .map_err(bad)
    }
}

impl<'py> Problem<'py> {
    /// Warns of arguments that have no effect with the method.
    fn warn_of_what_is_ignored(&self, py: Python<'_>) -> PyResult<()> {
        let method: Method = self.method.parse().unwrap_or_default();
        let fixed = method.is_fixed_step();
        let is_implicit = method.is_implicit();
        if self.on_event.is_some() && self.events.is_empty() {
            crate::convert::error::warn(py, "on_event has no effect without events")?;
        }
        let ignored = [
            ("step", self.step.is_some() && !fixed, "selects its own steps; use max_step to limit them"),
            ("max_step", self.max_step.is_some() && fixed, "uses the constant step size step"),
            ("first_step", self.first_step.is_some() && fixed, "uses the constant step size step"),
            ("jac", self.jacobian.is_some() && !is_implicit, "is explicit and uses no Jacobian"),
            ("jac_sparsity", self.sparsity.is_some() && !is_implicit, "is explicit and uses no Jacobian"),
        ];
        for (name, _, why) in ignored.into_iter().filter(|(_, is, _)| *is) {
            crate::convert::error::warn(
                py,
                &format!("{name} has no effect, because method '{}' {why}", method.name()),
            )?;
        }
        Ok(())
    }

    fn system(&self, py: Python<'py>, stop: Arc<EndRequest>) -> PyResult<PySystem<'py>> {
        let n = self.x0.len();
        let mut places = self.sparsity.clone();
        let pattern_of = |places: &Vec<(usize, usize)>| JacobianPattern::new(n, places.iter().copied());
        let jacobian = match &self.jacobian {
            None => JacobianSource::Differences,
            Some(given) => {
                // Without a pattern, the positions of the entries that a function may return are unknown. An
                // exception raised here is raised again in the run.
                let called = given.is_callable();
                let first = match &places {
                    Some(_) if called && self.slopes.is_none() => {
                        given.call1((self.start, PyArray1::from_slice(py, &self.x0))).ok()
                    }
                    _ => None,
                };
                let matrix = if called { first.as_ref() } else { Some(given) };
                match matrix.filter(|matrix| is_sparse(matrix)) {
                    Some(matrix) => {
                        let entries = sparse_entries(matrix, n)?;
                        if let Some((i, k, v)) = entries.iter().find(|e| !called && !e.2.is_finite()) {
                            return Err(PyValueError::new_err(format!("jac[{i}, {k}] = {v} must be finite")));
                        }
                        let positions = || entries.iter().map(|(i, k, _)| (*i, *k)).collect();
                        let pattern = pattern_of(places.get_or_insert_with(positions));
                        let places = pattern.iter().flat_map(JacobianPattern::entries).zip(0..).collect();
                        let function = called.then(|| given.clone());
                        let sparse = SparseJacobian { function, entries, places };
                        sparse.fill(&sparse.entries, self.start, &mut vec![0.0; sparse.places.len()])?;
                        JacobianSource::Sparse(sparse)
                    }
                    None if called => JacobianSource::Function(given.clone()),
                    None => JacobianSource::Constant(constant(given, n, "jac")?),
                }
            }
        };
        let pattern = places.as_ref().and_then(pattern_of);
        let event = |(function, direction, terminal): &(Bound<'py, PyAny>, f64, usize)| Event {
            function: function.clone(),
            direction: match direction {
                d if *d > 0.0 => Direction::Up,
                d if *d < 0.0 => Direction::Down,
                _ => Direction::Either,
            },
            terminal: *terminal,
            times: Vec::new(),
            states: Vec::new(),
        };
        Ok(PySystem {
            py,
            stop,
            rhs: self.rhs.clone(),
            slopes: self.slopes.clone(),
            x0: self.x0.clone(),
            events: self.events.iter().map(event).collect(),
            on_event: self.on_event.clone(),
            jacobian,
            pattern,
            mass: self.mass.as_ref().map(|m| constant(m, n, "mass")).transpose()?,
            keeps_steps: self.times.is_none(),
            times: Vec::new(),
            states: Vec::new(),
            is_made: false,
            raised: None,
        })
    }
}

/// Returns the method that corresponds to a method name of another tool; None if there is none.
#[pyfunction]
pub(crate) fn solver_of_alias(name: &str) -> Option<&'static str> {
    Method::of_alias(name).map(Method::name)
}

/// Integrates a system written in Python, on the calling thread.
#[pyfunction]
pub(crate) fn solve<'py>(py: Python<'py>, problem: Problem<'py>) -> PyResult<Bound<'py, PyAny>> {
    let watch = InterruptGuard::new(py)?;
    let stop = watch.stop();
    let mut driver = problem.driver(stop)?;
    problem.warn_of_what_is_ignored(py)?;
    let mut system = problem.system(py, Arc::clone(stop))?;
    let mut keeper = Keeper {
        py,
        stop,
        times: Vec::new(),
        states: Vec::new(),
        dense: problem.dense_output.then(|| DenseOutput::new(problem.x0.len())),
    };
    let times = problem.times.as_deref().unwrap_or_default();
    let n = problem.x0.len();
    keeper.states.try_reserve_exact(times.len().saturating_mul(n)).map_err(|_| {
        let gigabytes = 8e-9 * times.len() as f64 * n as f64;
        PyMemoryError::new_err(format!(
            "t_eval: {} times of {n} states require {gigabytes:.1} GB, more memory than is available",
            times.len()
        ))
    })?;
    let outcome = driver.run(&mut system, problem.start, problem.end, times, &mut keeper);
    if let Err(e) = &outcome
        && is_misuse(&e.kind)
    {
        return Err(PyValueError::new_err(e.to_string()));
    }
    if let Err(e) = &outcome
        && matches!(e.kind, ErrorKind::TooLargeForDense { .. })
    {
        return Err(PyMemoryError::new_err(e.to_string()));
    }
    let raised = system.raised.take();
    let result = result(py, system, keeper, &outcome)?;
    error::ended(py, stop, raised, Some(result))
}

/// Replaces the name in the error by the argument name of `pydfo.ode.solve`.
fn in_words_of_solve(error: OptionsError) -> OptionsError {
    match error {
        OptionsError::OutOfRange { name, value, range } => {
            let name = match name {
                "relative_tolerance" => "rtol",
                "absolute_tolerance" => "atol",
                "step_size" => "step",
                other => other,
            };
            OptionsError::OutOfRange { name, value, range }
        }
        other => other,
    }
}

/// Reads a constant matrix, given as the argument `name`, by columns.
fn constant(value: &Bound<'_, PyAny>, n: usize, name: &str) -> PyResult<Vec<f64>> {
    let entries = matrix(value, n, name)?;
    match entries.iter().position(|v| !v.is_finite()) {
        None => Ok(entries),
        Some(p) => {
            let (i, k) = (p % n, p / n);
            Err(PyValueError::new_err(format!("{name}[{i}, {k}] = {} must be finite", entries[p])))
        }
    }
}

/// True for errors of the caller, not of the integration.
fn is_misuse(kind: &ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::Span { .. }
            | ErrorKind::SampleTimes { .. }
            | ErrorKind::ToleranceCount { .. }
            | ErrorKind::MassMatrix { .. }
            | ErrorKind::MassMatrixNeedsImplicit
            | ErrorKind::StepBelowRounding { .. }
            | ErrorKind::NoTolerance { .. }
    )
}

/// Returns the message of the error in the terms of `pydfo.ode.solve`, with the function that returned a
/// value that is not finite.
fn message(error: &SimulationError, n: usize, rhs: &str) -> String {
    let message = error.to_string();
    let Some(value) = &error.not_finite else { return message };
    let (number, index, time) = (Number(value.value), value.index, Number(value.time));
    let words = match value.what {
        Evaluated::Derivative => format!("{rhs} returned {number} for component {index} at t = {time}"),
        Evaluated::EventIndicator => format!("event {index} returned {number} at t = {time}"),
        Evaluated::Jacobian => {
            format!("jac returned {number} for entry [{}, {}] at t = {time}", index % n, index / n)
        }
        _ => return message,
    };
    message.replacen(&value.to_string(), &words, 1)
}

/// Creates a `pydfo.ode.OdeResult`.
fn result<'py>(
    py: Python<'py>,
    system: PySystem<'py>,
    keeper: Keeper<'_, 'py>,
    outcome: &Result<Report, Box<SimulationError>>,
) -> PyResult<Bound<'py, PyAny>> {
    let n = system.x0.len();
    let rows = |states: Vec<f64>, m: usize| PyArray1::from_vec(py, states).reshape([m, n]);
    let (status, message, end_time, stats) = match outcome {
        Ok(report) => {
            let (status, message) = match report.termination {
                Termination::Finished => (0, "The final time was reached."),
                Termination::StoppedByModel => (1, "A terminal event occurred."),
                Termination::StoppedByObserver => (-1, "Interrupted."),
            };
            (status, message.to_owned(), report.time, &report.stats)
        }
        Err(e) => {
            let mut message = message(e, n, system.rhs_name());
            let kind = &e.kind;
            if matches!(
                kind,
                ErrorKind::NoConvergence | ErrorKind::InconsistentSlopes { is_singular: false, .. }
            ) && system.jacobian_pattern().is_some()
            {
                message
                    .push_str("; entries missing from jac_sparsity may make the Jacobian wrong or singular");
            }
            (-1, message, e.time, &e.stats)
        }
    };
    let (times, states) =
        if system.keeps_steps { (system.times, system.states) } else { (keeper.times, keeper.states) };
    let (event_times, event_states): (Vec<_>, Vec<_>) =
        system.events.into_iter().map(|event| (event.times, event.states)).unzip();
    let event_states = event_states.into_iter().zip(&event_times).map(|(states, t)| rows(states, t.len()));
    let n_steps = keeper.dense.as_ref().map_or(0, |dense| dense.spans().len() / 2);
    let array = |values: &[f64]| PyArray1::from_slice(py, values);
    let spans = keeper.dense.as_ref().map(|dense| array(dense.spans()).reshape([n_steps, 2]));
    let shape = [n_steps, DenseOutput::NODES, n];
    let values = keeper.dense.as_ref().map(|dense| array(dense.values()).reshape(shape));
    let fields = dict!(py;;
        "states": rows(states, times.len())?,
        "t": PyArray1::from_vec(py, times),
        "y_events": event_states.collect::<PyResult<Vec<_>>>()?,
        "t_events": event_times.into_iter().map(|times| PyArray1::from_vec(py, times)).collect::<Vec<_>>(),
        "status": status,
        "message": message,
        "end_time": end_time,
        "stats": Counts::new(stats),
        "spans": spans.transpose()?,
        "values": values.transpose()?,
    );
    py.import("pydfo.ode")?.getattr("OdeResult")?.call((), Some(&fields))
}
