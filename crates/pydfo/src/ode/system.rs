//! A hybrid system written in Python: right-hand side, events and Jacobian as functions. They are called on
//! the thread that holds the interpreter lock.

use crate::interrupt::interrupt_guard::{EndRequest, Inside};
use crate::optimize::objective::number;
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use ode::{
    Argument, CallError, CallResult, Direction, EventOutcome, EventVisit, HybridSystem, JacobianPattern,
    StepAction,
};
use pyo3::exceptions::{PyMemoryError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// An event function and its observed occurrences.
pub(crate) struct Event<'py> {
    pub(crate) function: Bound<'py, PyAny>,
    pub(crate) direction: Direction,
    /// Occurrence at which the run ends; 0 means never.
    pub(crate) terminal: usize,
    pub(crate) times: Vec<f64>,
    /// States before the event, one occurrence after the other.
    pub(crate) states: Vec<f64>,
}

/// Source of the Jacobians.
pub(crate) enum JacobianSource<'py> {
    Differences,
    Function(Bound<'py, PyAny>),
    /// Entries by columns.
    Constant(Vec<f64>),
    Sparse(SparseJacobian<'py>),
}

/// A Jacobian that is a sparse matrix.
pub(crate) struct SparseJacobian<'py> {
    /// Function that returns the Jacobian; `None` if the Jacobian is constant.
    pub(crate) function: Option<Bound<'py, PyAny>>,
    /// Row, column and value, if it is constant.
    pub(crate) entries: Vec<(usize, usize, f64)>,
    /// Indices of the positions of the pattern.
    pub(crate) places: HashMap<(usize, usize), usize>,
}

impl SparseJacobian<'_> {
    fn read(&self, t: f64, x: Bound<'_, PyArray1<f64>>, into: &mut [f64]) -> PyResult<()> {
        let Some(function) = &self.function else { return self.fill(&self.entries, t, into) };
        let n = x.len()?;
        self.fill(&sparse_entries(&function.call1((t, x))?, n)?, t, into)
    }

    /// Adds entries at their positions. Returns an error for nonzero entries outside the pattern.
    pub(crate) fn fill(&self, entries: &[(usize, usize, f64)], t: f64, into: &mut [f64]) -> PyResult<()> {
        for (i, k, value) in entries {
            match self.places.get(&(*i, *k)) {
                Some(place) => into[*place] += value,
                None if *value == 0.0 => {}
                None => {
                    return Err(PyValueError::new_err(format!(
                        "jac has an entry at [{i}, {k}] at t = {t}, where jac_sparsity has none"
                    )));
                }
            }
        }
        Ok(())
    }
}

/// The system and the results stored during a run.
pub(crate) struct PySystem<'py> {
    pub(crate) py: Python<'py>,
    pub(crate) stop: Arc<EndRequest>,
    /// The right-hand side, or the residual if there are slopes at the start.
    pub(crate) rhs: Bound<'py, PyAny>,
    pub(crate) slopes: Option<Vec<f64>>,
    pub(crate) x0: Vec<f64>,
    pub(crate) events: Vec<Event<'py>>,
    pub(crate) on_event: Option<Bound<'py, PyAny>>,
    pub(crate) jacobian: JacobianSource<'py>,
    pub(crate) pattern: Option<JacobianPattern>,
    /// Entries by columns.
    pub(crate) mass: Option<Vec<f64>>,
    /// True if the ends of all steps and the states after events are stored.
    pub(crate) keeps_steps: bool,
    pub(crate) times: Vec<f64>,
    pub(crate) states: Vec<f64>,
    /// True if the start or an event added the last row.
    pub(crate) is_made: bool,
    /// The exception that ended the run.
    pub(crate) raised: Option<PyErr>,
}

impl<'py> PySystem<'py> {
    /// Calls into Python and stores the exception, if any.
    fn ask<T>(&mut self, call: impl FnOnce(&Self) -> PyResult<T>) -> CallResult<T> {
        let inside = Inside::new(&self.stop);
        let answer = call(self);
        drop(inside);
        answer.map_err(|e| {
            let message = e.to_string();
            self.raised.get_or_insert(e);
            CallError::failed(message)
        })
    }

    /// Name of the user's function that defines the equations: "residual" or "rhs".
    pub(crate) fn rhs_name(&self) -> &'static str {
        if self.slopes.is_some() { "residual" } else { "rhs" }
    }

    fn array(&self, x: &[f64]) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(self.py, x)
    }

    fn keep(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        if self.keeps_steps {
            if let Err(full) = self.states.try_reserve(x.len()) {
                let message = format!(
                    "not enough memory for the states of step {} ({full}); specify t_eval",
                    self.times.len()
                );
                self.raised.get_or_insert(PyMemoryError::new_err(message.clone()));
                return Err(CallError::failed(message));
            }
            self.times.push(t);
            self.states.extend_from_slice(x);
        }
        Ok(())
    }
}

impl HybridSystem for PySystem<'_> {
    fn n_states(&self) -> usize {
        self.x0.len()
    }

    fn n_event_indicators(&self) -> usize {
        self.events.len()
    }

    fn event_direction(&self, indicator: usize) -> Direction {
        self.events[indicator].direction
    }

    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&self.x0);
        self.keep(t0, x)?;
        self.is_made = true;
        Ok(EventOutcome::default())
    }

    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        if let Some(slopes) = self.slopes.clone() {
            return self.residual(t, x, &slopes, dx);
        }
        self.ask(|system| vector(&system.rhs.call1((t, system.array(x)))?, dx, "rhs"))
    }

    fn can_run_backward(&self) -> bool {
        true
    }

    fn has_residual(&self) -> bool {
        self.slopes.is_some()
    }

    fn slopes_at_start(&mut self, dx: &mut [f64]) {
        if let Some(slopes) = &self.slopes {
            dx.copy_from_slice(slopes);
        }
    }

    fn residual(&mut self, t: f64, x: &[f64], dx: &[f64], r: &mut [f64]) -> CallResult<()> {
        self.ask(|system| vector(&system.rhs.call1((t, system.array(x), system.array(dx)))?, r, "residual"))
    }

    fn residual_jacobian(
        &mut self,
        t: f64,
        x: &[f64],
        dx: &[f64],
        argument: Argument,
        j: &mut [f64],
    ) -> CallResult<bool> {
        self.ask(|system| {
            let JacobianSource::Function(function) = &system.jacobian else { return Ok(false) };
            let (of_states, of_slopes) = function
                .call1((t, system.array(x), system.array(dx)))?
                .extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>()
                .map_err(|_| PyTypeError::new_err("jac must return two matrices, dF/dy and dF/dy'"))?;
            let requested = if argument == Argument::States { of_states } else { of_slopes };
            j.copy_from_slice(&matrix(&requested, x.len(), "jac")?);
            Ok(true)
        })
    }

    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.pattern.as_ref()
    }

    fn has_jacobian(&self) -> bool {
        matches!(self.jacobian, JacobianSource::Function(_) | JacobianSource::Constant(_))
    }

    fn jacobian(&mut self, t: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
        self.ask(|system| match &system.jacobian {
            JacobianSource::Differences | JacobianSource::Sparse(_) => Ok(false),
            JacobianSource::Constant(values) => {
                j.copy_from_slice(values);
                Ok(true)
            }
            JacobianSource::Function(function) => {
                let columns = matrix(&function.call1((t, system.array(x)))?, x.len(), "jac")?;
                j.copy_from_slice(&columns);
                Ok(true)
            }
        })
    }

    fn jacobian_entries(&mut self, t: f64, x: &[f64], entries: &mut [f64]) -> CallResult<bool> {
        self.ask(|system| {
            let JacobianSource::Sparse(sparse) = &system.jacobian else { return Ok(false) };
            sparse.read(t, system.array(x), entries).map(|()| true)
        })
    }

    fn mass_matrix(&self) -> Option<&[f64]> {
        self.mass.as_deref()
    }

    fn states_corrected(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        if self.is_made && self.keeps_steps {
            self.times.pop();
            self.states.truncate(self.states.len() - x.len());
        }
        self.keep(t, x)?;
        Ok(())
    }

    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        self.ask(|system| {
            for (i, (event, z)) in system.events.iter().zip(z).enumerate() {
                *z = number(&event.function.call1((t, system.array(x)))?, &format!("event {i}"))?;
            }
            Ok(())
        })
    }

    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        self.keep(t, x)?;
        self.is_made = false;
        Ok(StepAction::default())
    }

    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let mut which = Vec::new();
        let mut outcome = EventOutcome::default();
        for (i, (event, crossing)) in self.events.iter_mut().zip(visit.crossings).enumerate() {
            if *crossing != 0 {
                which.push(i);
                event.times.push(visit.time);
                event.states.extend_from_slice(x);
                outcome.terminate |= event.terminal != 0 && event.times.len() >= event.terminal;
            }
        }
        if which.is_empty() || self.on_event.is_none() {
            return Ok(outcome);
        }
        outcome.states_changed = self.ask(|system| {
            let Some(on_event) = &system.on_event else { return Ok(false) };
            let states = system.array(x);
            let answer = on_event.call1((visit.time, &states, which))?;
            if answer.is_none() && states.readonly().as_slice()? == x {
                return Ok(false);
            }
            // If nothing is returned, the states changed in place are used.
            vector(if answer.is_none() { &states } else { &answer }, x, "on_event")?;
            match x.iter().position(|v| !v.is_finite()) {
                Some(i) => Err(PyValueError::new_err(format!(
                    "on_event returned {} for state {i} at t = {}",
                    x[i], visit.time
                ))),
                None => Ok(true),
            }
        })?;
        if outcome.states_changed {
            self.keep(visit.time, x)?;
            self.is_made = true;
        }
        Ok(outcome)
    }
}

/// Converts a value to an array of doubles with NumPy. Rejects complex numbers and strings.
fn doubles<'py>(value: &Bound<'py, PyAny>, who: &str) -> PyResult<Bound<'py, PyAny>> {
    let numpy = value.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (value,))?;
    let kind: char = array.getattr("dtype")?.getattr("kind")?.extract()?;
    if !"fiubO".contains(kind) {
        let dtype = array.getattr("dtype")?;
        return Err(PyTypeError::new_err(format!("{who} must return numbers, not an array of type {dtype}")));
    }
    numpy.call_method1("ascontiguousarray", (array, "float64")).map_err(|e| {
        let message = format!("{who} must return numbers: {e}");
        let error = PyTypeError::new_err(message);
        error.set_cause(value.py(), Some(e));
        error
    })
}

/// Copies the vector that a function returned.
fn vector(value: &Bound<'_, PyAny>, into: &mut [f64], who: &str) -> PyResult<()> {
    if let Ok(array) = value.extract::<PyReadonlyArray1<'_, f64>>()
        && let Ok(numbers) = array.as_slice()
        && numbers.len() == into.len()
    {
        into.copy_from_slice(numbers);
        return Ok(());
    }
    let n = into.len();
    let wrong = |what: &str| {
        Err(PyValueError::new_err(format!("{who} must return an array of shape ({n},), not {what}")))
    };
    if value.is_none() {
        return wrong("None. Check for a missing return statement");
    }
    let array = doubles(value, who)?;
    let scalar =
        n == 1 && value.py().import("numpy")?.call_method1("ndim", (value,))?.extract::<usize>()? == 0;
    let shape: Vec<usize> = array.getattr("shape")?.extract()?;
    if !(scalar || shape == [n]) {
        return wrong(&format!("one of shape {}", array.getattr("shape")?));
    }
    let flat = array.call_method0("ravel")?;
    into.copy_from_slice(flat.cast::<PyArray1<f64>>()?.readonly().as_slice()?);
    Ok(())
}

/// True if the value is a sparse matrix.
pub(crate) fn is_sparse(value: &Bound<'_, PyAny>) -> bool {
    value.hasattr("tocoo").unwrap_or(false)
}

/// Row, column and value of the entries of a sparse Jacobian.
pub(crate) fn sparse_entries(value: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<(usize, usize, f64)>> {
    if !is_sparse(value) {
        return Err(PyTypeError::new_err(
            "jac must always return a sparse matrix, because its first result was sparse",
        ));
    }
    let shape: (usize, usize) = value.getattr("shape")?.extract()?;
    if shape != (n, n) {
        return Err(PyValueError::new_err(format!("jac must have the shape ({n}, {n}), not {shape:?}")));
    }
    let list = value.call_method0("tocoo")?;
    let numbers = |name: &str| list.getattr(name)?.call_method0("tolist");
    let (rows, columns): (Vec<usize>, Vec<usize>) = (numbers("row")?.extract()?, numbers("col")?.extract()?);
    let values: Vec<f64> = numbers("data")?.extract()?;
    Ok(rows.into_iter().zip(columns).zip(values).map(|((i, k), value)| (i, k, value)).collect())
}

/// Reads a square matrix by columns. Sparse matrices are converted to dense ones.
pub(crate) fn matrix(value: &Bound<'_, PyAny>, n: usize, who: &str) -> PyResult<Vec<f64>> {
    let dense = if value.hasattr("toarray")? { value.call_method0("toarray")? } else { value.clone() };
    let array = doubles(&dense, who)?;
    let shape: Vec<usize> = array.getattr("shape")?.extract()?;
    if shape != [n, n] {
        let shape = array.getattr("shape")?;
        return Err(PyValueError::new_err(format!("{who} must have the shape ({n}, {n}), not {shape}")));
    }
    let rows: PyReadonlyArray2<'_, f64> = array.extract()?;
    let rows = rows.as_slice()?;
    Ok((0..n * n).map(|p| rows[(p % n) * n + p / n]).collect())
}
