//! A Python function as an objective. Any thread may evaluate it; the interpreter lock is held only during
//! the call.

use crate::interrupt::interrupt_guard::{EndRequest, Inside};
use crate::interrupt::lock::lock;
use dfo::{Answer, BatchView, CutoffUse, Objective, Outcome, Query, Report, RobustLoss};
use numpy::{PyArray1, PyArrayMethods, PyUntypedArray};
use pyo3::exceptions::{PyBaseException, PyException, PyKeyboardInterrupt, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyCFunction, PyDict, PyFloat, PyTuple};
use std::sync::{Arc, Mutex};

/// A Python function `f(x) -> float`, `f(x, *, cutoff) -> float | Above`, or one that returns a vector of
/// residuals.
pub(crate) struct PyObjective {
    function: Py<PyAny>,
    /// True if an exception counts as a failed evaluation instead of ending the run.
    failures_allowed: bool,
    /// True if the function receives the cutoff, and may return `Above`.
    takes_cutoff: bool,
    /// Loss function of the residuals; `None` if the function returns a cost.
    loss: Option<RobustLoss>,
    /// True if the function returns an `Evaluation` with the values of the nonlinear constraints.
    is_constrained: bool,
    stop: Arc<EndRequest>,
    /// Exceptions and the points at which they were raised. The run ends with the exception of the first such
    /// point on its path.
    raised: Mutex<Vec<(Vec<u64>, PyErr)>>,
}

impl PyObjective {
    pub(crate) fn new(
        function: Py<PyAny>,
        failures_allowed: bool,
        takes_cutoff: bool,
        loss: Option<RobustLoss>,
        stop: Arc<EndRequest>,
    ) -> Self {
        let (is_constrained, raised) = (false, Mutex::default());
        Self { function, failures_allowed, takes_cutoff, loss, is_constrained, stop, raised }
    }

    /// Declares that the function returns an `Evaluation` with the values of the nonlinear constraints.
    pub(crate) fn constrained(self, is_constrained: bool) -> Self {
        Self { is_constrained, ..self }
    }

    /// Returns `CutoffUse::Yes` if evaluations stop above the cutoff.
    pub(crate) fn cutoff_use(&self) -> CutoffUse {
        if self.takes_cutoff { CutoffUse::Yes } else { CutoffUse::No }
    }

    /// Returns the function, or the callable that passes points to it.
    pub(crate) fn function<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.function.bind(py).clone()
    }

    /// Takes the exception that ended the run, raised at the point of the path that ended it.
    pub(crate) fn take_raised(&self, run: &Result<Report, dfo::Error>) -> Option<PyErr> {
        let trace = run.as_ref().map_or_else(|e| e.trace(), |report| Some(&report.trace))?;
        let end = trace.iter().rev().find(|entry| matches!(entry.outcome, Outcome::Abort(_)))?;
        let mut raised = lock(&self.raised);
        let place = raised.iter().position(|(x, _)| *x == bits(end.x))?;
        Some(raised.swap_remove(place).1)
    }

    /// Records this exception and returns the outcome that ends the run.
    pub(crate) fn abort(&self, x: &[f64], exception: PyErr) -> Outcome {
        let message = exception.to_string();
        lock(&self.raised).push((bits(x), exception));
        Outcome::Abort(message)
    }

    /// Fills `answer` from a call of the user's function: its outcome, its residuals and the values of the
    /// nonlinear constraints.
    fn fill(&self, py: Python<'_>, x: &[f64], returned: PyResult<Bound<'_, PyAny>>, answer: &mut Answer) {
        let returned = match returned {
            Ok(value) if self.is_constrained => parts(&value, &mut answer.constraints),
            other => other,
        };
        answer.outcome = match returned {
            Ok(value) if self.is_constrained && value.is(py.Ellipsis()) => Outcome::infeasible(),
            other => self.outcome(py, x, other, &mut answer.residuals),
        };
    }

    /// Returns the outcome of a call of the user's function. Residuals, if it returns them, are stored in
    /// `out`.
    fn outcome(
        &self,
        py: Python<'_>,
        x: &[f64],
        returned: PyResult<Bound<'_, PyAny>>,
        out: &mut Vec<f64>,
    ) -> Outcome {
        match returned {
            Ok(value) if self.takes_cutoff && is_above(&value) => {
                match value.getattr("cutoff").and_then(|cutoff| number(&cutoff, "the cutoff of Above")) {
                    Ok(cutoff) => Outcome::Above(cutoff),
                    Err(e) => self.abort(x, e),
                }
            }
            Ok(value) => {
                let outcome = match self.loss {
                    Some(loss) => residuals(&value, out).map(|()| loss.cost(out, f64::INFINITY)),
                    None => number(&value, "the objective").map(Outcome::Value),
                };
                // Always an error of the program, never of the model.
                outcome.unwrap_or_else(|e| self.abort(x, e))
            }
            // The user requested the end, even if the point is evaluated speculatively.
            Err(e) if e.is_instance_of::<PyKeyboardInterrupt>(py) => {
                let message = e.to_string();
                self.stop.end_with(e);
                Outcome::Abort(message)
            }
            // SystemExit and similar exceptions end the run when its path reaches the point.
            Err(e) if self.failures_allowed && e.is_instance_of::<PyException>(py) => {
                Outcome::failed(e.to_string())
            }
            Err(e) => self.abort(x, e),
        }
    }

    /// Fills `answer` from a returned value: a cost, residuals, or the raised exception.
    pub(crate) fn answer_from<'py>(
        &self,
        py: Python<'py>,
        x: &[f64],
        value: Bound<'py, PyAny>,
        answer: &mut Answer,
    ) {
        let is_exception = value.is_instance_of::<PyBaseException>();
        let returned = if is_exception { Err(PyErr::from_value(value)) } else { Ok(value) };
        self.fill(py, x, returned, answer);
    }

    /// Evaluates a batch. The function receives all points, shape (points, parameters), their cutoffs, and a
    /// function that returns whether to stop. It returns for each point a cost, the raised exception, or
    /// Ellipsis for an omitted point. Called on the calling thread.
    pub(crate) fn evaluate_batch(&self, py: Python<'_>, batch: &BatchView<'_>) -> Vec<Outcome> {
        let _inside = Inside::new(&self.stop);
        let mut outcomes = vec![Outcome::Skipped; batch.len()];
        let answers = self.answers(py, batch);
        match answers {
            Err(e) => outcomes[0] = self.abort(batch.point(0), e),
            Ok(answers) => {
                for ((k, place), answer) in outcomes.iter_mut().enumerate().zip(answers) {
                    if answer.is(py.Ellipsis()) {
                        continue;
                    }
                    // With or without its evaluation time.
                    let answer = match answer.cast_into::<PyTuple>() {
                        Ok(timed) if timed.get_type().is(py.get_type::<PyTuple>()) && timed.len() == 2 => {
                            if let Ok(seconds) = timed.get_item(0).and_then(|s| s.extract()) {
                                batch.set_seconds(k, seconds);
                            }
                            match timed.get_item(1) {
                                Ok(value) => value,
                                Err(_) => continue,
                            }
                        }
                        Ok(other) => other.into_any(),
                        Err(e) => e.into_inner(),
                    };
                    let mut found = Answer::default();
                    self.answer_from(py, batch.point(k), answer, &mut found);
                    batch.set_residuals(k, &found.residuals);
                    batch.set_constraints(k, &found.constraints);
                    *place = found.outcome;
                }
            }
        }
        outcomes
    }

    fn answers<'py>(&self, py: Python<'py>, batch: &BatchView<'_>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let points = PyArray1::from_slice(py, batch.as_flat()).reshape([batch.len(), batch.n()])?;
        let cutoffs = PyArray1::from_iter(py, (0..batch.len()).map(|k| batch.query(k).cutoff));
        let stop = Arc::clone(&self.stop);
        let requested = PyCFunction::new_closure(py, None, None, move |args, _| stop.poll(args.py()))?;
        let answers: Vec<Bound<'py, PyAny>> =
            self.function.bind(py).call1((points, cutoffs, requested))?.extract()?;
        if answers.len() == batch.len() {
            return Ok(answers);
        }
        let (got, points) = (answers.len(), batch.len());
        Err(PyValueError::new_err(format!("the objective returned {got} costs for {points} points")))
    }
}

impl Objective for PyObjective {
    fn uses_cutoff(&self) -> bool {
        self.takes_cutoff
    }

    fn has_residuals(&self) -> bool {
        self.loss.is_some()
    }

    fn residual_loss(&self) -> RobustLoss {
        self.loss.unwrap_or_default()
    }

    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        let _inside = Inside::new(&self.stop);
        Python::attach(|py| {
            let point = (PyArray1::from_slice(py, x),);
            let returned = if self.takes_cutoff {
                let cutoff = PyDict::new(py);
                cutoff
                    .set_item("cutoff", query.cutoff)
                    .and_then(|()| self.function.bind(py).call(point, Some(&cutoff)))
            } else {
                self.function.bind(py).call1(point)
            };
            self.fill(py, x, returned, answer);
        });
    }
}

/// Reads the constraint values of an `Evaluation` and returns its value of the objective.
fn parts<'py>(value: &Bound<'py, PyAny>, constraints: &mut Vec<f64>) -> PyResult<Bound<'py, PyAny>> {
    residuals(&value.getattr("constraints")?, constraints)?;
    value.getattr("value")
}

fn bits(x: &[f64]) -> Vec<u64> {
    x.iter().map(|v| v.to_bits()).collect()
}

/// True if a function returned `pydfo.Above`.
fn is_above(value: &Bound<'_, PyAny>) -> bool {
    let class = || value.py().import("pydfo._optimize.optimizer")?.getattr("Above");
    !value.is_instance_of::<PyFloat>() && class().and_then(|class| value.is_instance(&class)).unwrap_or(false)
}

/// Reads the residuals that a Python function returned into `out`. Accepts any object that NumPy converts to
/// a one-dimensional array.
///
/// # Errors
/// Raises TypeError for other objects.
pub(crate) fn residuals(value: &Bound<'_, PyAny>, out: &mut Vec<f64>) -> PyResult<()> {
    out.clear();
    // NumPy treats subclasses differently, for example masked arrays.
    let is_plain = value.cast_exact::<PyUntypedArray>().is_ok();
    if let (true, Ok(array)) = (is_plain, value.cast::<PyArray1<f64>>()) {
        out.extend(array.try_readonly()?.as_array());
        return Ok(());
    }
    let array = value.py().import("pydfo._optimize.evaluate")?.getattr("residual_vector")?.call1((value,))?;
    out.extend(array.cast::<PyArray1<f64>>()?.to_vec()?);
    Ok(())
}

/// Reads the number that a Python function returned: a float or an int, a NumPy scalar, or an array of one
/// element.
///
/// # Errors
/// Raises TypeError if `who` returned another object.
pub(crate) fn number(value: &Bound<'_, PyAny>, who: &str) -> PyResult<f64> {
    if let Ok(number) = value.cast::<PyFloat>() {
        return Ok(number.value());
    }
    let bad = |what: String| {
        PyTypeError::new_err(format!(
            "{who} must return one number (a float, a NumPy scalar or an array of one element), not {what}"
        ))
    };
    if value.is_none() {
        return Err(bad("None. Check for a missing return statement".to_owned()));
    }
    if let (Ok(shape), Ok(dtype)) = (value.getattr("shape"), value.getattr("dtype")) {
        if !value.getattr("size").and_then(|s| s.extract::<usize>()).is_ok_and(|size| size == 1) {
            return Err(bad(format!("an array of shape {shape}")));
        }
        // A masked value is not a number, whatever the data under the mask.
        if value.getattr("mask").and_then(|mask| mask.call_method0("any")?.is_truthy()).unwrap_or(false) {
            return Ok(f64::NAN);
        }
        return match dtype.getattr("kind").and_then(|k| k.extract::<char>()) {
            Ok('f' | 'i' | 'u' | 'b') => value.call_method0("item")?.extract(),
            _ => Err(bad(format!("an array or scalar of type {dtype}"))),
        };
    }
    // Any object that converts to a float: int, Fraction, Decimal, a tensor of another library.
    value.extract().map_err(|_| {
        let name = value.get_type().name().map_or_else(|_| "?".to_owned(), |n| n.to_string());
        let text = value.repr().map_or_else(|_| String::new(), |r| r.to_string());
        let shown: String = text.chars().take(60).collect();
        let dots = if shown.len() < text.len() { "..." } else { "" };
        bad(format!("{shown}{dots} ({name})"))
    })
}
