//! The phases of a fit, and what each takes.

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
    /// It is tested how the model's instances can be reused.
    ModelTest,
    /// The start is looked at.
    Preflight,
    /// The search itself.
    Search,
    /// The result is looked at: bounds and parameters without effect, the accuracy of its simulation, what
    /// one more step would gain, and what may not be meant as it was given.
    Checks,
    /// The best point is evaluated again in a fresh process, while the phases after this one last, so that
    /// its time does not count here. That is a [check](ode::Checks).
    FreshProcess,
    /// The standard errors are found: two simulations for each parameter.
    Uncertainty,
}

impl FitPhase {
    /// All in the order of the type, each with its key and what it is called while it lasts.
    const ALL: [(Self, &'static str, &'static str); 6] = [
        (Self::ModelTest, "model_test", "testing the model"),
        (Self::Preflight, "preflight", "looking at the start"),
        (Self::Search, "search", "searching"),
        (Self::Checks, "checks", "checking the result"),
        (Self::FreshProcess, "fresh_process", "comparing with a fresh process"),
        (Self::Uncertainty, "uncertainty", "standard errors"),
    ];

    /// The phase as a key.
    pub fn key(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    /// Name of the phase, for messages while it lasts.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].2
    }
}

/// The phase that a fit is in, to be read from any thread.
#[derive(Debug, Default)]
pub struct CurrentPhase(AtomicU8);

impl CurrentPhase {
    /// The phase; the first before the fit has begun.
    pub fn get(&self) -> FitPhase {
        FitPhase::ALL[usize::from(self.0.load(Ordering::Relaxed)).min(FitPhase::ALL.len() - 1)].0
    }

    pub(crate) fn set(&self, phase: FitPhase) {
        self.0.store(phase as u8, Ordering::Relaxed);
    }
}

/// What a phase of a fit took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PhaseCost {
    /// The phase.
    pub phase: FitPhase,
    /// What it took.
    pub taken: Effort,
}

/// The phases of a fit one after the other, with what they take.
#[derive(Debug)]
pub(crate) struct Phases {
    told: Arc<CurrentPhase>,
    taken: [Effort; FitPhase::ALL.len()],
    /// The phase that lasts, from when on, and what was taken before.
    now: (FitPhase, Instant, Effort),
}

impl Phases {
    /// It is to be told the phase.
    pub(crate) fn new(told: Arc<CurrentPhase>) -> Self {
        let now = (told.get(), Instant::now(), Effort::default());
        Self { told, taken: Default::default(), now }
    }

    /// Ends a phase and begins this one. `stats`: of all simulations of the fit so far.
    pub(crate) fn enter(&mut self, phase: FitPhase, stats: &Stats) {
        let (last, since, before) = self.now;
        let mut own = Effort::of(stats, since.elapsed());
        own.simulations = own.simulations.saturating_sub(before.simulations);
        own.right_hand_sides = own.right_hand_sides.saturating_sub(before.right_hand_sides);
        self.taken[last as usize] += own;
        self.begin(phase, stats);
    }

    /// Begins a phase where what was before counts elsewhere.
    pub(crate) fn begin(&mut self, phase: FitPhase, stats: &Stats) {
        self.now = (phase, Instant::now(), Effort::of(stats, Duration::ZERO));
        // That lasts while others do.
        if phase != FitPhase::FreshProcess {
            self.told.set(phase);
        }
    }

    /// Who is told the phase.
    pub(crate) fn told(&self) -> Arc<CurrentPhase> {
        Arc::clone(&self.told)
    }

    /// Adds what a part of a phase took to another one.
    pub(crate) fn move_part(&mut self, part: Effort, from: FitPhase, to: FitPhase) {
        self.taken[to as usize] += part;
        let whole = &mut self.taken[from as usize];
        whole.simulations -= part.simulations.min(whole.simulations);
        whole.right_hand_sides -= part.right_hand_sides.min(whole.right_hand_sides);
        whole.seconds = Seconds::new((whole.seconds.get() - part.seconds.get()).max(0.0));
    }

    /// Adds what parts of a fit took.
    pub(crate) fn add(&mut self, costs: &[PhaseCost]) {
        costs.iter().for_each(|cost| self.taken[cost.phase as usize] += cost.taken);
    }

    /// The phases that there were. `stats`: as for [`enter`](Self::enter).
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
    fn every_phase_is_read_as_it_was_set() {
        let current = CurrentPhase::default();
        for (phase, key, _) in FitPhase::ALL {
            current.set(phase);
            assert_eq!((current.get(), phase.key()), (phase, key));
            assert_eq!(serde_json::to_value(phase).unwrap(), key);
        }
    }
}
