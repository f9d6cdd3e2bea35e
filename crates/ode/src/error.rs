//! End of a run: a normal end ([`Termination`]) or a [`SimulationError`].

use crate::stats::Stats;
use base::Number;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;

/// A normal end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Termination {
    /// The final time was reached.
    Finished,
    /// The model requested the end of the simulation.
    StoppedByModel,
    /// The observer stopped the run.
    StoppedByObserver,
}

/// Report of a run that ends normally.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Reason of the end.
    pub termination: Termination,
    /// Time at which it ended.
    pub time: f64,
    /// Cost of the run.
    pub stats: Stats,
}

/// Reason why a run failed.
#[derive(Debug)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The span is invalid: a bound is not finite, or the end is before the start and the system cannot run
    /// backward.
    Span {
        /// Start time.
        start: f64,
        /// Final time.
        end: f64,
    },
    /// The requested sample times are not finite, not in the order of the integration, or outside the span.
    SampleTimes {
        /// Position in the list.
        index: usize,
        /// The time at this position.
        time: f64,
    },
    /// The number of absolute tolerances differs from the number of states.
    ToleranceCount {
        /// Number of tolerances given.
        given: usize,
        /// Number of states of the model.
        states: usize,
    },
    /// A state and its absolute tolerance are both zero, so every error of this state would be too large.
    NoTolerance {
        /// Index of the state.
        state: usize,
    },
    /// The error test or a discarded point required a step below the resolution of the numbers.
    StepTooSmall {
        /// True if the model refused the last tried point (discard, NaN or infinity).
        discarded: bool,
    },
    /// The requested step cannot distinguish two instants of this span. It is the step of a fixed-step method
    /// or the maximum step of an adaptive method.
    StepBelowRounding {
        /// The requested step.
        step: f64,
        /// The step must be larger than this value.
        least: f64,
    },
    /// The equations of an implicit method could not be solved, even with the smallest meaningful step.
    NoConvergence,
    /// The mass matrix does not have one row and one column per state, or contains a value that is not
    /// finite.
    MassMatrix {
        /// Number of entries given.
        given: usize,
        /// Number of states of the model.
        states: usize,
    },
    /// An implicit method requires dense matrices with one row per state, and memory is insufficient for
    /// them.
    TooLargeForDense {
        /// Number of states of the model.
        states: usize,
    },
    /// The model has a mass matrix, which this method does not support.
    MassMatrixNeedsImplicit,
    /// The model is given by its residual, which only BDF supports.
    ResidualNeedsBdf,
    /// The equations do not determine some of the states at the start because the index is above 1.
    /// [`SimulationError::undetermined`] contains these states.
    HigherIndex,
    /// The equations of a singular mass matrix that contain no derivative do not hold at the start or after
    /// an event. No states were found for which they hold.
    Inconsistent {
        /// The equation with the largest residual relative to the tolerances of the states.
        equation: usize,
        /// Its residual, which is not zero.
        residual: f64,
    },
    /// A residual is not zero at the start or after an event. Starting from the given values, no slopes were
    /// found that make it zero, nor values of the states without a slope.
    InconsistentSlopes {
        /// The equation with the largest residual at the given values.
        equation: usize,
        /// The residual.
        residual: f64,
        /// True if `dF/dx'` has a smaller rank at the given values than near them. It then does not show
        /// which states have a slope.
        is_singular: bool,
    },
    /// The model refused its own starting point (or the point right after an event), or a state or derivative
    /// is not finite there.
    DiscardedAtRestart,
    /// The limit on the number of steps was reached.
    TooManySteps(u64),
    /// The limit on the number of events was reached.
    TooManyEvents(u64),
    /// The limit on the number of right-hand sides was reached.
    TooManyRightHandSides(u64),
    /// The limit on the wall-clock time was reached.
    TimedOut(Duration),
    /// The cancel flag was set.
    Cancelled,
    /// State events follow each other without time advancing.
    Chattering {
        /// Number of events in a row.
        events: u64,
        /// Length of the time interval in which they happened.
        within: f64,
        /// The indicator that crossed last.
        indicator: usize,
    },
    /// An event indicator returned to zero after its event in less time than the resolution of times. Its
    /// events accumulate there (Zeno), and a solution after this point would not solve the model.
    EventsAccumulate {
        /// The indicator.
        indicator: usize,
    },
    /// This number of consecutive time events each announced the next one for the same instant or for one
    /// only slightly later.
    TimeEventLoop(u64),
    /// The model announced a time event in the past.
    EventInThePast(f64),
    /// A call into the model failed.
    Model(Box<dyn std::error::Error + Send + Sync>),
}

impl ErrorKind {
    /// Returns the reason without the numbers that differ between runs, so that failures of one kind can be
    /// counted.
    pub fn summary(&self) -> String {
        match self {
            Self::Span { .. } => "invalid time span".to_owned(),
            Self::SampleTimes { .. } => "invalid sample times".to_owned(),
            Self::ToleranceCount { .. } => {
                "the number of absolute tolerances differs from the number of states".to_owned()
            }
            Self::NoTolerance { .. } => "the error tolerance of a state is zero".to_owned(),
            Self::StepTooSmall { discarded: false } => {
                "the error test requires steps that are too small".to_owned()
            }
            Self::StepTooSmall { discarded: true } => {
                "the model cannot be evaluated beyond this point".to_owned()
            }
            Self::StepBelowRounding { .. } => "the requested step size is too small".to_owned(),
            Self::NoConvergence => "the equations of the implicit method do not converge".to_owned(),
            Self::MassMatrix { .. } => "invalid mass matrix".to_owned(),
            Self::TooLargeForDense { .. } => "not enough memory for dense matrices".to_owned(),
            Self::MassMatrixNeedsImplicit => "a mass matrix requires solver radau5 or bdf".to_owned(),
            Self::ResidualNeedsBdf => "a system in residual form requires solver bdf".to_owned(),
            Self::HigherIndex => "the index of the system is above 1".to_owned(),
            Self::Inconsistent { .. } => "the states are inconsistent".to_owned(),
            Self::InconsistentSlopes { .. } => "the derivatives are inconsistent".to_owned(),
            Self::DiscardedAtRestart => "the model cannot be evaluated at its current state".to_owned(),
            Self::TooManySteps(n) => format!("the limit of {n} steps was reached"),
            Self::TooManyEvents(n) => format!("the limit of {n} events was reached"),
            Self::TooManyRightHandSides(n) => {
                format!("the limit of {n} right-hand side evaluations was reached")
            }
            Self::TimedOut(limit) => {
                format!("the time limit of {} s was reached", Number(limit.as_secs_f64()))
            }
            Self::Cancelled => "cancelled".to_owned(),
            Self::Chattering { indicator, .. } => format!("chattering (event indicator {indicator})"),
            Self::EventsAccumulate { indicator } => {
                format!("events accumulate (event indicator {indicator})")
            }
            Self::TimeEventLoop(_) => "time events repeat without time advancing".to_owned(),
            Self::EventInThePast(_) => "the model announced a time event in the past".to_owned(),
            Self::Model(e) => e.to_string(),
        }
    }
}

/// Kind of the evaluated values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Evaluated {
    /// The states at the start of the model or after an event.
    State,
    /// The right-hand side.
    Derivative,
    /// The event indicators.
    EventIndicator,
    /// The model's own Jacobian, by columns.
    Jacobian,
}

/// A value that is NaN or infinite.
#[derive(Debug, Clone, PartialEq)]
pub struct NotFinite {
    /// Kind of the value.
    pub what: Evaluated,
    /// Its position, counted from zero.
    pub index: usize,
    /// The value itself.
    pub value: f64,
    /// Time of the evaluation.
    pub time: f64,
    /// Name in the model, if the caller knows the names and filled it in.
    pub name: Option<String>,
}

impl NotFinite {
    pub(crate) fn first(what: Evaluated, time: f64, values: &[f64]) -> Option<Self> {
        let index = values.iter().position(|v| !v.is_finite())?;
        Some(Self { what, index, value: values[index], time, name: None })
    }
}

impl NotFinite {
    /// Describes the value without the time, so that failures of one kind can be counted.
    pub fn summary(&self) -> String {
        let Self { what, index, value, name, .. } = self;
        let what = match what {
            Evaluated::State => format!("state {index}"),
            Evaluated::Derivative => format!("the derivative of state {index}"),
            Evaluated::EventIndicator => format!("event indicator {index}"),
            Evaluated::Jacobian => format!("entry {index} of the Jacobian (column-major order)"),
        };
        let name = name.as_ref().map_or_else(String::new, |name| format!(" ({name})"));
        format!("{what}{name} is {}", Number(*value))
    }
}

impl fmt::Display for NotFinite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at t = {}", self.summary(), Number(self.time))
    }
}

/// States that the equations do not determine: the sign of a system of index 2 or higher.
#[derive(Debug, Clone, PartialEq)]
pub struct Undetermined {
    /// An equation without derivatives that, together with the others, does not determine the states it
    /// should.
    pub equation: usize,
    /// The states that remain without an equation.
    pub states: Vec<usize>,
    /// Largest pivot that remains for these states in the Jacobian of the equations without derivatives. The
    /// Jacobian is scaled: an entry is the effect of changing a state by its size, and the largest effect on
    /// each equation is 1. The pivot is below 1e-6.
    pub pivot: f64,
}

impl fmt::Display for Undetermined {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { equation, states, pivot } = self;
        write!(
            f,
            "the system probably has index 2 or higher, because equation {equation}, which contains no \
             derivative, does not determine its states {states:?} (their block of the Jacobian is singular, \
             largest pivot {})",
            Number(*pivot)
        )
    }
}

/// Memory is insufficient for dense matrices with one row per state.
#[derive(Debug)]
pub(crate) struct TooLargeForDense {
    pub(crate) states: usize,
}

impl fmt::Display for TooLargeForDense {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.states as f64;
        let gigabytes = 8e-9 * n * n;
        write!(
            f,
            "an implicit method requires a dense Jacobian of {0} x {0} entries ({gigabytes:.1} GB), and one \
             to three times as much memory for its factors. Specify the sparsity pattern of the Jacobian, or \
             use an explicit method (tsit5, dop853)",
            self.states
        )
    }
}

impl std::error::Error for TooLargeForDense {}

impl From<TooLargeForDense> for ErrorKind {
    fn from(TooLargeForDense { states }: TooLargeForDense) -> Self {
        Self::TooLargeForDense { states }
    }
}

/// A failed run: the reason, the point of failure and the numbers at that point.
#[derive(Debug)]
pub struct SimulationError {
    /// Reason of the failure.
    pub kind: ErrorKind,
    /// Time reached.
    pub time: f64,
    /// Size of the step being tried.
    pub step: f64,
    /// State with the largest weighted error in the last rejected step.
    pub worst_state: Option<usize>,
    /// Time of the last event.
    pub last_event: Option<f64>,
    /// The value that was not finite when the model could not be evaluated, if one was found.
    pub not_finite: Option<NotFinite>,
    /// States that the equations of a differential-algebraic system do not determine, which happens in
    /// systems of index 2 or higher. Determined if steps failed or no consistent states were found.
    pub undetermined: Option<Undetermined>,
    /// Message of the system about the point it refused. The caller that created the system fills it in.
    pub refusal: Option<String>,
    /// Cost up to the failure.
    pub stats: Stats,
}

impl ErrorKind {
    /// Returns the whole message if the run could not start; `None` if it had started.
    fn before_the_run(&self) -> Option<String> {
        Some(match self {
            Self::Span { start, end } => {
                let is_finite = start.is_finite() && end.is_finite();
                let (start, end) = (Number(*start), Number(*end));
                let why = if is_finite {
                    "this system cannot be integrated backward"
                } else {
                    "both times must be finite"
                };
                format!("cannot simulate from {start} to {end}: {why}")
            }
            Self::SampleTimes { index, time } => format!(
                "requested time {} at position {index} must be finite, in the order of the integration, and \
                 within the time span",
                Number(*time)
            ),
            Self::ToleranceCount { given, states } => {
                format!("absolute tolerances: expected {states}, one per state; got {given}")
            }
            Self::StepBelowRounding { step, least } => format!(
                "step size {} is too small for the resolution of times in this span; expected more than {}",
                Number(*step),
                Number(*least)
            ),
            Self::MassMatrix { given, states } => format!(
                "mass matrix: expected {states} x {states} finite entries in column-major order; got {given} \
                 entries"
            ),
            Self::TooLargeForDense { states } => TooLargeForDense { states: *states }.to_string(),
            Self::MassMatrixNeedsImplicit => {
                "solver: a system with a mass matrix can be integrated only by radau5, bdf or auto".to_owned()
            }
            Self::ResidualNeedsBdf => {
                "solver: a system in residual form can be integrated only by bdf".to_owned()
            }
            _ => return None,
        })
    }
}

impl SimulationError {
    /// Returns the first part of the message of a run that had started: why and when it ended.
    fn end_of_the_run(&self) -> String {
        let (t, h) = (Number(self.time), Number(self.step));
        match &self.kind {
            ErrorKind::NoTolerance { state } => format!(
                "state {state} and its absolute tolerance are both 0 at t = {t}, so its error tolerance is \
                 zero; set a positive absolute tolerance"
            ),
            ErrorKind::StepTooSmall { discarded: false } => {
                format!("the error test requires steps below {h} at t = {t}")
            }
            ErrorKind::StepTooSmall { discarded: true } => {
                format!("the model cannot be evaluated beyond t = {t}, even with a step size of {h}")
            }
            ErrorKind::NoConvergence => {
                format!(
                    "the equations of the implicit method do not converge at t = {t}, even with a step size \
                     of {h}"
                )
            }
            ErrorKind::HigherIndex => format!("the equations do not determine the states at t = {t}"),
            ErrorKind::Inconsistent { equation, residual } => format!(
                "the states at t = {t} are inconsistent, and no consistent states with the same left-hand \
                 side were found: equation {equation}, which contains no derivative, has residual {}",
                Number(*residual)
            ),
            ErrorKind::InconsistentSlopes { equation, residual, is_singular } => {
                let why = match is_singular {
                    true => {
                        "the Jacobian with respect to the derivatives is singular at this point but not \
                             near it"
                    }
                    false => "Newton's method did not converge to consistent values",
                };
                format!(
                    "the states and derivatives at t = {t} are inconsistent, and {why}: equation {equation} \
                     has residual {}. Specify derivatives (dx0), or better guesses for states without a \
                     derivative",
                    Number(*residual)
                )
            }
            ErrorKind::DiscardedAtRestart => match &self.not_finite {
                Some(value) => value.to_string(),
                None => format!("the model cannot be evaluated at its current state at t = {t}"),
            },
            ErrorKind::TooManySteps(n) => format!("the limit of {n} steps was reached at t = {t}"),
            ErrorKind::TooManyEvents(n) => format!("the limit of {n} events was reached at t = {t}"),
            ErrorKind::TooManyRightHandSides(n) => {
                format!("the limit of {n} right-hand side evaluations was reached at t = {t}")
            }
            ErrorKind::TimedOut(limit) => {
                format!("the time limit of {} s was reached at t = {t}", Number(limit.as_secs_f64()))
            }
            ErrorKind::Cancelled => format!("cancelled at t = {t}"),
            ErrorKind::Chattering { events, within, indicator } => format!(
                "chattering at t = {t}: {events} state events within {} (last: event indicator {indicator})",
                Number(*within)
            ),
            ErrorKind::EventsAccumulate { indicator } => format!(
                "chattering at t = {t}: after its event, event indicator {indicator} returns to zero in less \
                 time than a step can resolve (its events accumulate)"
            ),
            ErrorKind::TimeEventLoop(n) => {
                format!(
                    "{n} consecutive time events at t = {t}, each announcing the next one at the same \
                         instant or only slightly later"
                )
            }
            ErrorKind::EventInThePast(next) => format!(
                "the model announced its next time event for {}, which is before t = {t}",
                Number(*next)
            ),
            ErrorKind::Model(error) => format!("at t = {t}: {error}"),
            _ => self.kind.before_the_run().unwrap_or_default(),
        }
    }
}

impl fmt::Display for SimulationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(message) = self.kind.before_the_run() {
            return f.write_str(&message);
        }
        f.write_str(&self.end_of_the_run())?;
        if let (ErrorKind::StepTooSmall { .. }, Some(value)) = (&self.kind, &self.not_finite) {
            write!(f, ": {value}")?;
        }
        if let Some(refusal) = &self.refusal {
            write!(f, ": {refusal}")?;
        }
        if let Some(undetermined) = &self.undetermined {
            write!(f, "; {undetermined}")?;
        }
        if let Some(i) = self.worst_state {
            write!(f, "; largest error in state {i}")?;
        }
        if let Some(e) = self.last_event {
            write!(f, "; last event at {}", Number(e))?;
        }
        Ok(())
    }
}

impl std::error::Error for SimulationError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match &self.kind {
            ErrorKind::Model(e) => Some(e.as_ref()),
            _ => None,
        }
    }
}
