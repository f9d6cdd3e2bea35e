//! Budget of the simulations before and after the search of a fit.

/// Maximum share of additional simulations in the evaluations of a search. The fraction of right-hand sides
/// is below 0.3 (`benches/whole_fits.md`), because simulations near the result may need more right-hand sides
/// than others.
const SHARE: f64 = 0.25;
/// Maximum number of additional simulations.
const MOST: f64 = 3.5;

/// A simulation in addition to the search and the standard errors, if the budget allows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extra {
    /// Test of a parameter: moved to its bound or away from it, or moved because it has no visible effect.
    StuckParameter,
    /// The result, simulated again in a fresh process.
    FreshProcess,
    /// The result, simulated with a tenth of the tolerance or half the step.
    Accuracy,
    /// Shorter least-squares steps from the result.
    ShorterSteps,
}

impl Extra {
    /// Returns the name used in the record of a fit.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::StuckParameter => "parameters at bounds and without effect",
            Self::FreshProcess => "comparison with a fresh process",
            Self::Accuracy => "simulation of higher accuracy",
            Self::ShorterSteps => "shorter steps from the result",
        }
    }
}

/// Number of simulations of the result that are allowed in addition to the search: a quarter of its
/// evaluations, at most 3.5. Simulations beyond the budget are skipped. Decisions depend only on counts along
/// the search path. They are therefore the same for any number of workers, with or without process isolation,
/// and after a resume.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Budget {
    left: f64,
    skipped: Vec<Extra>,
    /// Simulations that are never skipped.
    required: Option<Extra>,
}

impl Budget {
    /// Creates a budget that skips nothing, for explicit requests of the user.
    pub(crate) fn unlimited() -> Self {
        Self { left: f64::INFINITY, skipped: Vec::new(), required: None }
    }

    /// True if nothing is skipped.
    pub(crate) fn is_unlimited(&self) -> bool {
        self.left.is_infinite()
    }

    /// Creates the budget after a search with this number of evaluations.
    pub(crate) fn after(n_evaluations: usize) -> Self {
        Self { left: (SHARE * n_evaluations as f64).min(MOST), skipped: Vec::new(), required: None }
    }

    /// Returns the budget with simulations that are never skipped, because they decide if a fit is a success.
    pub(crate) fn requiring(self, extra: Extra) -> Self {
        Self { required: Some(extra), ..self }
    }

    /// Deducts this number of simulations from the budget if enough are left; returns true on success.
    pub(crate) fn take(&mut self, simulations: f64) -> bool {
        let fits = simulations <= self.left;
        self.left -= if fits { simulations } else { 0.0 };
        fits
    }

    /// Deducts this number of simulations if enough are left; otherwise records the skipped item. Returns
    /// true on success.
    pub(crate) fn allows(&mut self, extra: Extra, simulations: f64) -> bool {
        let is_allowed = self.take(simulations) || self.required == Some(extra);
        if !is_allowed {
            self.skip(extra);
        }
        is_allowed
    }

    /// Returns the number of whole simulations that are left after `reserved` is set aside.
    pub(crate) fn left_beside(&self, reserved: f64) -> usize {
        (self.left - reserved).max(0.0) as usize
    }

    /// Records that something was skipped.
    pub(crate) fn skip(&mut self, extra: Extra) {
        if !self.skipped.contains(&extra) {
            self.skipped.push(extra);
        }
    }

    /// Adds the skipped items of another budget of the same fit.
    pub(crate) fn add_skipped(&mut self, skipped: &[Extra]) {
        skipped.iter().for_each(|extra| self.skip(*extra));
    }

    /// Returns the skipped items.
    pub(crate) fn skipped(&self) -> &[Extra] {
        &self.skipped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budget_is_a_quarter_of_a_short_search() {
        // A quarter of 8 evaluations is two simulations.
        let mut budget = Budget::after(8);
        assert!(budget.take(1.0) && budget.allows(Extra::StuckParameter, 1.0));
        assert!(!budget.take(1.0) && budget.skipped().is_empty());
        assert!(!budget.allows(Extra::Accuracy, 1.6) && !budget.allows(Extra::Accuracy, 1.6));
        assert_eq!(budget.skipped(), [Extra::Accuracy]);
    }

    #[test]
    fn required_simulations_are_never_skipped() {
        let mut budget = Budget::after(0).requiring(Extra::ShorterSteps);
        assert!(budget.allows(Extra::ShorterSteps, 2.0) && !budget.allows(Extra::Accuracy, 1.0));
        assert_eq!(budget.skipped(), [Extra::Accuracy]);
    }

    #[test]
    fn budget_is_three_and_a_half_simulations_after_a_long_search() {
        let mut budget = Budget::after(1000);
        assert!(budget.allows(Extra::ShorterSteps, 3.5) && !budget.allows(Extra::Accuracy, 0.1));
        let mut unlimited = Budget::unlimited();
        assert!((0..9).all(|_| unlimited.allows(Extra::ShorterSteps, 2.0)) && unlimited.skipped().is_empty());
    }
}
