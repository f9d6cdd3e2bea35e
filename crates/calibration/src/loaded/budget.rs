//! The budget of what surrounds the search of a fit, in simulations.

/// What surrounds a search takes at most this part of its evaluations: less than 0.3 of its right-hand sides
/// where simulations of the result take more of them than others, and with the short tests of how instances
/// are brought back (`benches/whole_fits.md`).
const SHARE: f64 = 0.25;
/// Largest number of simulations. The tests of resets add less than half of one: together less than 4.
const MOST: f64 = 3.5;

/// Something that is simulated besides the search and the standard errors, where the budget allows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extra {
    /// A parameter moved to its bound, or off it, or one that has shown no effect moved.
    StuckParameter,
    /// The result again in a fresh process.
    FreshProcess,
    /// The result with a tenth of the tolerance, or half the step.
    Accuracy,
    /// Shorter steps of least squares from the result.
    ShorterSteps,
}

impl Extra {
    /// Name, as the record of a fit has it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::StuckParameter => "parameters at bounds and without effect",
            Self::FreshProcess => "comparison with a fresh process",
            Self::Accuracy => "simulation of higher accuracy",
            Self::ShorterSteps => "shorter steps from the result",
        }
    }
}

/// Simulations of the result that may be made besides the search: a quarter of its evaluations, and no more
/// than 3.5. What is above it is skipped. Each decision follows from counts of the path alone, so that it is
/// the same for any number of workers, in a process or here, and after a resume.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Budget {
    left: f64,
    skipped: Vec<Extra>,
}

impl Budget {
    /// For what a user asks for: nothing is skipped.
    pub(crate) fn unlimited() -> Self {
        Self { left: f64::INFINITY, skipped: Vec::new() }
    }

    /// True if nothing is skipped.
    pub(crate) fn is_unlimited(&self) -> bool {
        self.left.is_infinite()
    }

    /// After a search of so many evaluations.
    pub(crate) fn after(n_evaluations: usize) -> Self {
        Self { left: (SHARE * n_evaluations as f64).min(MOST), skipped: Vec::new() }
    }

    /// Takes this number of simulations off the budget, if there is room for them.
    pub(crate) fn take(&mut self, simulations: f64) -> bool {
        let has_room = simulations <= self.left;
        self.left -= if has_room { simulations } else { 0.0 };
        has_room
    }

    /// True if something that takes this number of simulations may be made; notes what is skipped.
    pub(crate) fn allows(&mut self, extra: Extra, simulations: f64) -> bool {
        let is_allowed = self.take(simulations);
        if !is_allowed {
            self.skip(extra);
        }
        is_allowed
    }

    /// Number of whole simulations that are left after `reserved` is set aside.
    pub(crate) fn left_beside(&self, reserved: f64) -> usize {
        (self.left - reserved).max(0.0) as usize
    }

    /// Notes that something was skipped.
    pub(crate) fn skip(&mut self, extra: Extra) {
        if !self.skipped.contains(&extra) {
            self.skipped.push(extra);
        }
    }

    /// Adds what another budget of the same fit has skipped.
    pub(crate) fn add_skipped(&mut self, skipped: &[Extra]) {
        skipped.iter().for_each(|extra| self.skip(*extra));
    }

    /// What was skipped.
    pub(crate) fn skipped(&self) -> &[Extra] {
        &self.skipped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_search_leaves_room_for_a_part_of_itself() {
        // A quarter of 8 evaluations are two simulations.
        let mut budget = Budget::after(8);
        assert!(budget.take(1.0) && budget.allows(Extra::StuckParameter, 1.0));
        assert!(!budget.take(1.0) && budget.skipped().is_empty());
        assert!(!budget.allows(Extra::Accuracy, 1.6) && !budget.allows(Extra::Accuracy, 1.6));
        assert_eq!(budget.skipped(), [Extra::Accuracy]);
    }

    #[test]
    fn a_long_search_leaves_room_for_three_and_a_half_simulations() {
        let mut budget = Budget::after(1000);
        assert!(budget.allows(Extra::ShorterSteps, 3.5) && !budget.allows(Extra::Accuracy, 0.1));
        let mut unlimited = Budget::unlimited();
        assert!((0..9).all(|_| unlimited.allows(Extra::ShorterSteps, 2.0)) && unlimited.skipped().is_empty());
    }
}
