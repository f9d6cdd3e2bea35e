//! Cost of a stored point, if known, and the comparison of costs.

use crate::outcome::answer::Outcome;
use serde::{Deserialize, Serialize};

/// Cost of a vertex or of a member of a population. The variants are ordered by rank.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Cost {
    /// A finite cost.
    Value(f64),
    /// The objective failed at this point.
    Failed,
    /// The point has not been evaluated.
    Pending,
}

impl Cost {
    /// Returns the cost of a known outcome. An evaluation stopped above its cutoff has no cost and counts as
    /// failed.
    pub(crate) fn of(outcome: &Outcome) -> Self {
        outcome.value().map_or(Self::Failed, Self::Value)
    }

    /// True if `self` ranks strictly better. The order is total because values are finite.
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
