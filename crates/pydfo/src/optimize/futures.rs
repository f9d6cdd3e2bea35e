//! A Python executor as an evaluator. Points are submitted one by one, for a function of the user or for the
//! simulations of a fit.

use crate::convert::object::to_bytes;
use crate::interrupt::interrupt_guard::{EndRequest, Inside};
use crate::optimize::objective::PyObjective;
use calibration::{Calibration, SimulationExecutor};
use dfo::{Answer, CutoffUse, Evaluator, Outcome, PollResult, Query, RobustLoss, Wait};
use numpy::PyArray1;
use ode::Stats;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

/// Serialises the problem of a calibration.
pub(crate) fn state(calibration: &Calibration) -> PyResult<Vec<u8>> {
    to_bytes(calibration.problem())
}

/// Answer of `_evaluate.Futures`: number of the point, time of the evaluation in s, its outcome, and the
/// fault of the executor: "" (none), "lost" (this point), "broken".
type Ended = (u64, f64, Py<PyAny>, String);

/// Result of polling.
enum PolledAnswer {
    Value {
        id: u64,
        x: Vec<f64>,
        seconds: f64,
        value: Py<PyAny>,
    },
    /// The executor has lost this point.
    Lost {
        id: u64,
        why: PyErr,
    },
    /// The executor will not evaluate any points.
    Broken {
        id: u64,
        x: Vec<f64>,
        why: PyErr,
    },
    Waiting,
    Idle,
}

/// An object of `_evaluate.Futures`, and the points being evaluated there.
struct Futures {
    futures: Py<PyAny>,
    stop: Arc<EndRequest>,
    width: usize,
    under_way: HashMap<u64, Vec<f64>>,
    /// Points that the executor rejected, and the exceptions.
    refused: VecDeque<(u64, PyErr)>,
}

impl Futures {
    fn new(futures: &Bound<'_, PyAny>, stop: Arc<EndRequest>) -> PyResult<Self> {
        let width = futures.getattr("width")?.extract()?;
        let futures = futures.clone().unbind();
        Ok(Self { futures, stop, width, under_way: HashMap::new(), refused: VecDeque::new() })
    }

    fn submit(&mut self, x: &[f64], query: &Query<'_>) {
        self.under_way.insert(query.id, x.to_vec());
        let submitted = Python::attach(|py| {
            let point = PyArray1::from_slice(py, x);
            self.futures.call_method1(py, "submit", (query.id, point, query.cutoff)).map(drop)
        });
        if let Err(e) = submitted {
            self.refused.push_back((query.id, e));
        }
    }

    fn poll(&mut self, wait: &Wait<'_>) -> PolledAnswer {
        if let Some((id, why)) = self.refused.pop_front() {
            return PolledAnswer::Broken { id, x: self.under_way.remove(&id).unwrap_or_default(), why };
        }
        if self.under_way.is_empty() {
            return PolledAnswer::Idle;
        }
        let _inside = Inside::new(&self.stop);
        let polled = Python::attach(|py| {
            let ended = self.futures.call_method1(py, "poll", (wait.left().as_secs_f64(),))?;
            if ended.is_none(py) {
                return Ok(None);
            }
            let (id, seconds, value, fault): Ended = ended.extract(py)?;
            let why = |value: Py<PyAny>| PyErr::from_value(value.into_bound(py));
            let x = self.under_way.remove(&id).unwrap_or_default();
            Ok::<_, PyErr>(Some(match &fault[..] {
                "lost" => PolledAnswer::Lost { id, why: why(value) },
                "broken" => PolledAnswer::Broken { id, x, why: why(value) },
                _ => PolledAnswer::Value { id, x, seconds, value },
            }))
        });
        match polled {
            Ok(taken) => taken.unwrap_or(PolledAnswer::Waiting),
            // A second Ctrl-C, for example.
            Err(e) => {
                self.stop.end_with(e);
                self.under_way.clear();
                PolledAnswer::Idle
            }
        }
    }

    fn cancel(&self, id: u64) {
        if let Err(e) = Python::attach(|py| self.futures.call_method1(py, "cancel", (id,)).map(drop)) {
            self.stop.end_with(e);
        }
    }
}

/// Interpretation of the answers of an executor.
pub(crate) trait Answers {
    /// Fills in `answer` from the value returned for a point.
    fn read(&mut self, x: &[f64], value: Py<PyAny>, answer: &mut Answer);

    /// Returns the outcome if the executor does not evaluate any points.
    fn broken(&mut self, x: &[f64], why: PyErr) -> Outcome;

    /// As [`Evaluator::cutoff_use`].
    fn cutoff_use(&self) -> CutoffUse {
        CutoffUse::Unknown
    }
}

/// Evaluator that submits points to an executor.
pub(crate) struct OnExecutor<A> {
    futures: Futures,
    answers: A,
}

impl<A: Answers> Evaluator for OnExecutor<A> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        self.futures.submit(x, &query);
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        answer.clear();
        match self.futures.poll(wait) {
            PolledAnswer::Value { id, x, seconds, value } => {
                if !Python::attach(|py| value.is(py.Ellipsis())) {
                    self.answers.read(&x, value, answer);
                }
                answer.seconds = seconds;
                PollResult::Answered(id)
            }
            PolledAnswer::Lost { id, why } => {
                answer.outcome = Outcome::lost(why.to_string());
                PollResult::Answered(id)
            }
            PolledAnswer::Broken { id, x, why } => {
                answer.outcome = self.answers.broken(&x, why);
                PollResult::Answered(id)
            }
            PolledAnswer::Waiting => PollResult::Waiting,
            PolledAnswer::Idle => PollResult::Idle,
        }
    }

    fn cancel(&mut self, id: u64) {
        self.futures.cancel(id);
    }

    fn width(&self) -> usize {
        self.futures.width
    }

    fn cutoff_use(&self) -> CutoffUse {
        self.answers.cutoff_use()
    }

    /// Always true: an executor finishes the evaluations it has begun without this evaluator.
    fn leave(&mut self) -> bool {
        true
    }

    /// Number of overdue tasks that were submitted again.
    fn n_lost(&self) -> usize {
        let taken = Python::attach(|py| {
            self.futures.futures.call_method0(py, "take_n_overdue")?.extract::<usize>(py)
        });
        taken.unwrap_or(0)
    }
}

/// Values of a function of the user.
impl Answers for &PyObjective {
    fn read(&mut self, x: &[f64], value: Py<PyAny>, answer: &mut Answer) {
        Python::attach(|py| self.answer_from(py, x, value.into_bound(py), answer));
    }

    fn broken(&mut self, x: &[f64], why: PyErr) -> Outcome {
        self.abort(x, why)
    }

    fn cutoff_use(&self) -> CutoffUse {
        PyObjective::cutoff_use(self)
    }
}

/// Creates an evaluator for a function of the user on an executor. `futures`: a `_evaluate.Futures`.
///
/// # Errors
/// Returns an error if `futures` is another object.
pub(crate) fn of_function<'a>(
    futures: &Bound<'_, PyAny>,
    objective: &'a PyObjective,
    stop: Arc<EndRequest>,
) -> PyResult<OnExecutor<&'a PyObjective>> {
    Ok(OnExecutor { futures: Futures::new(futures, stop)?, answers: objective })
}

/// Simulations of a fit.
pub(crate) struct Simulated {
    stats: Stats,
    stop: Arc<EndRequest>,
}

/// The simulations of a fit on an executor.
pub(crate) type PySimulationExecutor = OnExecutor<Simulated>;

impl PySimulationExecutor {
    /// Creates the evaluator. `futures`: a `_engine.Simulations`.
    ///
    /// # Errors
    /// Returns an error if `futures` is another object.
    pub(crate) fn new(futures: &Bound<'_, PyAny>, stop: Arc<EndRequest>) -> PyResult<Self> {
        let answers = Simulated { stats: Stats::default(), stop: Arc::clone(&stop) };
        Ok(Self { futures: Futures::new(futures, stop)?, answers })
    }
}

impl Answers for Simulated {
    fn read(&mut self, _: &[f64], value: Py<PyAny>, answer: &mut Answer) {
        let read = Python::attach(|py| {
            let bytes = value.cast_bound::<PyBytes>(py).map_err(|e| e.to_string())?;
            ciborium::from_reader::<(Answer, Stats), _>(bytes.as_bytes()).map_err(|e| e.to_string())
        });
        match read {
            Ok((found, stats)) => {
                self.stats += stats;
                *answer = found;
            }
            Err(why) => {
                answer.outcome = Outcome::Abort(format!("cannot read a result of the executor: {why}"));
            }
        }
    }

    fn broken(&mut self, _: &[f64], why: PyErr) -> Outcome {
        let outcome = Outcome::Abort(why.to_string());
        self.stop.end_with(why);
        outcome
    }
}

impl SimulationExecutor for PySimulationExecutor {
    fn begin(&mut self, calibration: &Calibration, loss: RobustLoss) {
        let begun = Python::attach(|py| {
            let state = PyBytes::new(py, &state(calibration)?);
            let loss = PyBytes::new(py, &to_bytes(&loss)?);
            self.futures.futures.call_method1(py, "begin", (state, loss)).map(drop)
        });
        if let Err(e) = begun {
            self.answers.stop.end_with(e);
        }
    }

    fn take_stats(&mut self) -> Stats {
        std::mem::take(&mut self.answers.stats)
    }
}
