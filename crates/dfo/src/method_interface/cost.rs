//! Cost of a stored point, if known, and the comparison of costs.

use crate::outcome::answer::{Failure, FailureKind, Outcome};
use crate::problem::constraints::Constraints;
use serde::{Deserialize, Serialize};

/// Cost of a vertex or of a member of a population. The variants are ordered by rank, which gives the rules
/// of Deb (Comput. Methods Appl. Mech. Eng. 186, 2000, 311): feasible points rank by their cost and before
/// all others, infeasible points by their violation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Cost {
    /// A finite cost of a point that satisfies the nonlinear constraints.
    Value(f64),
    /// The point violates nonlinear constraints by this sum of violations. Its cost may be unknown.
    Infeasible(f64),
    /// The objective failed at this point.
    Failed,
    /// The point has not been evaluated.
    Pending,
}

impl Cost {
    /// Returns the cost of a known outcome. `values` are the values of the nonlinear constraints. An
    /// evaluation stopped above its cutoff has no cost and counts as failed.
    pub(crate) fn of(outcome: &Outcome, constraints: &Constraints, values: &[f64]) -> Self {
        let violation = match outcome {
            _ if constraints.nonlinear.is_empty() => 0.0,
            Outcome::Value(_) | Outcome::Failed(Failure { kind: FailureKind::Infeasible, .. }) => {
                constraints.rank(values)
            }
            _ => 0.0,
        };
        match outcome.value() {
            // A constraint value is NaN.
            _ if violation == f64::INFINITY => Self::Failed,
            _ if violation > 0.0 => Self::Infeasible(violation),
            Some(value) => Self::Value(value),
            None => Self::Failed,
        }
    }

    /// True if `self` ranks strictly better. The order is total because values are finite.
    pub(crate) fn better_than(self, other: Self) -> bool {
        match (self, other) {
            (Self::Value(a), Self::Value(b)) | (Self::Infeasible(a), Self::Infeasible(b)) => a < b,
            (Self::Value(_), _) => true,
            (Self::Infeasible(_), Self::Failed | Self::Pending) => true,
            (Self::Failed, Self::Pending) => true,
            (Self::Infeasible(_) | Self::Failed | Self::Pending, _) => false,
        }
    }

    pub(crate) fn value(self) -> Option<f64> {
        match self {
            Self::Value(v) => Some(v),
            Self::Infeasible(_) | Self::Failed | Self::Pending => None,
        }
    }

    /// True if the point has a cost or a known violation.
    pub(crate) fn is_ranked(self) -> bool {
        matches!(self, Self::Value(_) | Self::Infeasible(_))
    }
}
