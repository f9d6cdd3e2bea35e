//! Ranked points as a simplex: centroid, replacement, shrink and size. Independent of batches.

use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use crate::values::choices::ToleranceMeasure;

impl RankedPoints {
    /// Recomputes the working coordinates of all vertices for another space.
    pub(super) fn rewrite(&mut self, space: &Space) {
        for slot in 0..self.len() {
            let Self { n, n_user, u, x, .. } = self;
            space.to_working(&x[slot * *n_user..][..*n_user], &mut u[slot * *n..][..*n]);
        }
    }

    /// Returns the slot of the last rank but one (the best, in one dimension).
    pub(super) fn second_worst(&self) -> usize {
        self.order[self.n.saturating_sub(1)]
    }

    /// Ranks all vertices. Equal costs keep their order (insertion sort: stable, without allocation).
    pub(super) fn sort(&mut self) {
        for i in 1..self.order.len() {
            let mut k = i;
            while k > 0 && self.costs[self.order[k]].better_than(self.costs[self.order[k - 1]]) {
                self.order.swap(k, k - 1);
                k -= 1;
            }
        }
    }

    /// Replaces the worst vertex. The new vertex ranks after all older ones of equal cost.
    pub(super) fn replace_worst(&mut self, u: &[f64], x: &[f64], value: f64) {
        let slot = self.worst();
        self.set(slot, u, x);
        self.set_cost(slot, Cost::Value(value));
        let mut k = self.n;
        while k > 0 && self.costs[slot].better_than(self.costs[self.order[k - 1]]) {
            self.order.swap(k, k - 1);
            k -= 1;
        }
    }

    /// Computes the centroid of all vertices except the worst and failed ones. The sum follows the order of
    /// the slots, so the centroid can be computed before the ranks are known.
    pub(super) fn centroid(&self, out: &mut [f64]) {
        let counts = |slot: &usize| *slot != self.worst() && self.costs[*slot].value().is_some();
        Self::centroid_of((0..=self.n).filter(counts).map(|slot| self.u(slot)), out);
    }

    /// Computes the centroid of points, summed in their order.
    pub(super) fn centroid_of<'a>(points: impl Iterator<Item = &'a [f64]>, out: &mut [f64]) {
        out.fill(0.0);
        let mut count = 0.0;
        for u in points {
            count += 1.0;
            out.iter_mut().zip(u).for_each(|(c, u)| *c += u);
        }
        out.iter_mut().for_each(|c| *c /= count);
    }

    /// True if a vertex other than the worst is exactly at `u`.
    pub(super) fn has_vertex(&self, u: &[f64]) -> bool {
        self.order[..self.n].iter().any(|&slot| self.u(slot) == u)
    }

    /// Moves all vertices except the best towards the best. Their costs become unknown.
    pub(super) fn shrink(&mut self, factor: f64, space: &Space) {
        let best = self.best();
        for rank in 1..=self.n {
            let slot = self.order[rank];
            for k in 0..self.n {
                let b = self.u[best * self.n + k];
                let (lower, upper) = space.working_bounds(k);
                let u = &mut self.u[slot * self.n + k];
                let drawn = b + factor * (*u - b);
                // The distance may overflow.
                let drawn = if drawn.is_finite() { drawn } else { (1.0 - factor) * b + factor * *u };
                *u = drawn.clamp(lower, upper);
            }
            if !space.satisfies_rows(self.u(slot)) {
                // Only by rounding.
                space.restore(self.u_mut(slot));
            }
            let (u, x) =
                (&self.u[slot * self.n..][..self.n], &mut self.x[slot * self.n_user..][..self.n_user]);
            space.to_user(u, x);
            self.set_cost(slot, Cost::Pending);
        }
    }

    /// Returns the largest distance of a vertex from the best along any coordinate, as measured by the x
    /// test.
    pub(super) fn x_size(&self, space: &Space, measure: ToleranceMeasure) -> f64 {
        let extent = |(k, &i): (usize, &usize)| {
            let pair = |slot: usize| (self.u(slot)[k], self.x(slot)[i]);
            space.extent(k, pair(self.best()), self.order[1..].iter().map(|s| pair(*s)), measure)
        };
        space.free().iter().enumerate().map(extent).fold(0.0, f64::max)
    }

    /// Returns the largest distance of a vertex from the best in units of the sizes of the working
    /// coordinates.
    pub(super) fn relative_size(&self, space: &Space) -> f64 {
        let best = self.u(self.best());
        let distance = |slot: &usize| {
            (0..self.n).map(|k| (self.u(*slot)[k] - best[k]).abs() / space.size(k)).fold(0.0, f64::max)
        };
        self.order[1..].iter().map(distance).fold(0.0, f64::max)
    }

    /// Returns the smallest nonzero |cost|, or 0 if there is none. For the initial vertices, this is the cost
    /// at the start or at a better neighbour. A first step that is far too long, with a huge cost, has no
    /// effect.
    pub(super) fn smallest_cost(&self) -> f64 {
        let sizes = self.values.iter().flatten().map(|cost| cost.abs()).filter(|size| *size > 0.0);
        sizes.min_by(f64::total_cmp).unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;

    fn simplex(costs: [Cost; 3]) -> RankedPoints {
        let space = Space::new(&[0.0, 0.0], Bounds::unbounded(2), &[], &[]).unwrap();
        let mut s = RankedPoints::new(&space, 3);
        for (slot, (p, cost)) in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].into_iter().zip(costs).enumerate() {
            s.set(slot, &p, &p);
            s.set_cost(slot, cost);
        }
        s.sort();
        s
    }

    #[test]
    fn ranks_are_total_and_stable() {
        use Cost::{Failed, Pending, Value};
        assert_eq!(simplex([Value(2.0), Value(1.0), Value(1.0)]).order(), [1, 2, 0]);
        assert_eq!(simplex([Failed, Value(1e300), Failed]).order(), [1, 0, 2]);
        assert_eq!(simplex([Pending, Failed, Value(0.0)]).order(), [2, 1, 0]);
        let mut s = simplex([Value(1.0), Value(2.0), Failed]);
        s.replace_worst(&[5.0, 5.0], &[5.0, 5.0], 1.0);
        assert_eq!((s.order(), s.worst()), (&[0, 2, 1][..], 1));
    }

    #[test]
    fn centroid_ignores_failed_vertices() {
        use Cost::{Failed, Value};
        let mut c = [0.0; 2];
        simplex([Value(1.0), Value(2.0), Value(3.0)]).centroid(&mut c);
        assert_eq!(c, [0.5, 0.0]);
        simplex([Failed, Value(2.0), Failed]).centroid(&mut c);
        assert_eq!(c, [1.0, 0.0]);
    }

    #[test]
    fn smallest_cost_ignores_huge_and_zero_costs() {
        use Cost::Value;
        assert_eq!(simplex([Value(1e300), Value(-2.0), Value(0.0)]).smallest_cost(), 2.0);
    }
}
