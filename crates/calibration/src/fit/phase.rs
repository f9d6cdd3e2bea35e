//! The phases of a fit.

use std::sync::atomic::{AtomicU8, Ordering};

/// Phase of a fit.
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
    Uncertainty,
}

impl FitPhase {
    const ALL: [Self; 6] =
        [Self::Solver, Self::ModelTest, Self::Preflight, Self::Search, Self::Checks, Self::Uncertainty];

    /// Name of the phase, for messages while it lasts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Solver => "choosing a solver",
            Self::ModelTest => "testing the model",
            Self::Preflight => "looking at the start",
            Self::Search => "searching",
            Self::Checks => "checking the result",
            Self::Uncertainty => "standard errors",
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
}
