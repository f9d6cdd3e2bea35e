//! The members of an evolutionary method: points, costs, ranks, spread. Knows nothing of how they came about.

use crate::choices::Kind;
use crate::choices::Measure;
use crate::method::{Setup, SimplexView};
use crate::methods::shared::cost::Cost;
use crate::space::Space;
use crate::tolerances::{Extent, Tests, Tolerances, typical};
use serde::{Deserialize, Serialize};

/// More members than this are a mistake, not a wish.
pub(crate) const MAX_MEMBERS: usize = 1_000_000;

/// Members in slots, and the slots by rank.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Population {
    n: usize,
    n_user: usize,
    u: Vec<f64>,
    x: Vec<f64>,
    costs: Vec<Cost>,
    /// The same for people: kept beside so that a view can lend it.
    values: Vec<Option<f64>>,
    /// Slots, best first, as of the last [`rank`](Self::rank).
    order: Vec<usize>,
}

impl Population {
    /// So many members, none of them placed.
    pub(crate) fn new(space: &Space, len: usize) -> Self {
        let (n, n_user) = (space.n_free(), space.n());
        Self {
            n,
            n_user,
            u: vec![0.0; len * n],
            x: vec![0.0; len * n_user],
            costs: vec![Cost::Pending; len],
            values: vec![None; len],
            order: (0..len).collect(),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.costs.len()
    }

    /// Working coordinates of a member.
    pub(crate) fn u(&self, slot: usize) -> &[f64] {
        &self.u[slot * self.n..(slot + 1) * self.n]
    }

    /// Member in the user's units.
    pub(crate) fn x(&self, slot: usize) -> &[f64] {
        &self.x[slot * self.n_user..(slot + 1) * self.n_user]
    }

    pub(crate) fn cost(&self, slot: usize) -> Cost {
        self.costs[slot]
    }

    /// Places a member; its cost is unknown then.
    pub(crate) fn place(&mut self, slot: usize, u: &[f64], space: &Space) {
        self.u[slot * self.n..(slot + 1) * self.n].copy_from_slice(u);
        space.to_user(u, &mut self.x[slot * self.n_user..(slot + 1) * self.n_user]);
        self.set_cost(slot, Cost::Pending);
    }

    /// Places a member exactly at a point of the user's, whatever the working coordinates make of it.
    pub(crate) fn place_exactly(&mut self, slot: usize, x: &[f64], space: &Space) {
        space.to_working(x, &mut self.u[slot * self.n..(slot + 1) * self.n]);
        self.x[slot * self.n_user..(slot + 1) * self.n_user].copy_from_slice(x);
        self.set_cost(slot, Cost::Pending);
    }

    /// Puts what is known in the place of the first sampled members: the start point, if wanted and given, then the
    /// best points of an earlier run, at most half of the members. Returns how many.
    pub(crate) fn seed_with(&mut self, setup: &Setup, include_start: bool) -> usize {
        let space = &setup.space;
        let mut next = 0;
        if include_start && setup.start_given {
            self.place_exactly(0, space.x0(), space);
            next = 1;
        }
        for x in &setup.prior {
            if next < self.len().div_ceil(2) && (0..next).all(|slot| self.x(slot) != x) {
                self.place_exactly(next, x, space);
                next += 1;
            }
        }
        next
    }

    /// Takes over a member, cost and all.
    pub(crate) fn copy_from(&mut self, slot: usize, other: &Self, from: usize) {
        self.u[slot * self.n..(slot + 1) * self.n].copy_from_slice(other.u(from));
        self.x[slot * self.n_user..(slot + 1) * self.n_user].copy_from_slice(other.x(from));
        self.set_cost(slot, other.cost(from));
    }

    pub(crate) fn set_cost(&mut self, slot: usize, cost: Cost) {
        self.costs[slot] = cost;
        self.values[slot] = cost.value();
    }

    pub(crate) fn is_pending(&self) -> bool {
        self.costs.contains(&Cost::Pending)
    }

    /// Ranks all members anew; members of the same cost rank by slot.
    pub(crate) fn rank(&mut self) {
        let costs = &self.costs;
        self.order.sort_unstable_by(|&a, &b| {
            if costs[a].better_than(costs[b]) {
                std::cmp::Ordering::Less
            } else if costs[b].better_than(costs[a]) {
                std::cmp::Ordering::Greater
            } else {
                a.cmp(&b)
            }
        });
    }

    /// Slots, best first.
    pub(crate) fn order(&self) -> &[usize] {
        &self.order
    }

    pub(crate) fn best(&self) -> usize {
        self.order[0]
    }

    /// Number of members with a finite cost.
    pub(crate) fn n_finite(&self) -> usize {
        self.values.iter().flatten().count()
    }

    /// Keeps the `len` best members, in the order of their slots. Needs up-to-date ranks, and leaves them.
    pub(crate) fn keep_best(&mut self, len: usize) {
        if self.order.len() <= len {
            return;
        }
        // Pending stands for members that go; the others move up.
        for &slot in &self.order[len..] {
            self.costs[slot] = Cost::Pending;
        }
        let mut kept = 0;
        for slot in 0..self.costs.len() {
            if self.costs[slot] != Cost::Pending {
                self.u.copy_within(slot * self.n..(slot + 1) * self.n, kept * self.n);
                self.x.copy_within(slot * self.n_user..(slot + 1) * self.n_user, kept * self.n_user);
                self.costs[kept] = self.costs[slot];
                self.values[kept] = self.values[slot];
                kept += 1;
            }
        }
        self.resize(kept);
        self.rank();
    }

    /// Changes the number of members without looking at them; new ones are not placed.
    pub(crate) fn resize(&mut self, len: usize) {
        self.u.resize(len * self.n, 0.0);
        self.x.resize(len * self.n_user, 0.0);
        self.costs.resize(len, Cost::Pending);
        self.values.resize(len, None);
        self.order.clear();
        self.order.extend(0..len);
    }

    /// Takes a member of another population in place of the worst, if it is better and at a point of its own.
    pub(crate) fn take_better(&mut self, from: &Self, member: usize) {
        let worst = self.order[self.len() - 1];
        let is_new = || (0..self.len()).all(|slot| self.x(slot) != from.x(member));
        if from.costs[member].better_than(self.costs[worst]) && is_new() {
            self.copy_from(worst, from, member);
            self.rank();
        }
    }

    /// The tolerance tests over so much of the population, the best first: largest distance of a member from the best,
    /// largest minus smallest cost.
    pub(crate) fn judge(&self, extent: Extent, space: &Space, tolerances: &Tolerances, f_0: f64) -> Tests {
        let counted = match extent {
            // One member alone has nothing to be compared with.
            Extent::BestEighth => &self.order[..self.len().div_ceil(8).max(2).min(self.len())],
            Extent::Population | Extent::Simplex | Extent::BestSeen => &self.order[..],
        };
        let best = self.best();
        let mut size = 0.0f64;
        for &slot in counted {
            for (k, &i) in space.free().iter().enumerate() {
                size = size.max(match tolerances.measure {
                    Measure::Absolute => (self.x(slot)[i] - self.x(best)[i]).abs(),
                    Measure::Relative if space.kind(k) == Kind::Continuous => {
                        (self.u(slot)[k] - self.u(best)[k]).abs() / space.size(k)
                    }
                    // What members that stand for one whole number differ by means nothing.
                    Measure::Relative => (self.x(slot)[i] - self.x(best)[i]).abs() / space.size(k),
                });
            }
        }
        let spread = match (self.costs[best], counted.last().map(|worst| self.costs[*worst])) {
            (Cost::Value(best), Some(Cost::Value(worst))) => Some(worst - best),
            _ => None,
        };
        let f_best = self.costs[best].value().unwrap_or(f64::NAN);
        Tests { extent, ..tolerances.judge(size, spread, f_best, f_0) }
    }

    /// Whether all members are the best one up to rounding.
    pub(crate) fn is_collapsed(&self, space: &Space) -> bool {
        let best = self.u(self.best());
        (0..self.len()).all(|slot| space.is_same(self.u(slot), best))
    }

    /// How large costs are.
    pub(crate) fn typical_cost(&self) -> f64 {
        typical(&self.values)
    }

    pub(crate) fn view(&self) -> SimplexView<'_> {
        SimplexView { n: self.n_user, x: &self.x, costs: &self.values, order: &self.order }
    }

    /// Whether all lists have the lengths that belong together: what comes from a file may not.
    pub(crate) fn is_sound(&self, space: &Space) -> bool {
        let len = self.costs.len();
        let mut slots = self.order.clone();
        slots.sort_unstable();
        (self.n, self.n_user) == (space.n_free(), space.n())
            && self.u.len() == len * self.n
            && self.x.len() == len * self.n_user
            && self.values.len() == len
            && slots.into_iter().eq(0..len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Bounds;

    fn population(costs: &[Cost]) -> (Space, Population) {
        let space = Space::new(&[0.5], Bounds::new(&[0.0], &[10.0]).unwrap(), &[], &[]).unwrap();
        let mut p = Population::new(&space, costs.len());
        for (slot, cost) in costs.iter().enumerate() {
            p.place(slot, &[slot as f64], &space);
            p.set_cost(slot, *cost);
        }
        p.rank();
        (space, p)
    }

    #[test]
    fn the_worst_leave_and_the_rest_keep_their_order() {
        use Cost::{Failed, Value};
        let (space, mut p) = population(&[Value(3.0), Failed, Value(1.0), Value(2.0), Failed]);
        assert_eq!((p.order(), p.n_finite()), (&[2, 3, 0, 1, 4][..], 3));
        p.keep_best(3);
        assert_eq!(p.order(), [1, 2, 0]);
        assert_eq!(
            [0, 1, 2].map(|s| (p.u(s)[0], p.cost(s))),
            [(0.0, Value(3.0)), (2.0, Value(1.0)), (3.0, Value(2.0))]
        );
        assert!(p.is_sound(&space));
    }

    #[test]
    fn a_failed_member_keeps_the_f_test_from_passing() {
        use Cost::{Failed, Value};
        let tolerances = Tolerances::default();
        let (space, p) = population(&[Value(1.0), Failed]);
        assert_eq!(p.judge(Extent::Population, &space, &tolerances, 1.0).f_spread, None);
        let (space, p) = population(&[Value(1.0), Value(1.5), Value(4.0)]);
        let tests = p.judge(Extent::Population, &space, &tolerances, 1.0);
        assert_eq!((tests.f_spread, tests.x_size, tests.f_best), (Some(3.0), 0.2, 1.0));
        assert!(
            !p.is_collapsed(&space) && tests.to_string().starts_with("x test not passed: population size")
        );
    }
}
