//! Cost of a point that a method keeps, as far as it is known, and the comparison of two of them.

use crate::outcome::answer::Outcome;
use serde::{Deserialize, Serialize};

/// The cost of a vertex or of a member of a population. The order of the variants is the order of rank.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Cost {
    /// A finite cost.
    Value(f64),
    /// The objective failed there.
    Failed,
    /// Not evaluated yet.
    Pending,
}

impl Cost {
    /// The cost by an outcome that is known. What was given up above the cost that it had to reach has none,
    /// like what failed.
    pub(crate) fn of(outcome: &Outcome) -> Self {
        outcome.value().map_or(Self::Failed, Self::Value)
    }

    /// The rule of rank, a total order because values are finite: is `self` strictly better?
    pub(crate) fn better_than(self, other: Self) -> bool {
        match (self, other) {
            (Self::Value(a), Self::Value(b)) => a < b,
            (Self::Value(_), _) => true,
            (Self::Failed, Self::Pending) => true,
            (Self::Failed | Self::Pending, _) => false,
        }
    }

    pub(crate) fn value(self) -> Option<f64> {
        match self {
            Self::Value(v) => Some(v),
            Self::Failed | Self::Pending => None,
        }
    }
}
