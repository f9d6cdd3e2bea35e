//! Cost of a run.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::AddAssign;

/// Operations of linear algebra that take as long as a right-hand side: a call into a compiled model of few
/// states takes some 0.3 us, and some 30 ns more per state.
const OPERATIONS: f64 = 300.0;
const OPERATIONS_PER_STATE: f64 = 30.0;

/// Seconds by the clock. All are equal: results are compared by what was computed, and a clock never shows
/// the same twice.
///
/// ```
/// use ode::Seconds;
/// assert_eq!(Seconds::new(1.0), Seconds::new(2.0));
/// assert_eq!(Seconds::new(1.5).get(), 1.5);
/// ```
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
pub struct Seconds(f64);

impl Seconds {
    /// So many seconds.
    pub fn new(seconds: f64) -> Self {
        Self(seconds)
    }

    /// The number.
    pub fn get(self) -> f64 {
        self.0
    }
}

impl PartialEq for Seconds {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Seconds {}

impl AddAssign for Seconds {
    fn add_assign(&mut self, other: Self) {
        self.0 += other.0;
    }
}

impl fmt::Debug for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Runs that were made besides those asked for, to find out how a model can be brought back to its start, and
/// whether its results depend on earlier runs. All are equal: when they are made depends on the clock and on
/// the number of workers, and no result depends on it.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Checks {
    /// Runs.
    pub runs: u64,
    /// Steps in them.
    pub steps: u64,
    /// Right-hand sides in them.
    #[serde(default)]
    pub right_hand_sides: u64,
    /// Wall-clock time of the runs, with that of making their instances.
    pub seconds: Seconds,
}

impl PartialEq for Checks {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Checks {}

impl AddAssign for Checks {
    fn add_assign(&mut self, other: Self) {
        self.runs += other.runs;
        self.steps += other.steps;
        self.right_hand_sides += other.right_hand_sides;
        self.seconds += other.seconds;
    }
}

/// Counts of one run, and how long it took. They add up over runs. Runs are compared by the counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Stats {
    /// Runs that were begun.
    #[serde(default)]
    pub runs: u64,
    /// Accepted steps.
    pub accepted_steps: u64,
    /// Rejected steps.
    pub rejected_steps: u64,
    /// Evaluations of the right-hand side, those for differences of a Jacobian included.
    pub right_hand_sides: u64,
    /// Jacobians.
    pub jacobians: u64,
    /// Directional derivatives asked from the model.
    pub directional_derivatives: u64,
    /// Decompositions of a matrix of the size of the system; the real and the complex one of Radau5 count as
    /// two.
    pub decompositions: u64,
    /// Iterations of Newton's method.
    pub newton_iterations: u64,
    /// Floating-point operations of decompositions and solutions, as the sizes and patterns of the matrices
    /// let expect.
    pub linear_algebra: u64,
    /// Evaluations of the event indicators.
    pub event_indicators: u64,
    /// Samples taken (each may evaluate the outputs).
    pub samples: u64,
    /// Visits of event mode in which an indicator had crossed.
    pub state_events: u64,
    /// Visits at a time the model had announced.
    pub time_events: u64,
    /// Visits the model asked for after a step.
    pub step_events: u64,
    /// Visits because an input jumped.
    pub input_events: u64,
    /// Visits of event mode in all; one visit may have several causes.
    pub events: u64,
    /// Restarts of the method after an event that changed something.
    pub restarts: u64,
    /// Number of times that state events followed each other while time hardly advanced, where the
    /// [policy](crate::ChatteringPolicy) is to go on.
    pub chattering: u64,
    /// Runs made besides, which no other count has; their time is in `seconds`.
    #[serde(default)]
    pub checks: Checks,
    /// Wall-clock time of the run.
    pub seconds: Seconds,
    /// The part of it that was spent inside of the model: in the calls of the
    /// [`HybridSystem`](crate::HybridSystem). An estimate: of calls that take less than 1 us only some are
    /// timed, see [`Stopwatch`](crate::Stopwatch).
    pub seconds_in_model: Seconds,
}

impl Stats {
    /// The work in equivalents of a right-hand side of a system of `n_states`, by which methods are compared:
    /// right-hand sides, directional derivatives and event indicators count one each, linear algebra counts
    /// one per 300 operations and 30 more for each state. Counted, never measured: the same run is the same
    /// work on every machine.
    pub fn work(&self, n_states: usize) -> f64 {
        let calls = self.right_hand_sides + self.directional_derivatives + self.event_indicators;
        calls as f64 + self.linear_algebra as f64 / (OPERATIONS + OPERATIONS_PER_STATE * n_states as f64)
    }

    /// Adds runs made besides.
    pub fn add_checks(&mut self, checks: Checks) {
        self.seconds += checks.seconds;
        self.checks += checks;
    }

    /// So many runs as ones made besides, with those made besides them.
    pub fn as_checks(&self, runs: u64) -> Checks {
        Checks {
            runs: runs + self.checks.runs,
            steps: self.accepted_steps + self.rejected_steps + self.checks.steps,
            right_hand_sides: self.right_hand_sides + self.checks.right_hand_sides,
            seconds: self.seconds,
        }
    }
}

impl AddAssign for Stats {
    fn add_assign(&mut self, other: Self) {
        self.runs += other.runs;
        self.accepted_steps += other.accepted_steps;
        self.rejected_steps += other.rejected_steps;
        self.right_hand_sides += other.right_hand_sides;
        self.jacobians += other.jacobians;
        self.directional_derivatives += other.directional_derivatives;
        self.decompositions += other.decompositions;
        self.newton_iterations += other.newton_iterations;
        self.linear_algebra += other.linear_algebra;
        self.event_indicators += other.event_indicators;
        self.samples += other.samples;
        self.state_events += other.state_events;
        self.time_events += other.time_events;
        self.step_events += other.step_events;
        self.input_events += other.input_events;
        self.events += other.events;
        self.restarts += other.restarts;
        self.chattering += other.chattering;
        self.checks += other.checks;
        self.seconds += other.seconds;
        self.seconds_in_model += other.seconds_in_model;
    }
}
