//! Limits of a run, and the tolerance tests that all methods share.

use crate::error::Error;
use crate::values::choices::{StopRule, ToleranceMeasure};
use base::Number;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;

/// Limits that end a run independently of the method; `None` means no limit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Limits {
    /// Evaluations of the path of the method, which are the evaluations of a run with one point at a time.
    pub max_evaluations: Option<usize>,
    /// Iterations of the method.
    pub max_iterations: Option<usize>,
    /// Wall-clock time. No evaluation starts after it.
    pub max_time: Option<Duration>,
    /// Cost at or below which an evaluation of the path ends the run. Later points evaluated together with
    /// it count as made speculatively.
    pub target: Option<f64>,
    /// Fraction of failed evaluations above which the run ends, from 0 to 1. Checked after at least 20
    /// evaluations.
    #[serde(default)]
    pub max_failed: Option<f64>,
}

impl Limits {
    /// Sets evaluations and iterations if no limit except the target and the failed fraction is set.
    pub(crate) fn fill(&mut self, evaluations: Option<usize>, iterations: Option<usize>) {
        if (self.max_evaluations, self.max_iterations, self.max_time) == (None, None, None) {
            (self.max_evaluations, self.max_iterations) = (evaluations, iterations);
        }
    }

    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.max_evaluations == Some(0) {
            return Err(Error::Option { name: "max_evaluations", value: 0.0, range: "at least 1" });
        }
        if let Some(value) = self.max_failed.filter(|share| !(0.0..=1.0).contains(share)) {
            return Err(Error::Option { name: "max_failed", value, range: "between 0 and 1" });
        }
        match self.target {
            Some(value) if value.is_nan() => Err(Error::Option { name: "target", value, range: "a number" }),
            _ => Ok(()),
        }
    }
}

/// Relative cost that counts as zero, see [`Tolerances`]. The reference is the first costs. The value is the
/// square root of the machine precision.
const ZERO_COST: f64 = 1.490_116_119_384_765_6e-8;

/// Tolerances of the two tests that end a run.
///
/// - x test: `max |x_i - x_best,i| <= x_tol * size_i` over all vertices and parameters. A logarithmic
///   parameter is compared by its logarithm. With [`ToleranceMeasure::Absolute`]: `<= x_tol` in the user's
///   units.
/// - f test: `f_worst - f_best <= f_tol * |f_best|`. With [`ToleranceMeasure::Absolute`]: `<= f_tol`. The
///   test never passes while a vertex has failed.
///
/// If the cost goes to zero, the spread goes to zero with it, and a relative f test would never pass.
/// Therefore |f_best| counts as at least `1.5e-8 * f_0`, where 1.5e-8 is the square root of the machine
/// precision. `f_0` is the smallest nonzero |f| of the initial vertices; for a population, it is the upper
/// median.
///
/// Near a minimum, the cost is quadratic. If x is known to 1e-6, a cost of zero is known to 1e-12 of `f_0`.
/// The default f test corresponds to 1.5e-14 of `f_0`, so it requires two more digits, not ten.
///
/// A run ends only if the tests pass after a complete iteration. Therefore an initial simplex never passes,
/// and neither test passes while a vertex has failed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tolerances {
    /// Tolerance of the x test; default 1e-6.
    pub x_tol: f64,
    /// Tolerance of the f test; default 1e-6.
    pub f_tol: f64,
    /// Measure of both tolerances; default [`ToleranceMeasure::Relative`].
    pub measure: ToleranceMeasure,
    /// Tests that must pass; default [`StopRule::All`].
    pub stop: StopRule,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self { x_tol: 1e-6, f_tol: 1e-6, measure: ToleranceMeasure::Relative, stop: StopRule::All }
    }
}

impl Tolerances {
    pub(crate) fn check(&self) -> Result<(), Error> {
        for (name, value) in [("x_tol", self.x_tol), ("f_tol", self.f_tol)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::Option { name, value, range: "finite and not negative" });
            }
        }
        Ok(())
    }

    /// Applies both tests. `f_spread` is `None` while a vertex has failed. See [`Tolerances`] for `f_0`.
    pub(crate) fn judge(&self, x_size: f64, f_spread: Option<f64>, f_best: f64, f_0: f64) -> ToleranceTests {
        let f_limit = match self.measure {
            ToleranceMeasure::Absolute => self.f_tol,
            ToleranceMeasure::Relative => self.f_tol * f_best.abs().max(ZERO_COST * f_0),
        };
        let x_passed = x_size <= self.x_tol;
        let f_passed = f_spread.is_some_and(|s| s <= f_limit);
        let passed = match self.stop {
            // Without a spread, the x test alone must not end a run: too few points may have a cost.
            StopRule::Any => f_spread.is_some() && (x_passed || f_passed),
            StopRule::All => x_passed && f_passed,
        };
        ToleranceTests {
            extent: TestedSet::Simplex,
            x_size,
            f_spread,
            f_limit,
            f_best,
            is_of_squares: false,
            x_passed,
            f_passed,
            passed,
            tolerances: *self,
        }
    }
}

/// Returns the typical size of the initial costs: the upper median of their absolute values.
pub(crate) fn typical(costs: &[Option<f64>]) -> f64 {
    let mut costs: Vec<f64> = costs.iter().flatten().map(|cost| cost.abs()).collect();
    costs.sort_by(f64::total_cmp);
    costs.get(costs.len() / 2).copied().unwrap_or(0.0)
}

/// Set of points, or region, whose size and spread the tests measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum TestedSet {
    /// A simplex.
    #[default]
    Simplex,
    /// A population.
    Population,
    /// The best eighth of a population.
    BestEighth,
    /// The members of a population with the integers of the best member.
    SameIntegers,
    /// The best points of all generations, as many as an eighth of the population.
    BestSeen,
    /// The trust region of a model, or the step to the model's minimum plus its error if that is smaller. The
    /// spread is the decrease that the model predicts.
    Model,
    /// The frame of a poll.
    Frame,
    /// The points with the same residuals as the best point.
    Plateau,
}

impl TestedSet {
    fn name(self) -> &'static str {
        match self {
            Self::Simplex => "simplex",
            Self::Population => "population",
            Self::BestEighth => "best eighth of the population:",
            Self::SameIntegers => "members with the best integers:",
            Self::BestSeen => "best points seen:",
            Self::Model => "distance to the model's minimum:",
            Self::Frame => "frame",
            Self::Plateau => "region of equal residuals:",
        }
    }
}

/// The last values of the tolerance tests.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ToleranceTests {
    /// Set of points, or region, that the tests measure.
    pub extent: TestedSet,
    /// Size of the simplex or population as measured by the x test.
    pub x_size: f64,
    /// Largest minus smallest cost; `None` while a vertex has failed.
    pub f_spread: Option<f64>,
    /// Limit of the spread in the f test.
    pub f_limit: f64,
    /// Best cost.
    pub f_best: f64,
    /// True if these costs are sums of squares of residuals, and the cost of the objective is another
    /// function of them.
    #[serde(default)]
    pub is_of_squares: bool,
    /// True if the x test passes.
    pub x_passed: bool,
    /// True if the f test passes.
    pub f_passed: bool,
    /// True if the tests end the run: either one or both, according to [`Tolerances::stop`].
    pub passed: bool,
    /// Tolerances of the tests.
    pub tolerances: Tolerances,
}

impl fmt::Display for ToleranceTests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Tolerances { x_tol, f_tol, measure, .. } = self.tolerances;
        let relation = |passed| if passed { "<=" } else { ">" };
        let verb = |passed| if passed { "passed" } else { "not passed" };
        let unit = match measure {
            ToleranceMeasure::Relative => " (in units of the parameter sizes)",
            ToleranceMeasure::Absolute => "",
        };
        let x = relation(self.x_passed);
        write!(
            f,
            "x test {}: {}{} {:.4} {x} x_tol {}{unit}",
            verb(self.x_passed),
            self.extent.name(),
            if self.extent == TestedSet::Model { "" } else { " size" },
            Number(self.x_size),
            Number(x_tol)
        )?;
        let spread_name = if self.extent == TestedSet::Model { "predicted decrease" } else { "spread" };
        match self.f_spread {
            None => write!(f, "; f test not passed: a vertex has failed"),
            Some(spread) => {
                let r = relation(self.f_passed);
                write!(
                    f,
                    "; f test {}: {spread_name} {:.4} {r} {:.4}",
                    verb(self.f_passed),
                    Number(spread),
                    Number(self.f_limit)
                )?;
                match measure {
                    ToleranceMeasure::Relative if self.f_limit > f_tol * self.f_best.abs() => {
                        let zero = Number(ZERO_COST);
                        write!(f, " (f_tol {} of {zero:.2} times the initial cost)", Number(f_tol))
                    }
                    ToleranceMeasure::Relative => {
                        let whole = if self.is_of_squares { "the sum of squares" } else { "f_best" };
                        write!(f, " (f_tol {} of {whole} {:.7})", Number(f_tol), Number(self.f_best))
                    }
                    ToleranceMeasure::Absolute => write!(f, " (f_tol)"),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_never_pass_with_nan() {
        let tolerances = Tolerances { stop: StopRule::Any, ..Tolerances::default() };
        for (x, spread) in [(f64::NAN, Some(f64::NAN)), (f64::INFINITY, Some(f64::INFINITY)), (1.0, None)] {
            assert!(!tolerances.judge(x, spread, 1.0, 1.0).passed);
        }
    }

    #[test]
    fn f_test_passes_at_zero_cost() {
        let tolerances = Tolerances::default();
        assert!(tolerances.judge(0.0, Some(1e-14), 0.0, 1.0).passed);
        assert!(!tolerances.judge(0.0, Some(1e-13), 0.0, 1.0).passed);
        // The offset matters as long as it exceeds 1.5e-8 of the first costs.
        assert_eq!(tolerances.judge(0.0, Some(1e-13), 1.0, 1e7).f_limit, 1e-6);
    }

    #[test]
    fn stop_rule_requires_either_or_both_tests() {
        let any =
            Tolerances { stop: StopRule::Any, measure: ToleranceMeasure::Absolute, ..Tolerances::default() };
        let all = Tolerances { stop: StopRule::All, ..any };
        for (x, f, either, both) in
            [(1e-7, 1.0, true, false), (1.0, 1e-7, true, false), (1e-7, 1e-7, true, true)]
        {
            assert_eq!(any.judge(x, Some(f), 5.0, 5.0).passed, either);
            assert_eq!(all.judge(x, Some(f), 5.0, 5.0).passed, both);
        }
        assert!(
            any.judge(1e-7, Some(1.0), 0.0, 1.0).to_string().starts_with("x test passed: simplex size 1e-7")
        );
    }
}
