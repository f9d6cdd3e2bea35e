//! Ranked points as the population of an evolutionary method: placement, ranking, tests and replacement of
//! members.

use crate::method_interface::interface::Setup;
use crate::method_interface::tolerances::{TestedSet, ToleranceTests, Tolerances, typical};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use crate::values::choices::ParameterKind;
use crate::values::choices::ToleranceMeasure;
use std::cmp::Ordering;

/// Maximum number of members. Larger values are assumed to be mistakes.
pub(crate) const MAX_MEMBERS: usize = 1_000_000;

impl RankedPoints {
    /// Places a member with an unknown cost.
    pub(crate) fn place(&mut self, slot: usize, u: &[f64], space: &Space) {
        self.u_mut(slot).copy_from_slice(u);
        space.to_user(u, self.x_mut(slot));
        self.set_cost(slot, Cost::Pending);
    }

    /// Places a member exactly at a point in the user's units, without rounding by the working coordinates.
    pub(crate) fn place_exactly(&mut self, slot: usize, x: &[f64], space: &Space) {
        space.to_working(x, self.u_mut(slot));
        self.x_mut(slot).copy_from_slice(x);
        if !space.satisfies_rows(self.u(slot)) {
            // Only by rounding, because given points satisfy the linear constraints up to rounding.
            space.restore(self.u_mut(slot));
            let u = self.u(slot).to_vec();
            space.to_user(&u, self.x_mut(slot));
        }
        self.set_cost(slot, Cost::Pending);
    }

    /// Replaces the first sampled members by known points. The start point comes first, if requested and
    /// given. The best points of an earlier run follow, up to half of the members. Returns the number of
    /// replaced members.
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

    /// Copies a member with its cost from other points.
    pub(crate) fn copy_from(&mut self, slot: usize, other: &Self, from: usize) {
        self.set(slot, other.u(from), other.x(from));
        self.set_cost(slot, other.cost(from));
    }

    /// Ranks all members. Members with equal costs rank by slot.
    pub(crate) fn rank(&mut self) {
        let costs = &self.costs;
        self.order.sort_unstable_by(|&a, &b| in_rank(costs, a, b));
    }

    /// Updates the ranks if only the member in `slot` has changed since the last ranking.
    pub(crate) fn rank_again(&mut self, slot: usize) {
        self.order.retain(|other| *other != slot);
        let costs = &self.costs;
        let rank = self.order.partition_point(|&other| in_rank(costs, other, slot).is_lt());
        self.order.insert(rank, slot);
    }

    /// Keeps the `len` best members. Members in the first `len` slots keep their slots. The other kept
    /// members move to the slots of removed members, in the order of the slots. Requires up-to-date ranks,
    /// and updates them.
    pub(crate) fn keep_best(&mut self, len: usize) {
        if self.order.len() <= len {
            return;
        }
        let (stay, go) = self.order.split_at_mut(len);
        stay.sort_unstable();
        go.sort_unstable();
        let from = stay.partition_point(|slot| *slot < len);
        for (&from, &to) in stay[from..].iter().zip(go.iter()) {
            self.u.copy_within(from * self.n..(from + 1) * self.n, to * self.n);
            self.x.copy_within(from * self.n_user..(from + 1) * self.n_user, to * self.n_user);
            self.costs[to] = self.costs[from];
            self.values[to] = self.values[from];
        }
        self.resize(len);
        self.rank();
    }

    /// Changes the number of members without ranking. New members are not placed.
    pub(crate) fn resize(&mut self, len: usize) {
        self.u.resize(len * self.n, 0.0);
        self.x.resize(len * self.n_user, 0.0);
        self.costs.resize(len, Cost::Pending);
        self.values.resize(len, None);
        self.order.clear();
        self.order.extend(0..len);
    }

    /// Replaces the worst member by a member of another population, if the new member is better and at a new
    /// point.
    pub(crate) fn take_better(&mut self, from: &Self, member: usize) {
        let worst = self.worst();
        let is_new = || (0..self.len()).all(|slot| self.x(slot) != from.x(member));
        if from.costs[member].better_than(self.costs[worst]) && is_new() {
            self.copy_from(worst, from, member);
            self.rank();
        }
    }

    /// Applies the tolerance tests to a part of the population, best first. The tests use the largest
    /// distance of a member from the best, and the largest minus the smallest cost.
    pub(crate) fn judge(
        &self,
        extent: TestedSet,
        space: &Space,
        tolerances: &Tolerances,
        f_0: f64,
    ) -> ToleranceTests {
        let is_same = |slot: &usize| {
            let mut integers =
                space.free().iter().enumerate().filter(|(k, _)| space.kind(*k) != ParameterKind::Continuous);
            integers.all(|(_, &i)| self.x(*slot)[i] == self.x(self.best())[i])
        };
        let same: Vec<usize> = match extent {
            TestedSet::SameIntegers => self.order.iter().copied().filter(is_same).collect(),
            _ => Vec::new(),
        };
        let counted = match extent {
            // A single member has no other member to compare with.
            TestedSet::BestEighth => &self.order[..self.len().div_ceil(8).max(2).min(self.len())],
            TestedSet::SameIntegers if same.len() > 1 => &same,
            _ => &self.order[..],
        };
        let best = self.best();
        let mut size = 0.0f64;
        for &slot in counted {
            for (k, &i) in space.free().iter().enumerate() {
                size = size.max(match tolerances.measure {
                    ToleranceMeasure::Absolute => (self.x(slot)[i] - self.x(best)[i]).abs(),
                    ToleranceMeasure::Relative if space.kind(k) == ParameterKind::Continuous => {
                        (self.u(slot)[k] - self.u(best)[k]).abs() / space.size(k)
                    }
                    // Differences between working coordinates that round to one integer are irrelevant.
                    ToleranceMeasure::Relative => (self.x(slot)[i] - self.x(best)[i]).abs() / space.size(k),
                });
            }
        }
        let f_best = self.costs[best].value().unwrap_or(f64::NAN);
        ToleranceTests { extent, ..tolerances.judge(size, self.f_spread(counted), f_best, f_0) }
    }

    /// Returns the typical size of the costs.
    pub(crate) fn typical_cost(&self) -> f64 {
        typical(&self.values)
    }
}

/// Compares two slots by rank.
fn in_rank(costs: &[Cost], a: usize, b: usize) -> Ordering {
    if costs[a].better_than(costs[b]) {
        Ordering::Less
    } else if costs[b].better_than(costs[a]) {
        Ordering::Greater
    } else {
        a.cmp(&b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;

    fn population(costs: &[Cost]) -> (Space, RankedPoints) {
        let space = Space::new(&[0.5], Bounds::new(&[0.0], &[10.0]).unwrap(), &[], &[]).unwrap();
        let mut p = RankedPoints::new(&space, costs.len());
        for (slot, cost) in costs.iter().enumerate() {
            p.place(slot, &[slot as f64], &space);
            p.set_cost(slot, *cost);
        }
        p.rank();
        (space, p)
    }

    #[test]
    fn keep_best_drops_the_worst_and_keeps_slots() {
        use Cost::{Failed, Value};
        let (space, mut p) = population(&[Value(3.0), Failed, Value(1.0), Value(2.0), Failed]);
        assert_eq!((p.order(), p.n_finite()), (&[2, 3, 0, 1, 4][..], 3));
        p.keep_best(3);
        assert_eq!(p.order(), [2, 1, 0]);
        assert_eq!(
            [0, 1, 2].map(|s| (p.u(s)[0], p.cost(s))),
            [(0.0, Value(3.0)), (3.0, Value(2.0)), (2.0, Value(1.0))]
        );
        assert!(p.is_sound(&space));
        for (slot, cost, order) in
            [(0, 0.5, [0, 2, 1]), (0, 9.0, [2, 1, 0]), (1, 1.0, [1, 2, 0]), (2, 1.0, [1, 2, 0])]
        {
            p.set_cost(slot, Value(cost));
            p.rank_again(slot);
            assert_eq!(p.order(), order);
        }
    }

    #[test]
    fn f_test_does_not_pass_when_a_member_has_failed() {
        use Cost::{Failed, Value};
        let tolerances = Tolerances::default();
        let (space, p) = population(&[Value(1.0), Failed]);
        assert_eq!(p.judge(TestedSet::Population, &space, &tolerances, 1.0).f_spread, None);
        let (space, p) = population(&[Value(1.0), Value(1.5), Value(4.0)]);
        let tests = p.judge(TestedSet::Population, &space, &tolerances, 1.0);
        assert_eq!((tests.f_spread, tests.x_size, tests.f_best), (Some(3.0), 0.2, 1.0));
        assert!(
            !p.is_collapsed(&space) && tests.to_string().starts_with("x test not passed: population size")
        );
    }
}
