//! Simplified Newton iterations and their tests for convergence and failure (Hairer and Wanner II, section
//! IV.8).
//!
//! BDF uses the test of Radau5. The test of VODE and CVODE takes the larger of the last quotient and 0.3
//! times the previous rate. It compares the product of this rate and the increment with the share 0.1 of the
//! error test. That test was compared over the 52 stiff rows of `tests/all/vectors.rs` (rtol 1e-4 to 1e-10).
//! BDF then needs 10 % more right-hand sides and 29 % more decompositions, and reaches 0.2 fewer correct
//! digits on average.

use crate::stepper::Equations;
use crate::system::{CallError, CallResult};

const U: f64 = f64::EPSILON / 2.0;
/// Rate of convergence before two increments have been computed.
pub(super) const INITIAL_RATE: f64 = 1e-3;

/// The equations of a step at the current iterate.
pub(super) trait Iteration {
    /// Evaluates the residual at the iterate and solves for the increment with the decomposed matrix. Returns
    /// the norm of the increment.
    fn solve(&mut self, equations: &mut Equations<'_>, is_first: bool) -> CallResult<f64>;

    /// Adds the increment to the iterate.
    fn advance(&mut self);
}

/// Result of the iterations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Newton {
    Converged,
    /// Fraction by which to multiply the step size, with a fresh Jacobian.
    Failed(f64),
}

/// Observed convergence of the iterations.
#[derive(Debug)]
pub(super) struct Convergence {
    /// Maximum number of iterations per step plus one (radau5's NIT).
    limit: u32,
    count: u32,
    rate: f64,
    /// Error after an increment divided by that increment: theta / (1 - theta), radau5's FACCON.
    error_per_increment: f64,
}

impl Convergence {
    pub(super) fn new(limit: u32) -> Self {
        Self { limit, count: 0, rate: INITIAL_RATE, error_per_increment: 1.0 }
    }

    /// Discards the observed convergence, because the equations or their matrix have changed.
    pub(super) fn forget(&mut self) {
        (self.rate, self.error_per_increment) = (INITIAL_RATE, 1.0);
    }

    /// Number of iterations of the last step.
    pub(super) fn count(&self) -> u32 {
        self.count
    }

    /// Rate of convergence in the last step.
    pub(super) fn rate(&self) -> f64 {
        self.rate
    }

    /// Iterates until the error is below the tolerance. `change` is the rate of convergence that results from
    /// the different coefficients of matrix and equations. At least `least` iterations are made.
    pub(super) fn iterate(
        &mut self,
        equations: &mut Equations<'_>,
        iteration: &mut impl Iteration,
        tolerance: f64,
        change: f64,
        least: u32,
    ) -> CallResult<Newton> {
        self.error_per_increment = self.error_per_increment.max(U).powf(0.8);
        self.rate = INITIAL_RATE;
        let (mut last_norm, mut last_quotient) = (0.0, 0.0);
        let mut error_per_increment = self.error_per_increment.max(change / (1.0 - change));
        self.count = self.limit;
        for count in 1..self.limit {
            equations.stats.newton_iterations += 1;
            let norm = iteration.solve(equations, count == 1)?;
            if !norm.is_finite() {
                return Err(CallError::Discard);
            }
            if count > 1 {
                let quotient: f64 = norm / last_norm;
                self.rate = if count == 2 { quotient } else { (quotient * last_quotient).sqrt() };
                last_quotient = quotient;
                if self.rate >= 0.99 {
                    return Ok(Newton::Failed(0.5));
                }
                error_per_increment = self.rate / (1.0 - self.rate);
                self.error_per_increment = error_per_increment;
                let more = (self.limit - 1 - count) as i32;
                let predicted = error_per_increment * norm * self.rate.powi(more) / tolerance;
                if predicted > 1.0 {
                    return Ok(Newton::Failed(0.8 * predicted.min(20.0).powf(-1.0 / f64::from(4 + more))));
                }
            }
            last_norm = norm.max(U);
            iteration.advance();
            if count >= least && error_per_increment * norm <= tolerance {
                self.count = count;
                return Ok(Newton::Converged);
            }
        }
        Ok(Newton::Failed(0.5))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error_norm::ErrorWeights;
    use crate::stats::Stats;
    use crate::system::{EventOutcome, HybridSystem};

    struct Nothing;

    impl HybridSystem for Nothing {
        fn n_states(&self) -> usize {
            0
        }
        fn start(&mut self, _: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
            Ok(EventOutcome::default())
        }
        fn derivatives(&mut self, _: f64, _: &[f64], _: &mut [f64]) -> CallResult<()> {
            Ok(())
        }
    }

    /// Increments that start at 1 and decrease by a constant factor.
    struct Geometric {
        norm: f64,
        rate: f64,
    }

    impl Iteration for Geometric {
        fn solve(&mut self, _: &mut Equations<'_>, _: bool) -> CallResult<f64> {
            Ok(self.norm)
        }
        fn advance(&mut self) {
            self.norm *= self.rate;
        }
    }

    fn iterate(convergence: &mut Convergence, rate: f64, tolerance: f64, change: f64) -> Newton {
        let (weights, mut stats) = (ErrorWeights::default(), Stats::default());
        let mut equations = Equations { system: &mut Nothing, weights: &weights, stats: &mut stats };
        let mut iteration = Geometric { norm: 1.0, rate };
        convergence.iterate(&mut equations, &mut iteration, tolerance, change, 1).unwrap()
    }

    /// Computed by hand: after the second increment, 1/2, the error is 1/2. After four more iterations, it
    /// would be 1/32.
    #[test]
    fn iterate_predicts_failure_from_rate() {
        let mut convergence = Convergence::new(7);
        assert_eq!(iterate(&mut convergence, 0.5, 1.0 / 31.0, 0.0), Newton::Converged);
        assert_eq!((convergence.count(), convergence.rate()), (6, 0.5));
        let share = 0.8 * (33f64 / 32.0).powf(-0.125);
        let Newton::Failed(found) = iterate(&mut convergence, 0.5, 1.0 / 33.0, 0.0) else { panic!() };
        assert!((found - share).abs() < 1e-15);
        assert_eq!(iterate(&mut convergence, 1.5, 1e-3, 0.0), Newton::Failed(0.5));
    }

    /// The first iteration relies on a fast convergence of the previous step, unless the coefficient of the
    /// matrix has changed.
    #[test]
    fn previous_rate_is_ignored_when_coefficient_changes() {
        for (change, count) in [(0.0, 1), (0.1, 2)] {
            let mut convergence = Convergence::new(4);
            assert_eq!(iterate(&mut convergence, 1e-6, 1e-3, 0.0), Newton::Converged);
            assert_eq!(iterate(&mut convergence, 1e-6, 1e-3, change), Newton::Converged);
            assert_eq!(convergence.count(), count);
        }
    }
}
