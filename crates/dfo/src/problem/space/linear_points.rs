//! Points of a space with linear constraints: feasibility, nearest feasible points, and steps that end at a
//! constraint.

use super::coordinates::Space;
use super::linear_set::Dependent;
use crate::problem::constraints::quadratic_program::{self, HalfSpace, Solution};

/// Contradictions between equalities below this fraction of their terms are rounding errors of the user's
/// numbers.
pub(super) const SAME: f64 = 1e-9;

impl Space {
    /// Returns the rows and the finite bounds in units of the sizes.
    pub(super) fn scaled_rows(&self) -> Vec<HalfSpace> {
        let n = self.n_free();
        let rows = self.linear.rows.iter().map(|HalfSpace { normal, limit }| HalfSpace {
            normal: normal.iter().zip(&self.sizes).map(|(a, size)| a * size).collect(),
            limit: *limit,
        });
        let bounds = (0..n).flat_map(|k| [(k, 1.0, self.upper[k]), (k, -1.0, -self.lower[k])]);
        let bounds = bounds.filter(|(.., limit)| limit.is_finite()).map(|(k, sign, limit)| {
            let mut normal = vec![0.0; n];
            normal[k] = sign;
            HalfSpace { normal, limit: limit / self.sizes[k] }
        });
        rows.chain(bounds).collect()
    }

    /// True if there are linear constraints beyond bounds.
    pub(crate) fn has_linear(&self) -> bool {
        !self.linear.is_empty()
    }

    /// Returns the linear inequalities over the working coordinates. Bounds are not among them.
    pub(crate) fn rows(&self) -> &[HalfSpace] {
        &self.linear.rows
    }

    /// Returns the user's constraint that a row comes from; `None` for the bounds of a dependent parameter.
    pub(crate) fn origin_of_row(&self, row: usize) -> Option<usize> {
        self.linear.origins[row]
    }

    /// Returns the distance by which the limit of the constraint moves per unit of the limit of the row.
    pub(crate) fn limit_slope(&self, row: usize, x: &[f64]) -> f64 {
        let first = self.linear.rows[row].normal.iter().position(|a| *a > 0.0);
        match (self.linear.ratios.get(row).copied().flatten(), first) {
            (Some(coefficient), Some(k)) => coefficient * x[self.free[k]],
            _ => 1.0,
        }
    }

    /// Returns a point inside all rows and bounds, in working coordinates; empty without rows.
    pub(crate) fn interior(&self) -> &[f64] {
        &self.linear.interior
    }

    /// True if a point in the bounds satisfies all rows, without a tolerance.
    pub(crate) fn satisfies_rows(&self, u: &[f64]) -> bool {
        self.linear.rows.iter().all(|row| row.contains(u))
    }

    /// True if a point is in the bounds and satisfies all rows, without a tolerance.
    pub(crate) fn holds(&self, u: &[f64]) -> bool {
        let in_bounds = |(k, v): (usize, &f64)| {
            let (lower, upper) = self.working_bounds(k);
            lower <= *v && *v <= upper
        };
        u.iter().enumerate().all(in_bounds) && self.satisfies_rows(u)
    }

    /// True if a point given by the user is in the bounds and satisfies the linear constraints up to
    /// rounding.
    pub(crate) fn admits(&self, x: &[f64]) -> bool {
        let mut u = vec![0.0; self.n_free()];
        self.to_working(x, &mut u);
        let mut back = x.to_vec();
        self.to_user(&u, &mut back);
        let same = |(x, y): (&f64, &f64)| (x - y).abs() <= SAME * x.abs().max(y.abs());
        let close = |row: &HalfSpace| row.value(&u) - row.limit <= SAME * row.magnitude(&u);
        self.bounds.contains(x)
            && self.linear.rows.iter().all(close)
            && (self.linear.dependents.is_empty() || x.iter().zip(&back).all(same))
    }

    /// Moves a point to the nearest feasible one, in units of the sizes. Does nothing without rows or if the
    /// point is feasible.
    pub(crate) fn restore(&self, u: &mut [f64]) {
        if self.linear.rows.is_empty() {
            return;
        }
        for (k, u) in u.iter_mut().enumerate() {
            *u = if u.is_finite() { u.clamp(self.lower[k], self.upper[k]) } else { self.linear.interior[k] };
        }
        if self.satisfies_rows(u) {
            return;
        }
        let z: Vec<f64> = u.iter().zip(&self.sizes).map(|(u, size)| u / size).collect();
        match nearest(&z, &self.scaled_rows(), 0.0) {
            Some(z) => {
                for (k, u) in u.iter_mut().enumerate() {
                    *u = (z[k] * self.sizes[k]).clamp(self.lower[k], self.upper[k]);
                }
            }
            None => u.copy_from_slice(&self.linear.interior),
        }
        self.pull_inside(u);
    }

    /// Shortens the way from a feasible point to `u` so that it ends at the first row that it meets. A row
    /// that the way violates only by rounding does not shorten it, because the way may run along this row.
    /// Does nothing without rows or if the point is feasible.
    pub(crate) fn shorten(&self, from: &[f64], u: &mut [f64]) {
        if self.satisfies_rows(u) {
            return;
        }
        let mut share = 1.0f64;
        for row in &self.linear.rows {
            let (here, there) = (row.value(from), row.value(u));
            let rounding = quadratic_program::ROUNDING * row.magnitude(from).max(row.magnitude(u));
            // This form of the comparison counts NaN as a violation.
            let is_met = there - row.limit <= rounding;
            if !is_met {
                share = share.min(((row.limit - here) / (there - here)).max(0.0));
            }
        }
        if !share.is_finite() {
            share = 0.0;
        }
        if share < 1.0 {
            u.iter_mut().zip(from).for_each(|(u, from)| *u = from + share * (*u - from));
        }
        self.pull_inside(u);
    }

    /// Moves a point that violates a row by rounding towards the interior.
    fn pull_inside(&self, u: &mut [f64]) {
        let mut share = f64::EPSILON;
        while !self.satisfies_rows(u) && share < 1.0 {
            for (u, inside) in u.iter_mut().zip(&self.linear.interior) {
                *u += share * (inside - *u);
            }
            share *= 4.0;
        }
    }

    /// Sets the dependent parameters of a point.
    pub(super) fn set_dependents(&self, u: &[f64], x: &mut [f64]) {
        for Dependent { index, constant, coefficients } in &self.linear.dependents {
            let value = constant + coefficients.iter().zip(u).map(|(c, u)| c * u).sum::<f64>();
            x[*index] = value.clamp(self.bounds.lower()[*index], self.bounds.upper()[*index]);
        }
    }

    /// Returns the dependent parameters: index, and the coefficients of the free parameters, in their order.
    pub(crate) fn dependents(&self) -> impl ExactSizeIterator<Item = (usize, &[f64])> {
        self.linear.dependents.iter().map(|d| (d.index, &d.coefficients[..]))
    }

    /// Returns constraints and dependent parameters as text, for a fingerprint. Empty without constraints.
    pub(super) fn describe_linear(&self) -> Option<(String, String)> {
        let Self { linear, .. } = self;
        let rows = linear.rows.iter().map(|row| (&row.normal, row.limit));
        let dependents = linear.dependents.iter().map(|d| (d.index, d.constant, &d.coefficients));
        let text = || format!("{:?} {:?}", rows.collect::<Vec<_>>(), dependents.collect::<Vec<_>>());
        (!linear.is_empty()).then(|| ("linear constraints".to_owned(), text()))
    }
}

/// Returns the nearest point that has this distance from all rows.
pub(super) fn nearest(z: &[f64], rows: &[HalfSpace], distance: f64) -> Option<Vec<f64>> {
    let gradient: Vec<f64> = z.iter().map(|z| -z).collect();
    let moved: Vec<HalfSpace> = rows
        .iter()
        .map(|HalfSpace { normal, limit }| {
            let length = normal.iter().map(|a| a * a).sum::<f64>().sqrt();
            HalfSpace { normal: normal.clone(), limit: limit - distance * length }
        })
        .collect();
    let Solution { x, .. } =
        quadratic_program::minimize(&quadratic_program::identity(z.len())?, &gradient, &moved)?;
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::constraints::LinearConstraint;
    use crate::problem::space::Bounds;

    const INF: f64 = f64::INFINITY;

    fn below(coefficients: &[f64], upper: f64) -> LinearConstraint {
        LinearConstraint { coefficients: coefficients.to_vec(), lower: -INF, upper }
    }

    fn space(x0: &[f64], lower: &[f64], upper: &[f64]) -> Space {
        Space::new(x0, Bounds::new(lower, upper).unwrap(), &[], &[]).unwrap()
    }

    /// A step along a row at its start is not shortened by the rounding errors of this row.
    #[test]
    fn steps_along_a_row_keep_their_length() {
        let rows = [below(&[-3.0, -2.0], 5.0)];
        let space = space(&[0.0; 2], &[-INF; 2], &[INF; 2]).with_linear(&rows).unwrap();
        let mut n_violated = 0;
        for k in 0..1000 {
            let (start, share) = (0.01 * f64::from(k), 0.3 + 1e-3 * f64::from(k));
            // Both points are on the row.
            let mut from = [start, (-5.0 - 3.0 * start) / 2.0];
            space.restore(&mut from);
            let wanted = [from[0] - share * 2e-3, from[1] + share * 3e-3];
            let mut end = wanted;
            n_violated += usize::from(!space.satisfies_rows(&end));
            space.shorten(&from, &mut end);
            let error = (end[0] - wanted[0]).abs() + (end[1] - wanted[1]).abs();
            assert!(space.satisfies_rows(&end) && error < 1e-12, "{from:?} {wanted:?} {end:?}");
        }
        assert!(n_violated > 100, "{n_violated}");
    }

    /// Points brought inside are exactly inside, and nearest points satisfy the optimality conditions.
    #[test]
    fn restored_and_shortened_points_satisfy_all_rows_exactly() {
        let mut state = 5u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        for case in 0..300 {
            let n = 2 + case % 5;
            let size: Vec<f64> = (0..n).map(|k| 10f64.powi((k as i32 % 3) * 4 - 4)).collect();
            let lower: Vec<f64> = size.iter().map(|size| -size).collect();
            // All rows contain the origin.
            let rows: Vec<LinearConstraint> = (0..1 + case % 7)
                .map(|_| {
                    let a: Vec<f64> = size.iter().map(|size| random() / size).collect();
                    below(&a, 0.3 * (random() + 0.6))
                })
                .collect();
            let x0: Vec<f64> = size.iter().map(|size| size * random()).collect();
            let space = space(&x0, &lower, &size).with_linear(&rows).unwrap();
            for _ in 0..20 {
                let mut u: Vec<f64> = size.iter().map(|size| 4.0 * size * random()).collect();
                let mut v = u.clone();
                space.restore(&mut u);
                (0..n).for_each(|k| v[k] = v[k].clamp(lower[k], size[k]));
                let wanted = v.clone();
                space.shorten(space.interior(), &mut v);
                for point in [&u, &v] {
                    assert!(space.satisfies_rows(point) && space.bounds().contains(point), "case {case}");
                    let inside = |row: &LinearConstraint| {
                        row.coefficients.iter().zip(point.iter()).map(|(a, x)| a * x).sum::<f64>()
                            <= row.upper
                    };
                    assert!(rows.iter().all(inside), "case {case}");
                }
                let distance = |u: &[f64]| {
                    (0..n).map(|k| ((u[k] - wanted[k]) / space.size(k)).powi(2)).sum::<f64>().sqrt()
                };
                assert!(distance(&u) <= distance(&v) * (1.0 + 1e-9) + 1e-12, "case {case}");
            }
        }
    }
}
