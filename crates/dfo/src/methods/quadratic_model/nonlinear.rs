//! Nonlinear constraints of a search on quadratic models.
//!
//! Each constraint value has a model through the same points as the model of the cost. The points rank by a
//! merit function, the cost plus a penalty times the Euclidean norm of the violations; `points` contains its
//! values. The penalty exceeds the multipliers of the constraints, so that the minimum of the merit function
//! is the constrained minimum of the cost.

use super::constraint_models::{Evaluated, Found};
use super::model::Quadratic;
use super::sqp::{Models, violation};
use super::state::{ModelSearch, Phase};
use crate::methods::shared::cost::Cost;
use crate::outcome::answer::{Answers, FailureKind, Outcome};
use crate::problem::constraints::ActiveConstraint;
use crate::problem::constraints::quadratic_program::HalfSpace;
use crate::values::choices::Transform;

/// Ratio of the penalty to the norm of the multipliers below which it grows, and the ratio after that.
const LEAST_RATIO: f64 = 1.5;
const RATIO: f64 = 2.0;
/// Ratio to which a larger penalty shrinks when the resolution decreases.
const LARGEST_RATIO: f64 = 10.0;
/// Share of the possible reduction of the violation that a step must predict, and the growth of the penalty
/// otherwise.
const LEAST_SHARE: f64 = 0.1;
const GROWTH: f64 = 4.0;
/// Ratio beyond which the penalty does not grow for this reason. A larger one hides the cost.
const MOST_RATIO: f64 = 100.0;
/// Maximum number of changes of the penalty before a step.
const MOST_CHANGES: usize = 10;
/// Distance of an active constraint from the best point, in resolutions.
const ACTIVE: f64 = 10.0;

impl ModelSearch {
    fn limits(&self) -> Vec<(f64, f64)> {
        self.setup.constraints.nonlinear.iter().map(|c| (c.lower, c.upper)).collect()
    }

    /// Returns the cost of a point of the model, which is not its merit.
    pub(super) fn objective(&self, slot: usize) -> f64 {
        match &self.nonlinear {
            Some(nonlinear) if self.points.cost(slot).value().is_some() => {
                nonlinear.at(self.points.u(slot)).map_or(f64::INFINITY, |e| e.cost)
            }
            _ => self.cost(slot),
        }
    }

    /// Stores constraint values of the last batch and replaces the costs of its points by their merits.
    pub(super) fn take_constraints(&mut self, answers: &Answers, is_start: bool) {
        if self.nonlinear.is_none() {
            return;
        }
        let n_points = if is_start { self.points.len() } else { self.trial.len() };
        for slot in 0..n_points {
            let Some(k) = self.rounds.place_of(slot).filter(|k| *k < answers.len()) else { continue };
            let outcome = &answers.outcomes()[k];
            if !outcome.is_conclusive() {
                continue;
            }
            let points = if is_start { &self.points } else { &self.trial };
            let (u, x) = (points.u(slot).to_vec(), points.x(slot).to_vec());
            let values = answers.constraints(k).to_vec();
            let count = self.setup.constraints.nonlinear.len();
            let is_known = values.len() == count && values.iter().all(|v| v.is_finite());
            let forbidden = matches!(outcome, Outcome::Failed(f) if f.kind == FailureKind::Infeasible);
            let (cost, is_predicted) = match outcome.value() {
                Some(cost) => (Some(cost), false),
                None if forbidden && !is_start => {
                    let base = self.base();
                    let s = self.displacement(self.points.u(base), &u);
                    (Some(self.objective(base) + self.model.value(&s)).filter(|f| f.is_finite()), true)
                }
                None => (None, false),
            };
            let Some(cost) = cost.filter(|_| is_known) else {
                let points = if is_start { &mut self.points } else { &mut self.trial };
                points.set_cost(slot, Cost::Failed);
                continue;
            };
            let rank = self.setup.constraints.rank(&values);
            if let Some(nonlinear) = &mut self.nonlinear {
                let is_better = |best: &Found| rank < best.rank || (rank == best.rank && cost < best.cost);
                if !is_predicted && nonlinear.best.as_ref().is_none_or(is_better) {
                    nonlinear.best = Some(Found { x, cost, rank });
                }
                nonlinear.evaluated.push(Evaluated { u, cost, is_predicted, values });
            }
        }
        self.forget_evaluated();
        self.update_merits();
    }

    /// Removes stored values of points that have left the model.
    fn forget_evaluated(&mut self) {
        let Some(nonlinear) = &mut self.nonlinear else { return };
        let all = (0..self.points.len()).map(|slot| self.points.u(slot));
        let all: Vec<&[f64]> = all.chain([self.trial.u(0)]).collect();
        nonlinear.evaluated.retain(|e| all.contains(&&e.u[..]));
    }

    /// Computes the merits of all points with the present penalty.
    fn update_merits(&mut self) {
        let limits = self.limits();
        let Some(nonlinear) = &self.nonlinear else { return };
        let merit = |e: &Evaluated| e.cost + nonlinear.penalty * violation(e.values.iter().copied(), &limits);
        // Points without an evaluation of the cost rank behind all others.
        let worst = nonlinear.evaluated.iter().filter(|e| !e.is_predicted).map(merit);
        let worst = worst.fold(f64::NEG_INFINITY, f64::max);
        let behind = worst + f64::EPSILON * worst.abs() + f64::MIN_POSITIVE;
        let of = |e: &Evaluated| {
            let merit = if e.is_predicted { merit(e).max(behind) } else { merit(e) };
            if merit.is_finite() { Cost::Value(merit) } else { Cost::Failed }
        };
        for points in [&mut self.points, &mut self.trial] {
            for slot in 0..points.len() {
                if let Some(e) = nonlinear.at(points.u(slot))
                    && points.cost(slot) != Cost::Pending
                {
                    points.set_cost(slot, of(e));
                }
            }
        }
    }

    /// Forgets the models of the constraints.
    pub(super) fn reset_constraints(&mut self) {
        if let Some(nonlinear) = &mut self.nonlinear {
            nonlinear.models.clear();
        }
    }

    /// Makes the models of the constraints interpolate their values. `moved` is the displacement of the base
    /// point.
    pub(super) fn refit_constraints(&mut self, moved: &[f64]) {
        let (n, base) = (self.n(), self.base());
        let costs = (0..self.points.len()).map(|slot| {
            let e = self.nonlinear.as_ref()?.at(self.points.u(slot))?;
            (!e.is_predicted).then_some(e.cost)
        });
        let costs = costs.collect();
        let Some(nonlinear) = &mut self.nonlinear else { return };
        nonlinear.costs = costs;
        let (Some(points), Some(here)) = (&self.interpolation, nonlinear.at(self.points.u(base))) else {
            return;
        };
        let here = here.values.clone();
        if nonlinear.models.is_empty() {
            nonlinear.models = vec![Quadratic::zero(n); here.len()];
        }
        let mut models = std::mem::take(&mut nonlinear.models);
        for (i, model) in models.iter_mut().enumerate() {
            model.gradient = model.slope(moved);
            let value =
                |slot: &usize| nonlinear.at(self.points.u(*slot)).map_or(0.0, |e| e.values[i] - here[i]);
            let values: Vec<f64> = points.slots.iter().map(value).collect();
            if !points.update(model, &values) {
                *model = Quadratic::zero(n);
                points.update(model, &values);
            }
        }
        nonlinear.models = models;
    }

    /// Calls a function with the models, if there are nonlinear constraints.
    fn with_models<T>(&self, cost: &Quadratic, f: impl FnOnce(&Models<'_>) -> T) -> Option<T> {
        let nonlinear = self.nonlinear.as_ref()?;
        let u = self.points.u(self.base());
        let values = &nonlinear.at(u)?.values;
        if nonlinear.models.len() != values.len() {
            return None;
        }
        let (limits, rows) = (self.limits(), self.rows_from(u));
        Some(f(&Models {
            cost,
            values,
            constraints: &nonlinear.models,
            limits: &limits,
            rows: &rows,
            radius: self.delta,
            penalty: nonlinear.penalty,
        }))
    }

    /// Returns the step of a model of the cost and the models of the constraints.
    pub(super) fn constrained_step(&self, cost: &Quadratic) -> Vec<f64> {
        let step = self.with_models(cost, |models| models.step().0);
        step.unwrap_or_else(|| vec![0.0; self.n()])
    }

    /// Returns the change of the merit function that the models predict; without nonlinear constraints, the
    /// change of the cost.
    pub(super) fn change(&self, s: &[f64]) -> f64 {
        self.with_models(&self.model, |models| models.change(s)).unwrap_or_else(|| self.value(s))
    }

    /// True if the best point satisfies the nonlinear constraints up to their tolerance.
    pub(super) fn is_feasible(&self) -> bool {
        let Some(nonlinear) = &self.nonlinear else { return true };
        let here = nonlinear.at(self.points.u(self.base()));
        here.is_some_and(|e| self.setup.constraints.rank(&e.values) == 0.0)
    }

    /// Adapts the penalty to the multipliers before a step. The base point may change.
    pub(super) fn adapt_penalty(&mut self) {
        for _ in 0..MOST_CHANGES {
            let found = self.with_models(&self.model, |models| {
                let zero = vec![0.0; self.n()];
                let (s, reachable) = models.step();
                let size = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
                let multipliers = [&zero, &s].map(|s| size(&models.multipliers(s, models.radius)));
                let slopes = models.constraints.iter().map(|model| size(&model.gradient));
                let steepest = slopes.fold(0.0, f64::max);
                let slope = size(&models.cost.gradient);
                // A cost without slope must not hide the constraints.
                let least = if slope > 0.0 && steepest > 0.0 { 1e-3 * slope / steepest } else { 1.0 };
                let before = models.violation(&zero);
                let gains = before <= self.setup.constraints.tolerance
                    || before - models.violation(&s) >= LEAST_SHARE * (before - reachable);
                (multipliers[0].max(multipliers[1]), least, gains)
            });
            let (Some((multiplier, least, gains)), Some(nonlinear)) = (found, &mut self.nonlinear) else {
                return;
            };
            let before = nonlinear.penalty;
            let wanted = RATIO * multiplier.max(least);
            if before < LEAST_RATIO * multiplier || before < least {
                nonlinear.penalty = wanted;
            } else if !gains && before < MOST_RATIO / RATIO * wanted {
                nonlinear.penalty *= GROWTH;
            } else if self.rho < nonlinear.rho {
                nonlinear.penalty = before.min(LARGEST_RATIO / RATIO * wanted);
            }
            nonlinear.rho = self.rho;
            if nonlinear.penalty == before || !nonlinear.penalty.is_finite() {
                nonlinear.penalty = nonlinear.penalty.min(f64::MAX.sqrt());
                return;
            }
            let from = self.points.u(self.base()).to_vec();
            self.update_merits();
            self.refit(&from);
        }
    }

    /// Returns the active constraints at the best point with their multipliers.
    pub(super) fn active_constraints(&self) -> Vec<ActiveConstraint> {
        let space = &self.setup.space;
        let is_searching = matches!(self.phase, Phase::NoStart | Phase::Starting) || self.operation.is_none();
        let has_none = self.n() == 0 || self.nonlinear.is_none() && !self.has_rows();
        if has_none || is_searching {
            return Vec::new();
        }
        let u = self.points.u(self.base());
        let rows = self.rows_from(u);
        let near = ACTIVE * self.rho;
        let (of_values, of_rows) = self
            .with_models(&self.model, |models| models.balance(&vec![0.0; u.len()], near))
            .unwrap_or_else(|| {
                let none = Models {
                    cost: &self.model,
                    values: &[],
                    constraints: &[],
                    limits: &[],
                    rows: &rows,
                    radius: 0.0,
                    penalty: 0.0,
                };
                none.balance(&vec![0.0; u.len()], near)
            });
        let mut all = Vec::new();
        // Rows of the space come first, in their order.
        for (k, multiplier) in of_rows.into_iter().filter(|(k, _)| *k < space.rows().len()) {
            let HalfSpace { normal, .. } = &space.rows()[k];
            let is_linear = (0..u.len()).all(|j| normal[j] == 0.0 || space.transform(j) == Transform::Linear);
            let size = (0..u.len()).map(|j| (normal[j] * space.size(j)).powi(2)).sum::<f64>().sqrt();
            if let Some(index) = space.origin_of_row(k).filter(|_| is_linear && multiplier > 0.0) {
                all.push(ActiveConstraint { is_linear: true, index, multiplier: multiplier / size });
            }
        }
        for (index, multiplier) in of_values.into_iter().enumerate().filter(|(_, m)| *m != 0.0) {
            let limits = &self.setup.constraints.nonlinear[index];
            let multiplier = if limits.lower == limits.upper { multiplier } else { multiplier.abs() };
            all.push(ActiveConstraint { is_linear: false, index, multiplier });
        }
        all
    }
}
