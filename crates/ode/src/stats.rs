//! Cost of a run.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::AddAssign;

/// Linear algebra operations that take as long as a right-hand side. A call into a compiled model of few
/// states takes about 0.3 us, plus about 30 ns per state.
const OPERATIONS: f64 = 300.0;
const OPERATIONS_PER_STATE: f64 = 30.0;

/// Wall-clock time in seconds. All values compare equal, because results are compared by their numbers and
/// measured times differ between runs.
///
/// ```
/// use ode::Seconds;
/// assert_eq!(Seconds::new(1.0), Seconds::new(2.0));
/// assert_eq!(Seconds::new(1.5).get(), 1.5);
/// ```
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
pub struct Seconds(f64);

impl Seconds {
    /// Creates a value from a number of seconds.
    pub fn new(seconds: f64) -> Self {
        Self(seconds)
    }

    /// Number of seconds.
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

/// Additional runs that determine how a model can be reset to its start and whether its results depend on
/// earlier runs. All values compare equal: the number of such runs depends on timing and on the number of
/// workers, but no result depends on it.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Checks {
    /// Number of runs.
    pub runs: u64,
    /// Number of steps in these runs.
    pub steps: u64,
    /// Number of right-hand sides in these runs.
    #[serde(default)]
    pub right_hand_sides: u64,
    /// Wall-clock time of the runs, including the creation of their instances.
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

/// Counts and times of a run, or sums over several runs. Comparison uses the counts only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Stats {
    /// Number of started runs.
    #[serde(default)]
    pub runs: u64,
    /// Accepted steps.
    pub accepted_steps: u64,
    /// Rejected steps.
    pub rejected_steps: u64,
    /// Evaluations of the right-hand side, including those for finite-difference Jacobians.
    pub right_hand_sides: u64,
    /// Evaluations of the Jacobian.
    pub jacobians: u64,
    /// Directional derivatives computed by the model.
    pub directional_derivatives: u64,
    /// Decompositions of a matrix of the size of the system. The real and the complex decomposition of Radau5
    /// count as two.
    pub decompositions: u64,
    /// Iterations of Newton's method.
    pub newton_iterations: u64,
    /// Floating-point operations of decompositions and solutions, estimated from the sizes and patterns of
    /// the matrices.
    pub linear_algebra: u64,
    /// Evaluations of the event indicators.
    pub event_indicators: u64,
    /// Samples recorded. Each may evaluate the outputs.
    pub samples: u64,
    /// Visits of event mode in which an indicator had crossed.
    pub state_events: u64,
    /// Visits of event mode at a time that the model had announced.
    pub time_events: u64,
    /// Visits of event mode that the model requested after a step.
    pub step_events: u64,
    /// Visits of event mode because an input jumped.
    pub input_events: u64,
    /// All visits of event mode. One visit may have several causes.
    pub events: u64,
    /// Restarts of the method after an event that changed something.
    pub restarts: u64,
    /// Number of times that state events followed each other while time hardly advanced, if the
    /// [policy](crate::ChatteringPolicy) is to continue.
    pub chattering: u64,
    /// Additional runs, which no other count includes. Their time is included in `seconds`.
    #[serde(default)]
    pub checks: Checks,
    /// Wall-clock time of the run.
    pub seconds: Seconds,
    /// Part of the wall-clock time spent in calls of the [`HybridSystem`](crate::HybridSystem). This is an
    /// estimate: only some of the calls shorter than 1 us are timed, see [`Stopwatch`](crate::Stopwatch).
    pub seconds_in_model: Seconds,
}

impl Stats {
    /// Returns the work in equivalents of a right-hand side of a system of `n_states`. Methods are compared
    /// by this number. Right-hand sides, directional derivatives and event indicators count one each. Linear
    /// algebra counts one per 300 operations, plus 30 operations per state. The work is counted, not
    /// measured, so a run has the same work on every machine.
    pub fn work(&self, n_states: usize) -> f64 {
        let calls = self.right_hand_sides + self.directional_derivatives + self.event_indicators;
        calls as f64 + self.linear_algebra as f64 / (OPERATIONS + OPERATIONS_PER_STATE * n_states as f64)
    }

    /// Adds additional runs to the counts.
    pub fn add_checks(&mut self, checks: Checks) {
        self.seconds += checks.seconds;
        self.checks += checks;
    }

    /// Returns these counts as additional runs. `runs` is the number of runs; additional runs already
    /// included are added.
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
