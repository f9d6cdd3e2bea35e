//! Phases of a fit and their cost.

use crate::loaded::effort::Effort;
use ode::{Seconds, Stats};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

/// Phase of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FitPhase {
    /// Tests how the instances of the model can be reused.
    ModelTest,
    /// Runs the preflight at the start values.
    Preflight,
    /// Searches for the best point.
    Search,
    /// Checks the result. Looks for parameters at a bound or without effect, and repeats the check of the
    /// problem. Also estimates the accuracy of the simulation and the gain of one more step.
    Checks,
    /// Evaluates the best point again in a fresh process. This phase runs in parallel with the phases after
    /// it, so its time is not counted here. The evaluation is a [check](ode::Checks).
    FreshProcess,
    /// Estimates the standard errors, with two simulations for each parameter.
    Uncertainty,
}

impl FitPhase {
    /// All phases in the order of their definition, each with its key and the name to show while it is
    /// active.
    const ALL: [(Self, &'static str, &'static str); 6] = [
        (Self::ModelTest, "model_test", "testing the model"),
        (Self::Preflight, "preflight", "checking the start"),
        (Self::Search, "search", "searching"),
        (Self::Checks, "checks", "checking the result"),
        (Self::FreshProcess, "fresh_process", "comparing with a fresh process"),
        (Self::Uncertainty, "uncertainty", "standard errors"),
    ];

    /// Returns the key of the phase.
    pub fn key(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    /// Returns the name of the phase, for messages while it is active.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].2
    }
}

/// Current phase of a fit, readable from any thread.
#[derive(Debug, Default)]
pub struct CurrentPhase(AtomicU8);

impl CurrentPhase {
    /// Returns the current phase, or the first phase if the fit has not begun.
    pub fn get(&self) -> FitPhase {
        FitPhase::ALL[usize::from(self.0.load(Ordering::Relaxed)).min(FitPhase::ALL.len() - 1)].0
    }

    pub(crate) fn set(&self, phase: FitPhase) {
        self.0.store(phase as u8, Ordering::Relaxed);
    }
}

/// Cost of one phase of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PhaseCost {
    /// Phase of the fit.
    pub phase: FitPhase,
    /// Simulations and time of the phase.
    pub taken: Effort,
}

/// Phases of a fit in order, with their cost.
#[derive(Debug)]
pub(crate) struct Phases {
    reported: Arc<CurrentPhase>,
    taken: [Effort; FitPhase::ALL.len()],
    /// Active phase, the time at which it began, and the effort before it.
    now: (FitPhase, Instant, Effort),
}

impl Phases {
    /// Creates the record of the phases. `reported` is updated when a phase begins.
    pub(crate) fn new(reported: Arc<CurrentPhase>) -> Self {
        let now = (reported.get(), Instant::now(), Effort::default());
        Self { reported, taken: Default::default(), now }
    }

    /// Ends a phase and begins this one. `stats` counts all simulations of the fit so far.
    pub(crate) fn enter(&mut self, phase: FitPhase, stats: &Stats) {
        let (last, since, before) = self.now;
        let mut effort = Effort::of(stats, since.elapsed());
        effort.simulations = effort.simulations.saturating_sub(before.simulations);
        effort.right_hand_sides = effort.right_hand_sides.saturating_sub(before.right_hand_sides);
        self.taken[last as usize] += effort;
        self.begin(phase, stats);
    }

    /// Begins a phase without counting the previous effort, which is counted elsewhere.
    pub(crate) fn begin(&mut self, phase: FitPhase, stats: &Stats) {
        self.now = (phase, Instant::now(), Effort::of(stats, Duration::ZERO));
        // This phase runs in parallel with the phases after it.
        if phase != FitPhase::FreshProcess {
            self.reported.set(phase);
        }
    }

    /// Returns the shared record of the current phase.
    pub(crate) fn reported(&self) -> Arc<CurrentPhase> {
        Arc::clone(&self.reported)
    }

    /// Moves part of the cost of one phase to another phase.
    pub(crate) fn move_part(&mut self, part: Effort, from: FitPhase, to: FitPhase) {
        self.taken[to as usize] += part;
        let whole = &mut self.taken[from as usize];
        whole.simulations -= part.simulations.min(whole.simulations);
        whole.right_hand_sides -= part.right_hand_sides.min(whole.right_hand_sides);
        whole.seconds = Seconds::new((whole.seconds.get() - part.seconds.get()).max(0.0));
    }

    /// Adds the cost of parts of a fit.
    pub(crate) fn add(&mut self, costs: &[PhaseCost]) {
        costs.iter().for_each(|cost| self.taken[cost.phase as usize] += cost.taken);
    }

    /// Returns the cost of all phases that occurred. `stats` is as for [`enter`](Self::enter).
    pub(crate) fn costs(&mut self, stats: &Stats) -> Vec<PhaseCost> {
        self.enter(self.now.0, stats);
        let all = FitPhase::ALL.iter().zip(self.taken);
        let was = |taken: &Effort| taken.simulations > 0 || taken.seconds.get() > 0.0;
        all.filter(|(_, taken)| was(taken))
            .map(|((phase, ..), taken)| PhaseCost { phase: *phase, taken })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn current_phase_returns_every_phase_that_was_set() {
        let current = CurrentPhase::default();
        for (phase, key, _) in FitPhase::ALL {
            current.set(phase);
            assert_eq!((current.get(), phase.key()), (phase, key));
            assert_eq!(serde_json::to_value(phase).unwrap(), key);
        }
    }
}
