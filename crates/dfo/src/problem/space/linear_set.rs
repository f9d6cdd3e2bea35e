//! Linear constraints in working coordinates.

use crate::problem::constraints::quadratic_program::HalfSpace;
use serde::{Deserialize, Serialize};

/// A parameter that linear equalities determine from the free parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Dependent {
    /// Index of the parameter.
    pub(super) index: usize,
    pub(super) constant: f64,
    /// Coefficients of the working coordinates, which are linear here.
    pub(super) coefficients: Vec<f64>,
}

/// Linear constraints in working coordinates.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct LinearSet {
    pub(super) dependents: Vec<Dependent>,
    pub(super) rows: Vec<HalfSpace>,
    /// Constraint that each row comes from: `None` for the bounds of a dependent parameter.
    pub(super) origins: Vec<Option<usize>>,
    /// For a ratio of logarithmic parameters, the coefficient of the first one in the constraint.
    #[serde(default)]
    pub(super) ratios: Vec<Option<f64>>,
    /// A point with a distance from all rows and bounds, in working coordinates.
    pub(super) interior: Vec<f64>,
}

impl LinearSet {
    pub(super) fn is_empty(&self) -> bool {
        self.dependents.is_empty() && self.rows.is_empty()
    }
}
