//! Constraints beyond bounds: linear and nonlinear equalities and inequalities.

pub(crate) mod quadratic_program;

use crate::error::Error;
use serde::{Deserialize, Serialize};

/// The linear constraint `lower <= coefficients . x <= upper`, in the user's units. Equal limits make it an
/// equality; an infinite limit means no limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LinearConstraint {
    /// One coefficient per parameter, including fixed ones.
    pub coefficients: Vec<f64>,
    /// Smallest value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
}

/// Limits of one constraint function: `lower <= c(x) <= upper`. Equal limits make it an equality.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct NonlinearConstraint {
    /// Smallest value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// True if the objective must not be evaluated where the constraint is violated.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub keep_feasible: bool,
}

impl NonlinearConstraint {
    /// Returns the distance of a value from the limits; 0 between them, infinite for NaN.
    pub fn violation(&self, value: f64) -> f64 {
        if value.is_nan() { f64::INFINITY } else { (self.lower - value).max(value - self.upper).max(0.0) }
    }
}

/// An active constraint with its Lagrange multiplier.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ActiveConstraint {
    /// True for a linear constraint.
    pub is_linear: bool,
    /// Index among the linear or among the nonlinear constraints.
    pub index: usize,
    /// Decrease of the cost per unit by which the active limit moves outwards: the multiplier of the
    /// constraint in the cost's unit per unit of the constraint.
    pub multiplier: f64,
}

/// Constraints of a run beyond its bounds.
///
/// Linear constraints hold at every evaluated point, up to the rounding error of their terms, like bounds.
/// Equalities among them reduce the dimension of the search. The values of nonlinear constraints come with
/// each answer ([`Answer::constraints`](crate::Answer::constraints)), and these constraints may be violated
/// on the way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Constraints {
    /// Linear constraints.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub linear: Vec<LinearConstraint>,
    /// Nonlinear constraints, in the order of the constraint values.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub nonlinear: Vec<NonlinearConstraint>,
    /// Violation of a nonlinear constraint, in its own unit, up to which a point counts as feasible; default
    /// 1e-6.
    pub tolerance: f64,
}

impl Default for Constraints {
    fn default() -> Self {
        Self { linear: Vec::new(), nonlinear: Vec::new(), tolerance: 1e-6 }
    }
}

impl Constraints {
    /// True if there are no constraints.
    pub fn is_empty(&self) -> bool {
        self.linear.is_empty() && self.nonlinear.is_empty()
    }

    /// True if a nonlinear constraint is an equality.
    pub(crate) fn has_equalities(&self) -> bool {
        self.nonlinear.iter().any(|limits| limits.lower == limits.upper)
    }

    /// Returns the largest violation of a nonlinear constraint; 0 without nonlinear constraints, infinite if
    /// a value is NaN or missing.
    pub fn violation(&self, values: &[f64]) -> f64 {
        self.each_violation(values).fold(0.0, f64::max)
    }

    /// Returns the measure by which infeasible points rank: the sum of the violations beyond the tolerance.
    /// It is 0 for feasible points.
    pub(crate) fn rank(&self, values: &[f64]) -> f64 {
        let beyond = |violation: f64| if violation > self.tolerance { violation } else { 0.0 };
        // The sum of no numbers is -0, which ranks before 0.
        self.each_violation(values).map(beyond).fold(0.0, |sum, violation| sum + violation)
    }

    /// True if a violated constraint forbids the evaluation of the objective.
    pub fn forbids(&self, values: &[f64]) -> bool {
        let kept = self.nonlinear.iter().zip(self.each_violation(values));
        kept.into_iter().any(|(limits, violation)| limits.keep_feasible && violation > self.tolerance)
    }

    fn each_violation<'a>(&'a self, values: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
        let value = |k: usize| values.get(k).copied().unwrap_or(f64::NAN);
        self.nonlinear.iter().enumerate().map(move |(k, limits)| limits.violation(value(k)))
    }

    /// Checks the numbers against the number of parameters.
    pub(crate) fn check(&self, n: usize) -> Result<(), Error> {
        let linear = self.linear.iter().map(|c| (c.lower, c.upper));
        let nonlinear = self.nonlinear.iter().map(|c| (c.lower, c.upper));
        let kinds = linear.enumerate().map(|(k, limits)| ("linear", k, limits));
        let kinds = kinds.chain(nonlinear.enumerate().map(|(k, limits)| ("nonlinear", k, limits)));
        for (kind, index, (lower, upper)) in kinds {
            let empty = lower == f64::INFINITY || upper == f64::NEG_INFINITY;
            if lower.is_nan() || upper.is_nan() || lower > upper || empty {
                return Err(Error::ConstraintLimits { kind, index, lower, upper });
            }
        }
        for (constraint, row) in self.linear.iter().enumerate() {
            let got = row.coefficients.len();
            if got != n {
                return Err(Error::Length { what: "linear constraint", expected: n, got });
            }
            if let Some(index) = row.coefficients.iter().position(|a| !a.is_finite()) {
                let value = row.coefficients[index];
                return Err(Error::ConstraintCoefficient { constraint, index, value });
            }
        }
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            let range = "finite and not negative";
            return Err(Error::Option { name: "constraint_tol", value: self.tolerance, range });
        }
        Ok(())
    }
}
