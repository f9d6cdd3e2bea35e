//! Points in slots, with costs and ranks: the vertices of a simplex, or the members of a population. Code
//! specific to one of them is in `nelder_mead/simplex.rs` or `population.rs`.

use crate::method_interface::interface::SimplexView;
use crate::methods::shared::cost::Cost;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Points in slots, and the slots by rank.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct RankedPoints {
    pub(in crate::methods) n: usize,
    pub(in crate::methods) n_user: usize,
    pub(in crate::methods) u: Vec<f64>,
    pub(in crate::methods) x: Vec<f64>,
    pub(in crate::methods) costs: Vec<Cost>,
    /// Costs in the form that views borrow.
    pub(in crate::methods) values: Vec<Option<f64>>,
    /// Slots, best first, from the last ranking.
    pub(in crate::methods) order: Vec<usize>,
}

impl RankedPoints {
    /// Creates `len` points without costs, all at the start point.
    pub(crate) fn new(space: &Space, len: usize) -> Self {
        let (n, n_user) = (space.n_free(), space.n());
        Self {
            n,
            n_user,
            u: vec![0.0; len * n],
            x: space.x0().repeat(len),
            costs: vec![Cost::Pending; len],
            values: vec![None; len],
            order: (0..len).collect(),
        }
    }

    #[inline]
    pub(crate) fn len(&self) -> usize {
        self.costs.len()
    }

    /// Returns the working coordinates of a slot.
    #[inline]
    pub(crate) fn u(&self, slot: usize) -> &[f64] {
        &self.u[slot * self.n..(slot + 1) * self.n]
    }

    #[inline]
    pub(crate) fn u_mut(&mut self, slot: usize) -> &mut [f64] {
        &mut self.u[slot * self.n..(slot + 1) * self.n]
    }

    /// Returns the point of a slot in the user's units.
    #[inline]
    pub(crate) fn x(&self, slot: usize) -> &[f64] {
        &self.x[slot * self.n_user..(slot + 1) * self.n_user]
    }

    #[inline]
    pub(crate) fn x_mut(&mut self, slot: usize) -> &mut [f64] {
        &mut self.x[slot * self.n_user..(slot + 1) * self.n_user]
    }

    #[inline]
    pub(crate) fn cost(&self, slot: usize) -> Cost {
        self.costs[slot]
    }

    #[inline]
    pub(crate) fn set_cost(&mut self, slot: usize, cost: Cost) {
        self.costs[slot] = cost;
        self.values[slot] = cost.value();
    }

    /// Places a point, given on both scales, with an unknown cost.
    pub(crate) fn set(&mut self, slot: usize, u: &[f64], x: &[f64]) {
        self.u_mut(slot).copy_from_slice(u);
        self.x_mut(slot).copy_from_slice(x);
        self.set_cost(slot, Cost::Pending);
    }

    /// Returns the slots, best first.
    #[inline]
    pub(crate) fn order(&self) -> &[usize] {
        &self.order
    }

    /// Returns the slot of rank 0.
    #[inline]
    pub(crate) fn best(&self) -> usize {
        self.order[0]
    }

    /// Returns the slot of the last rank.
    #[inline]
    pub(crate) fn worst(&self) -> usize {
        self.order[self.order.len() - 1]
    }

    pub(crate) fn is_pending(&self) -> bool {
        self.costs.contains(&Cost::Pending)
    }

    /// Returns the number of points with a finite cost or a known violation of constraints.
    pub(crate) fn n_finite(&self) -> usize {
        self.costs.iter().filter(|cost| cost.is_ranked()).count()
    }

    /// True if all points equal the best point up to rounding.
    pub(crate) fn is_collapsed(&self, space: &Space) -> bool {
        let best = self.u(self.best());
        (0..self.len()).all(|slot| space.is_same(self.u(slot), best))
    }

    /// Returns the largest minus the smallest cost of these slots, which are sorted best first. Returns
    /// `None` if the first or the last slot has no cost.
    pub(crate) fn f_spread(&self, slots: &[usize]) -> Option<f64> {
        match (self.costs[*slots.first()?], self.costs[*slots.last()?]) {
            (Cost::Value(best), Cost::Value(worst)) => Some(worst - best),
            _ => None,
        }
    }

    pub(crate) fn view(&self) -> SimplexView<'_> {
        let Self { n_user, x, costs, values, order, .. } = self;
        SimplexView { n: *n_user, x, costs: values, ranked: costs, order }
    }

    /// True if all lengths are consistent and all points are in the box. State loaded from a file may be
    /// inconsistent.
    pub(crate) fn is_sound(&self, space: &Space) -> bool {
        let len = self.costs.len();
        let mut slots = self.order.clone();
        slots.sort_unstable();
        (self.n, self.n_user) == (space.n_free(), space.n())
            && self.u.len() == len * self.n
            && self.x.len() == len * self.n_user
            && self.u.iter().chain(&self.x).all(|v| v.is_finite())
            && (0..len).all(|slot| space.bounds().contains(self.x(slot)))
            && self.values.iter().copied().eq(self.costs.iter().map(|cost| cost.value()))
            && self.values.iter().flatten().all(|value| value.is_finite())
            && !self.costs.iter().any(|cost| matches!(cost, Cost::Infeasible(v) if v.is_nan() || *v <= 0.0))
            && slots.into_iter().eq(0..len)
    }
}
