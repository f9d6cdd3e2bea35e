//! What a run cost.

use std::ops::AddAssign;

/// Counts of one run. They add up over runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stats {
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
    /// Decompositions of a matrix of the size of the system; the real and the complex one of Radau5 count as two.
    pub decompositions: u64,
    /// Iterations of Newton's method.
    pub newton_iterations: u64,
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
    /// How often state events were found to follow each other while time hardly advanced, where the
    /// [policy](crate::ChatteringPolicy) is to go on.
    pub chattering: u64,
}

impl AddAssign for Stats {
    fn add_assign(&mut self, other: Self) {
        self.accepted_steps += other.accepted_steps;
        self.rejected_steps += other.rejected_steps;
        self.right_hand_sides += other.right_hand_sides;
        self.jacobians += other.jacobians;
        self.directional_derivatives += other.directional_derivatives;
        self.decompositions += other.decompositions;
        self.newton_iterations += other.newton_iterations;
        self.event_indicators += other.event_indicators;
        self.samples += other.samples;
        self.state_events += other.state_events;
        self.time_events += other.time_events;
        self.step_events += other.step_events;
        self.input_events += other.input_events;
        self.events += other.events;
        self.restarts += other.restarts;
        self.chattering += other.chattering;
    }
}
