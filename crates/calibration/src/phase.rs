//! The phases of a fit: what it does just now, and the time that is left for all of them.

use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

/// What a fit does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FitPhase {
    /// The integration methods are compared.
    Solver,
    /// It is tested how the model's instances can be reused.
    ModelTest,
    /// The start is looked at.
    Preflight,
    /// The search itself.
    Search,
    /// Bounds and parameters without effect are looked at, and what may not be meant as it was given.
    Checks,
    /// The standard errors are found.
    Worth,
}

impl FitPhase {
    const ALL: [Self; 6] =
        [Self::Solver, Self::ModelTest, Self::Preflight, Self::Search, Self::Checks, Self::Worth];

    /// What is said of it while it lasts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Solver => "choosing a solver",
            Self::ModelTest => "testing the model",
            Self::Preflight => "looking at the start",
            Self::Search => "searching",
            Self::Checks => "checking the result",
            Self::Worth => "standard errors",
        }
    }
}

/// The phase that a fit is in, to be read from any thread.
#[derive(Debug, Default)]
pub struct CurrentPhase(AtomicU8);

impl CurrentPhase {
    /// The phase; the first before the fit has begun.
    pub fn get(&self) -> FitPhase {
        FitPhase::ALL[usize::from(self.0.load(Ordering::Relaxed)).min(FitPhase::ALL.len() - 1)]
    }

    pub(crate) fn set(&self, phase: FitPhase) {
        self.0.store(phase as u8, Ordering::Relaxed);
    }
}

/// The wall-clock time of a fit: one limit for all of its phases, from its start on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deadline {
    began: Instant,
    end: Option<Instant>,
}

impl Deadline {
    /// From now on; a limit beyond what the clock can count is none.
    pub(crate) fn new(limit: Option<Duration>) -> Self {
        let began = Instant::now();
        Self { began, end: limit.and_then(|limit| began.checked_add(limit)) }
    }

    /// Whether the time is up.
    pub(crate) fn is_over(&self) -> bool {
        self.end.is_some_and(|end| Instant::now() >= end)
    }

    /// What is left; `None`: no limit.
    pub(crate) fn left(&self) -> Option<Duration> {
        self.end.map(|end| end.saturating_duration_since(Instant::now()))
    }

    /// The time since the start.
    pub(crate) fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_phase_is_read_as_it_was_set() {
        let current = CurrentPhase::default();
        for phase in FitPhase::ALL {
            current.set(phase);
            assert_eq!(current.get(), phase);
        }
    }

    #[test]
    fn a_limit_ends_and_none_never_does() {
        let none = Deadline::new(None);
        assert!(!none.is_over() && none.left().is_none());
        assert!(Deadline::new(Some(Duration::MAX)).left().is_none());
        let over = Deadline::new(Some(Duration::ZERO));
        assert!(over.is_over() && over.left() == Some(Duration::ZERO));
    }
}
