//! Values and models of nonlinear constraints.

use super::model::Quadratic;
use serde::{Deserialize, Serialize};

/// An evaluated point.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Evaluated {
    pub(super) u: Vec<f64>,
    pub(super) cost: f64,
    /// True if the cost is the prediction of the model, because a constraint forbids the evaluation.
    pub(super) is_predicted: bool,
    pub(super) values: Vec<f64>,
}

/// Best point: feasible points rank first, see `Constraints::rank`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Found {
    pub(super) x: Vec<f64>,
    pub(super) cost: f64,
    pub(super) rank: f64,
}

/// Models and values of the nonlinear constraints.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Nonlinear {
    pub(super) evaluated: Vec<Evaluated>,
    pub(super) models: Vec<Quadratic>,
    pub(super) penalty: f64,
    /// Resolution at the last change of the penalty.
    pub(super) rho: f64,
    pub(super) best: Option<Found>,
    /// Costs of the points of the model, for views.
    pub(super) costs: Vec<Option<f64>>,
}

impl Nonlinear {
    pub(super) fn is_sound(&self, n: usize, n_user: usize, count: usize) -> bool {
        self.evaluated.iter().all(|e| e.u.len() == n && e.values.len() == count && e.cost.is_finite())
            && (self.models.is_empty() || self.models.len() == count)
            && self.models.iter().all(|model| model.is_sound(n))
            && self.penalty >= 0.0
            && self.penalty.is_finite()
            && self.rho >= 0.0
            && self.best.as_ref().is_none_or(|best| best.x.len() == n_user && best.cost.is_finite())
    }

    pub(super) fn at(&self, u: &[f64]) -> Option<&Evaluated> {
        self.evaluated.iter().rev().find(|e| e.u == u)
    }

    /// Returns the best point and its cost.
    pub(super) fn best(&self) -> Option<(&[f64], f64)> {
        self.best.as_ref().map(|best| (&best.x[..], best.cost))
    }
}
