//! Check of the model before convergence is reported.
//!
//! Both tests measure the resolution, which may have become small because steps failed, and not because the
//! minimum is near. The model may then be wrong within the resolution, because its points are far away. And
//! even a steep model predicts only a small decrease within a tiny resolution. Therefore, the model first
//! receives near points in all directions (criticality step: Conn, Scheinberg and Vicente 2009, section
//! 10.3). If it then predicts a decrease farther away, the search continues with a larger resolution.

use super::iteration::{POISED, norm};
use super::state::ModelSearch;

/// Maximum distance, in resolutions, of points that determine the slope at the end, and the distance of new
/// points that do.
const CHECKED_WITHIN: f64 = 10.0;
const CHECKED_AT: f64 = 2.0;
/// Maximum number of such points for each parameter. Evaluating one may move the best point away from others.
const CHECKS_PER_PARAMETER: usize = 3;
/// Number of consecutive returns to a larger resolution without a lower cost after which the tests count.
const MOST_RETURNS: usize = 2;
/// Resolution after a return, in units of the length of the step that promises a decrease.
const RESOLUTION: f64 = 0.1;
/// Factor between the lengths of the steps.
const LONGER: f64 = 10.0;

impl ModelSearch {
    /// True if the model did not predict the last two costs to within the limit of the f test, although the
    /// tests passed.
    pub(super) fn is_inaccurate(&self) -> bool {
        let tests = self.tests.filter(|tests| tests.passed);
        tests.is_some_and(|tests| self.last_errors.iter().any(|e| *e > tests.f_limit))
    }

    /// True if the tests passed, the model is accurate, and it hides no slope.
    pub(super) fn has_passed(&self) -> bool {
        self.tests.is_some_and(|tests| tests.passed) && !self.is_inaccurate() && !self.may_be_steep()
    }

    /// After the tests passed: requests a near point, or returns to a larger resolution. Returns false if
    /// neither is necessary.
    pub(super) fn continues_after_check(&mut self) -> bool {
        if !self.has_passed() {
            self.n_checked = 0;
            return false;
        }
        if self.check_near() || self.roughness.is_none() && self.return_to_larger_resolution() {
            return true;
        }
        self.n_checked = 0;
        false
    }

    /// Requests a near point if near points do not determine the slope in all directions. With many
    /// parameters, points are replaced before they are this far away.
    fn check_near(&mut self) -> bool {
        let is_done = self.has_many() || self.n_checked > CHECKS_PER_PARAMETER * self.n();
        if is_done || !self.improve_within(POISED, CHECKED_WITHIN * self.rho, CHECKED_AT * self.rho) {
            return false;
        }
        self.refused = None;
        self.n_checked += 1;
        true
    }

    /// Increases the resolution if the model predicts a decrease above the limit of the f test farther away.
    /// The shortest such step determines the resolution, or after a return without a lower cost the next
    /// longer one. The evidence of kinks is kept.
    fn return_to_larger_resolution(&mut self) -> bool {
        let limit = self.tests.map_or(0.0, |tests| tests.f_limit);
        let f = self.cost(self.base());
        let is_lower = self.f_return.is_none_or(|before| before - f > limit);
        self.n_returns = if is_lower { 0 } else { self.n_returns.saturating_add(1) };
        if self.n_returns >= MOST_RETURNS {
            self.n_returns = 0;
            return false;
        }
        let (before, mut skipped) = (self.delta, self.n_returns);
        while self.delta < self.radius {
            self.delta = (LONGER * self.delta).min(self.radius);
            let s = self.best_step();
            if -self.change(&s) <= limit || norm(&s) <= 2.0 * self.rho {
                continue;
            }
            if skipped == 0 {
                self.f_return = Some(f);
                self.rho = self.rho.max(RESOLUTION * self.delta);
                self.refused = None;
                return true;
            }
            skipped -= 1;
        }
        self.delta = before;
        false
    }
}
