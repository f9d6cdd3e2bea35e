//! Ranked points as the population of an evolutionary method: how members are placed, ranked, judged and
//! replaced.

use crate::method_interface::interface::Setup;
use crate::method_interface::tolerances::{TestedSet, ToleranceTests, Tolerances, typical};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use crate::values::choices::ParameterKind;
use crate::values::choices::ToleranceMeasure;
use std::cmp::Ordering;

/// More members than this are a mistake, not a wish.
pub(crate) const MAX_MEMBERS: usize = 1_000_000;

impl RankedPoints {
    /// Places a member; its cost is unknown then.
    pub(crate) fn place(&mut self, slot: usize, u: &[f64], space: &Space) {
        self.u_mut(slot).copy_from_slice(u);
        space.to_user(u, self.x_mut(slot));
        self.set_cost(slot, Cost::Pending);
    }

    /// Places a member exactly at a point of the user's, whatever the working coordinates make of it.
    pub(crate) fn place_exactly(&mut self, slot: usize, x: &[f64], space: &Space) {
        space.to_working(x, self.u_mut(slot));
        self.x_mut(slot).copy_from_slice(x);
        self.set_cost(slot, Cost::Pending);
    }

    /// Puts what is known in the place of the first sampled members: the start point, if wanted and given,
    /// then the best points of an earlier run, at most half of the members. Returns how many.
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
        self.set(slot, other.u(from), other.x(from));
        self.set_cost(slot, other.cost(from));
    }

    /// Ranks all members anew; members of the same cost rank by slot.
    pub(crate) fn rank(&mut self) {
        let costs = &self.costs;
        self.order.sort_unstable_by(|&a, &b| in_rank(costs, a, b));
    }

    /// The same where only this member has changed since the last ranking.
    pub(crate) fn rank_again(&mut self, slot: usize) {
        self.order.retain(|other| *other != slot);
        let costs = &self.costs;
        let rank = self.order.partition_point(|&other| in_rank(costs, other, slot).is_lt());
        self.order.insert(rank, slot);
    }

    /// Keeps the `len` best members. Those in the first `len` slots stay there; those beyond take the slots
    /// of members that go, in the order of the slots. Needs up-to-date ranks, and leaves them.
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
        let worst = self.worst();
        let is_new = || (0..self.len()).all(|slot| self.x(slot) != from.x(member));
        if from.costs[member].better_than(self.costs[worst]) && is_new() {
            self.copy_from(worst, from, member);
            self.rank();
        }
    }

    /// The tolerance tests over so much of the population, the best first: largest distance of a member from
    /// the best, largest minus smallest cost.
    pub(crate) fn judge(
        &self,
        extent: TestedSet,
        space: &Space,
        tolerances: &Tolerances,
        f_0: f64,
    ) -> ToleranceTests {
        let counted = match extent {
            // One member alone has nothing to be compared with.
            TestedSet::BestEighth => &self.order[..self.len().div_ceil(8).max(2).min(self.len())],
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
                    // What members that stand for one whole number differ by means nothing.
                    ToleranceMeasure::Relative => (self.x(slot)[i] - self.x(best)[i]).abs() / space.size(k),
                });
            }
        }
        let f_best = self.costs[best].value().unwrap_or(f64::NAN);
        ToleranceTests { extent, ..tolerances.judge(size, self.f_spread(counted), f_best, f_0) }
    }

    /// Typical size of the costs.
    pub(crate) fn typical_cost(&self) -> f64 {
        typical(&self.values)
    }
}

/// How two slots compare by rank.
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
    fn the_worst_leave_and_the_rest_keep_their_slots() {
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
    fn a_failed_member_keeps_the_f_test_from_passing() {
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
