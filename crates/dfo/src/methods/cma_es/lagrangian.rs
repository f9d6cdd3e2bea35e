//! Constraints by additional terms of the cost.
//!
//! **Linear inequalities.** An individual outside is evaluated at the nearest feasible point. Its cost is
//! increased by a multiple of the squared distance between both points, and the distribution learns from the
//! step as drawn.
//!
//! **Nonlinear constraints** are treated by an augmented Lagrangian, whose coefficients adapt to the
//! search (Atamna, Auger and Hansen, "Linearly convergent evolution strategies via augmented Lagrangian
//! constraint handling", FOGA 2017).
//!
//! Individuals rank by `f + sum_i (gamma_i g_i + omega_i g_i^2 / 2)`. For an inequality `g_i <= 0`, the term
//! of a point with `g_i < -gamma_i / omega_i` is the constant `-gamma_i^2 / (2 omega_i)`. The multiplier
//! `gamma_i` moves by `omega_i g_i / 5` per generation, and the coefficient `omega_i` by the rules of pycma 4
//! (`AugmentedLagrangian`, algorithm 3). Unlike there, `f` and `g` of the mean are estimated by the weighted
//! means of the parents, which needs no evaluation.
//!
//! Individuals whose cost was not evaluated, because a constraint must be kept, rank behind all others by
//! their violation.

use super::weights::Weights;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::Outcome;
use crate::problem::constraints::{Constraints, NonlinearConstraint};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Damping of the multipliers: Atamna et al. (2017), `d_gamma`.
const DAMPING: f64 = 5.0;
/// Damping of the coefficients: `omega` changes by the factor `2^(1 / (5 n))`.
const COEFFICIENT_DAMPING: f64 = 5.0;
/// Weight of the change of the Lagrangian (`k_1`) and of the constraint (`k_2`) in the rule for equalities.
const K: (f64, f64) = (3.0, 5.0);
/// Shares of feasible means above which the coefficient increases, and below which it decreases (pycma).
const FEASIBLE: (f64, f64) = (0.95, 0.9);
/// Share of infeasible and of feasible individuals from which the first coefficients are final (pycma).
const SHARE: f64 = 0.1;

/// One side of a constraint: `g <= 0`, or `g = 0` for an equality.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Side {
    gamma: f64,
    omega: f64,
    is_final: bool,
    /// Number of successive changes of `omega` with the same sign, negative for decreases.
    n_same: i64,
    /// The last values at the mean.
    recent: VecDeque<f64>,
}

/// Coefficients of the constraints, and the values of the current generation.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Lagrangian {
    sides: Vec<Side>,
    /// Cost of each individual of the generation; `None` if it was not evaluated.
    costs: Vec<Option<f64>>,
    /// Values of all sides of each individual, concatenated.
    values: Vec<f64>,
    /// Rank of each individual by the rules of Deb.
    ranks: Vec<Cost>,
    /// Squared distance that each individual was moved by linear constraints, in units of the sizes. Empty
    /// without linear constraints.
    #[serde(default)]
    moved: Vec<f64>,
    /// Cost of a squared distance of 1, and the last estimates of it.
    #[serde(default)]
    weight: f64,
    #[serde(default)]
    curvatures: VecDeque<f64>,
    #[serde(default)]
    has_rows: bool,
    /// The Lagrangian at the last mean.
    before: Option<f64>,
    /// Violation of the best point since the last restart; infinite if there is none.
    pub(super) best_violation: f64,
}

/// Returns the values of the sides of a constraint.
fn sides(limits: &NonlinearConstraint, value: f64) -> impl Iterator<Item = f64> {
    let is_equality = limits.lower == limits.upper;
    let upper = limits.upper.is_finite().then_some(value - limits.upper);
    let lower = (limits.lower.is_finite() && !is_equality).then_some(limits.lower - value);
    upper.into_iter().chain(lower)
}

/// Returns for each side whether it is an equality.
fn are_equalities(constraints: &Constraints) -> impl Iterator<Item = bool> {
    constraints.nonlinear.iter().flat_map(|limits| sides(limits, 0.0).map(|_| limits.lower == limits.upper))
}

impl Lagrangian {
    pub(super) fn new(constraints: &Constraints, has_rows: bool) -> Self {
        let sides = are_equalities(constraints).map(|_| Side::default()).collect();
        Self { sides, has_rows, best_violation: f64::INFINITY, ..Self::default() }
    }

    /// True if there are neither nonlinear constraints nor linear inequalities.
    pub(super) fn is_empty(&self) -> bool {
        self.sides.is_empty() && !self.has_rows
    }

    /// True if there are linear inequalities.
    pub(super) fn has_rows(&self) -> bool {
        self.has_rows
    }

    /// Starts a generation.
    pub(super) fn start(&mut self, members: usize) {
        if self.is_empty() {
            return;
        }
        self.costs.clear();
        self.costs.resize(members, None);
        self.values.clear();
        self.values.resize(members * self.sides.len(), 0.0);
        self.ranks.clear();
        self.ranks.resize(members, Cost::Pending);
        self.moved.clear();
        if self.has_rows {
            self.moved.resize(members, 0.0);
        }
    }

    /// Sets the squared distance that an individual was moved by linear constraints.
    pub(super) fn set_moved(&mut self, slot: usize, squared: f64) {
        if let Some(moved) = self.moved.get_mut(slot) {
            *moved = squared;
        }
    }

    /// Records an individual, and returns the cost by which it ranks with the current coefficients.
    pub(super) fn enter(
        &mut self,
        slot: usize,
        outcome: &Outcome,
        constraints: &Constraints,
        values: &[f64],
    ) -> Cost {
        let rank = Cost::of(outcome, constraints, values);
        let m = self.sides.len();
        let (Some(stored), Some(at)) =
            (self.ranks.get_mut(slot), self.values.get_mut(slot * m..(slot + 1) * m))
        else {
            return rank;
        };
        *stored = rank;
        let all = constraints.nonlinear.iter().zip(values).flat_map(|(limits, value)| sides(limits, *value));
        at.iter_mut().zip(all).for_each(|(to, value)| *to = value);
        self.costs[slot] = outcome.value().filter(|_| rank.is_ranked());
        self.cost(slot, constraints)
    }

    /// Returns the cost by which an individual ranks.
    fn cost(&self, slot: usize, constraints: &Constraints) -> Cost {
        let Some(f) = self.costs[slot] else { return self.ranks[slot] };
        let moved = self.moved.get(slot).map_or(0.0, |squared| self.weight * squared);
        let lagrangian = f + self.penalty(&self.values[slot * self.sides.len()..], constraints) + moved;
        if lagrangian.is_finite() { Cost::Value(lagrangian) } else { self.ranks[slot] }
    }

    /// Returns the sum of the terms of all sides.
    fn penalty(&self, values: &[f64], constraints: &Constraints) -> f64 {
        let term = |((side, is_equality), g): ((&Side, bool), &f64)| {
            if side.omega > 0.0 && !is_equality && g * side.omega < -side.gamma {
                -0.5 * side.gamma * (side.gamma / side.omega)
            } else {
                side.gamma * g + 0.5 * side.omega * g * g
            }
        };
        self.sides.iter().zip(are_equalities(constraints)).zip(values).map(term).sum()
    }

    /// Returns the best individual of a complete generation by the rules of Deb, with its rank.
    pub(super) fn best(&self) -> Option<(usize, Cost)> {
        let ranked = self.ranks.iter().copied().enumerate().filter(|(_, rank)| rank.is_ranked());
        ranked.reduce(|best, other| if other.1.better_than(best.1) { other } else { best })
    }

    /// Sets the first coefficients from a generation, and ranks it with them.
    /// `variance` is the mean variance of the distribution along the coordinates, in units of the sizes.
    pub(super) fn prepare(
        &mut self,
        generation: &mut RankedPoints,
        constraints: &Constraints,
        (n, variance): (usize, f64),
    ) {
        self.initialise(constraints, n as f64);
        self.weigh_moves(n, variance);
        for slot in 0..generation.len().min(self.ranks.len()) {
            generation.set_cost(slot, self.cost(slot, constraints));
        }
        generation.rank();
    }

    /// Sets the cost of moves by linear constraints: twice the median ratio of the spread of the costs to the
    /// variance in the last generations, as for bounds in pycma (`BoundPenalty`; Hansen, Niederberger,
    /// Guzzella and Koumoutsakos, IEEE Trans. Evol. Comput. 13, 2009, 180).
    fn weigh_moves(&mut self, n: usize, variance: f64) {
        let costs = self.costs.iter().flatten().copied();
        if !self.has_rows || costs.clone().count() < 2 {
            return;
        }
        let curvature = spread(costs) / variance;
        if curvature > 0.0 && curvature.is_finite() {
            if self.curvatures.len() >= 20 + 3 * n {
                self.curvatures.pop_front();
            }
            self.curvatures.push_back(curvature);
            let mut sorted: Vec<f64> = self.curvatures.iter().copied().collect();
            sorted.sort_unstable_by(f64::total_cmp);
            self.weight = 2.0 * sorted[sorted.len() / 2];
        }
    }

    /// Sets coefficients that are not final from the spread of costs and values (pycma, `set_coefficients`).
    fn initialise(&mut self, constraints: &Constraints, n: f64) {
        let m = self.sides.len();
        let evaluated: Vec<usize> = (0..self.costs.len()).filter(|k| self.costs[*k].is_some()).collect();
        if evaluated.len() < 2 {
            return;
        }
        let of_costs = spread(evaluated.iter().filter_map(|k| self.costs[*k]));
        for (i, is_equality) in are_equalities(constraints).enumerate() {
            let all = || evaluated.iter().map(|k| self.values[k * m + i]);
            let infeasible = all().filter(|g| *g > 0.0).count() as f64 / evaluated.len() as f64;
            let (of_values, of_squares) = (spread(all()), spread(all().map(|g| g * g)));
            let side = &mut self.sides[i];
            if side.is_final && side.omega > 0.0 || infeasible <= SHARE && !is_equality {
                continue;
            }
            let tiny = 1e-11 * (of_costs + 1.0);
            let omega = 0.4 * of_costs / n / (of_values + 1e-6 * of_squares + tiny);
            if !(omega > 0.0 && omega.is_finite()) {
                continue;
            }
            let mostly_infeasible = infeasible > 0.6 && !is_equality;
            if side.omega == 0.0 || (side.omega < omega) == mostly_infeasible {
                side.omega = omega;
                side.gamma = if is_equality { 0.0 } else { of_costs / (n * of_values + tiny) };
            }
            side.is_final = is_equality || infeasible < 1.0 - SHARE;
        }
    }

    /// Adapts the coefficients to a ranked generation.
    pub(super) fn adapt(
        &mut self,
        generation: &RankedPoints,
        weights: &Weights,
        constraints: &Constraints,
        n: usize,
    ) {
        let (m, n) = (self.sides.len(), n as f64);
        let (mut f, mut mean, mut total) = (0.0, vec![0.0; m], 0.0);
        for (slot, w) in generation.order().iter().zip(&weights.of_rank).filter(|(_, w)| **w > 0.0) {
            if let Some(cost) = self.costs.get(*slot).copied().flatten() {
                total += w;
                f += w * cost;
                let values = &self.values[slot * m..(slot + 1) * m];
                mean.iter_mut().zip(values).for_each(|(mean, g)| *mean += w * g);
            }
        }
        if total <= 0.0 || m == 0 {
            return;
        }
        mean.iter_mut().for_each(|g| *g /= total);
        let lagrangian = f / total + self.penalty(&mean, constraints);
        let change = self.before.map_or(f64::INFINITY, |before| (lagrangian - before).abs());
        let factor = 2f64.powf(1.0 / (COEFFICIENT_DAMPING * n));
        let horizon = 5 + n as usize;
        for (i, is_equality) in are_equalities(constraints).enumerate() {
            let (g, m) = (mean[i], self.sides.len());
            let is_penalised = |side: &Side, g: f64| is_equality || g * side.omega > -side.gamma;
            let side = &self.sides[i];
            let any = (0..self.costs.len())
                .any(|k| self.costs[k].is_some() && is_penalised(side, self.values[k * m + i]));
            let side = &mut self.sides[i];
            let before = side.recent.back().copied();
            if side.recent.len() >= horizon {
                side.recent.pop_front();
            }
            side.recent.push_back(g);
            if side.omega == 0.0 {
                continue;
            }
            if any {
                side.gamma += side.omega * g / DAMPING;
            }
            if !is_equality && side.gamma < 0.0 {
                side.gamma = 0.0;
                continue;
            }
            if !is_penalised(side, g) {
                continue;
            }
            let increases = if is_equality {
                let barely = before.is_some_and(|before| K.1 * (g - before).abs() < before.abs());
                Some(side.omega * g * g < K.0 * change / n || barely)
            } else {
                let feasible = side.recent.iter().filter(|g| **g <= 0.0).count() as f64;
                let share = feasible / side.recent.len() as f64;
                if g > 0.0 || share > FEASIBLE.0 {
                    Some(true)
                } else {
                    (share < FEASIBLE.1 && g < 0.0).then_some(false)
                }
            };
            let Some(increases) = increases else { continue };
            let sign = if increases { 1 } else { -1 };
            side.n_same = if side.n_same.signum() == -sign { sign } else { side.n_same + sign };
            // Many changes in one direction are accelerated (pycma, `CountLastSameChanges`).
            let threshold = 2.0 + m as f64;
            let more = 4.0 / threshold * (side.n_same.unsigned_abs() as f64 - threshold).max(0.0);
            let exponent = match (is_equality, increases) {
                (true, true) => 0.25,
                (true, false) => -1.0,
                (false, true) => 0.25 * (1.0 + more),
                (false, false) => -0.25 * (1.0 + more),
            };
            let omega = side.omega * factor.powf(exponent);
            if omega.is_normal() {
                side.omega = omega;
            }
        }
        self.before = Some(f / total + self.penalty(&mean, constraints)).filter(|value| value.is_finite());
    }

    /// True if the lengths fit the problem. State loaded from a file may be inconsistent.
    pub(super) fn is_sound(&self, constraints: &Constraints, n_drawn: usize) -> bool {
        let (m, members) = (self.sides.len(), self.costs.len());
        (members == 0 || members == n_drawn)
            && m == are_equalities(constraints).count()
            && self.values.len() == members * m
            && self.ranks.len() == members
            && self.moved.len() == if self.has_rows { members } else { 0 }
            && self.weight >= 0.0
            && self.weight.is_finite()
            && self
                .sides
                .iter()
                .all(|side| side.omega >= 0.0 && side.omega.is_finite() && side.gamma.is_finite())
    }
}

/// Returns the interquartile range of some values, or their range if there are few.
fn spread(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len() - 1;
    let at = |share: f64| {
        let place = share * last as f64;
        let (k, part) = (place.floor() as usize, place.fract());
        sorted[k] + part * (sorted[(k + 1).min(last)] - sorted[k])
    };
    let quartiles = at(0.75) - at(0.25);
    if quartiles > 0.0 { quartiles } else { sorted[last] - sorted[0] }
}
