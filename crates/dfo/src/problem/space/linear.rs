//! Linear constraints of a space: equalities reduce its dimension, and inequalities become half-spaces of the
//! working coordinates.

use super::bounds::Bounds;
use super::coordinates::{Space, typical_size};
use super::linear_set::{Dependent, LinearSet};
use crate::error::Error;
use crate::problem::constraints::LinearConstraint;
use crate::problem::constraints::quadratic_program::{self, HalfSpace, Solution};
use crate::values::choices::{ParameterKind, Transform};
use nalgebra::DMatrix;

/// Coefficients and pivots below this fraction of the largest one of their row are rounding errors.
const NEGLIGIBLE: f64 = 1e-12;
/// Contradictions between equalities below this fraction of their terms are rounding errors of the user's
/// numbers.
const SAME: f64 = 1e-9;

/// One side of a constraint over all parameters: `coefficients . x <= limit`.
struct Side {
    coefficients: Vec<f64>,
    limit: f64,
    origin: Option<usize>,
}

impl Space {
    /// Adds linear constraints. Each equality removes a free parameter: the value of a *dependent* parameter
    /// follows from the others. A constraint on a single parameter becomes a bound. Parameters with a
    /// logarithmic scale get a linear scale, unless the constraint is a ratio of two of them (`a <= 2 b`).
    /// The start point moves to the nearest feasible point, in units of the sizes.
    ///
    /// # Errors
    /// Returns an error if a constraint contains a discrete parameter, if no point is feasible, or if the
    /// feasible points have no interior.
    pub fn with_linear(self, constraints: &[LinearConstraint]) -> Result<Self, Error> {
        if constraints.is_empty() {
            return Ok(self);
        }
        self.check_kinds(constraints)?;
        let mut space = self.with_linear_scales(constraints);
        // Each turn fixes a parameter.
        while let Some((index, value)) = space.reduce(constraints)? {
            space = space.fixing(index, value)?;
        }
        space.find_interior(constraints)?;
        Ok(space)
    }

    fn check_kinds(&self, constraints: &[LinearConstraint]) -> Result<(), Error> {
        for (constraint, row) in constraints.iter().enumerate() {
            let discrete = |k: &usize| {
                self.kinds[*k] != ParameterKind::Continuous && row.coefficients[self.free[*k]] != 0.0
            };
            if let Some(k) = (0..self.n_free()).find(discrete) {
                let (index, kind) = (self.free[k], self.kinds[k]);
                return Err(Error::DiscreteConstraint { constraint, index, kind });
            }
        }
        Ok(())
    }

    /// Returns the coordinate of a free parameter.
    fn coordinate_of(&self, index: usize) -> Option<usize> {
        self.free.iter().position(|free| *free == index)
    }

    /// Returns the inequalities of a constraint as sides; an equality has none.
    fn sides(constraint: usize, row: &LinearConstraint) -> impl Iterator<Item = Side> + '_ {
        let is_equality = row.lower == row.upper;
        [(1.0, row.upper), (-1.0, -row.lower)]
            .into_iter()
            .filter(move |(_, limit)| limit.is_finite() && !is_equality)
            .map(move |(sign, limit)| Side {
                coefficients: row.coefficients.iter().map(|a| sign * a).collect(),
                limit,
                origin: Some(constraint),
            })
    }

    /// If a side compares multiples of two logarithmic parameters, returns the coordinates `i` and `j` and
    /// the limit of `u[i] - u[j]`.
    fn as_ratio(&self, side: &Side) -> Option<(usize, usize, f64)> {
        let mut terms = (0..side.coefficients.len()).filter(|i| side.coefficients[*i] != 0.0);
        let (Some(i), Some(j), None) = (terms.next(), terms.next(), terms.next()) else { return None };
        let (i, j) = if side.coefficients[i] > 0.0 { (i, j) } else { (j, i) };
        let (a, b) = (side.coefficients[i], side.coefficients[j]);
        let (k, l) = (self.coordinate_of(i)?, self.coordinate_of(j)?);
        let logarithmic = [k, l].iter().all(|k| self.transforms[*k] == Transform::Log);
        (a > 0.0 && b < 0.0 && side.limit == 0.0 && logarithmic).then(|| (k, l, (-b / a).ln()))
    }

    /// Changes the scale of logarithmic parameters whose constraints are linear only in the parameter itself.
    fn with_linear_scales(mut self, constraints: &[LinearConstraint]) -> Self {
        loop {
            let is_linear = |(constraint, row): &(usize, &LinearConstraint)| {
                let is_ratio = row.lower != row.upper
                    && Self::sides(*constraint, row).all(|side| self.as_ratio(&side).is_some());
                let single = row.coefficients.iter().filter(|a| **a != 0.0).count() <= 1;
                !is_ratio && !single
            };
            let rows: Vec<(usize, &LinearConstraint)> =
                constraints.iter().enumerate().filter(is_linear).collect();
            let changes = |k: &usize| {
                self.transforms[*k] == Transform::Log
                    && rows.iter().any(|(_, row)| row.coefficients[self.free[*k]] != 0.0)
            };
            let Some(k) = (0..self.n_free()).find(changes) else { return self };
            let i = self.free[k];
            let (value, limits) = (self.x0[i], (self.bounds.lower()[i], self.bounds.upper()[i]));
            // A size on the logarithmic scale is a relative size.
            let given = self.size_given[k].then(|| self.sizes[k] * value);
            self.transforms[k] = Transform::Linear;
            (self.lower[k], self.upper[k]) = limits;
            self.boxed[k] = (limits.1 - limits.0).is_finite();
            self.sizes[k] = typical_size(Transform::Linear, value, limits, given).unwrap_or(1.0);
        }
    }

    /// Returns this space without constraints and with one parameter fixed.
    fn fixing(self, index: usize, value: f64) -> Result<Self, Error> {
        let (mut lower, mut upper) = (self.bounds.lower().to_vec(), self.bounds.upper().to_vec());
        (lower[index], upper[index]) = (value, value);
        let mut space = Self { bounds: Bounds::new(&lower, &upper)?, ..self };
        space.x0[index] = value;
        if let Some(k) = space.coordinate_of(index) {
            space.remove(k);
        }
        space.linear = LinearSet::default();
        Ok(space)
    }

    /// Removes a working coordinate.
    fn remove(&mut self, k: usize) {
        self.free.remove(k);
        self.transforms.remove(k);
        self.kinds.remove(k);
        self.lower.remove(k);
        self.upper.remove(k);
        self.sizes.remove(k);
        self.size_given.remove(k);
        self.size_unknown.remove(k);
        self.boxed.remove(k);
        self.far.remove(k);
    }

    /// Eliminates the equalities and forms the rows of the inequalities. Returns a parameter that the
    /// constraints fix, with its value; the caller then starts again.
    fn reduce(&mut self, constraints: &[LinearConstraint]) -> Result<Option<(usize, f64)>, Error> {
        let dependents = self.eliminate(constraints)?;
        let mut sides: Vec<Side> =
            constraints.iter().enumerate().flat_map(|(k, row)| Self::sides(k, row)).collect();
        // The bounds of dependent parameters become rows.
        for dependent in &dependents {
            let i = dependent.index;
            for (sign, limit) in [(1.0, self.bounds.upper()[i]), (-1.0, -self.bounds.lower()[i])] {
                if limit.is_finite() {
                    let mut coefficients = vec![0.0; self.n()];
                    coefficients[i] = sign;
                    sides.push(Side { coefficients, limit, origin: None });
                }
            }
        }
        self.linear = LinearSet { dependents, ..LinearSet::default() };
        for side in sides {
            if let Some((k, l, limit)) = self.as_ratio(&side) {
                let mut normal = vec![0.0; self.n_free()];
                (normal[k], normal[l]) = (1.0, -1.0);
                self.linear.ratios.push(Some(side.coefficients[self.free[k]]));
                self.linear.rows.push(HalfSpace { normal, limit });
                self.linear.origins.push(side.origin);
                continue;
            }
            if let Some(fixed) = self.add_side(side)? {
                return Ok(Some(fixed));
            }
        }
        Ok(None)
    }

    /// Adds a side as a bound or as a row. Returns a parameter whose bounds have become equal.
    fn add_side(&mut self, side: Side) -> Result<Option<(usize, f64)>, Error> {
        let (normal, limit) = self.over_free(&side);
        let largest = normal.iter().fold(0.0f64, |m, a| m.max(a.abs()));
        let terms = side.coefficients.iter().map(|a| a.abs()).fold(side.limit.abs(), f64::max);
        let nonzero: Vec<usize> =
            (0..normal.len()).filter(|k| normal[*k].abs() > NEGLIGIBLE * largest).collect();
        if largest <= NEGLIGIBLE * terms || nonzero.is_empty() {
            // Over fixed parameters only: true or false.
            return if limit >= -SAME * terms { Ok(None) } else { Err(infeasible(side.origin)) };
        }
        let [k] = nonzero[..] else {
            self.linear.ratios.push(None);
            self.linear.rows.push(HalfSpace { normal, limit });
            self.linear.origins.push(side.origin);
            return Ok(None);
        };
        let (index, bound) = (self.free[k], limit / normal[k]);
        let (mut lower, mut upper) = (self.bounds.lower().to_vec(), self.bounds.upper().to_vec());
        if normal[k] > 0.0 {
            upper[index] = upper[index].min(bound);
        } else {
            lower[index] = lower[index].max(bound);
        }
        let close = SAME * (lower[index].abs() + upper[index].abs());
        if lower[index] > upper[index] + close {
            return Err(infeasible(side.origin));
        }
        if lower[index] >= upper[index] {
            return Ok(Some((index, 0.5 * (lower[index] + upper[index]))));
        }
        self.x0[index] = self.x0[index].clamp(lower[index], upper[index]);
        let on_scale = |x: f64, otherwise: f64| match self.transforms[k] {
            Transform::Linear => x,
            Transform::Log if x > 0.0 && x.is_finite() => x.ln(),
            Transform::Log => otherwise,
        };
        (self.lower[k], self.upper[k]) =
            (on_scale(lower[index], self.lower[k]), on_scale(upper[index], self.upper[k]));
        self.boxed[k] =
            (upper[index] - lower[index]).is_finite() && (self.upper[k] - self.lower[k]).is_finite();
        self.bounds = Bounds::new(&lower, &upper)?;
        Ok(None)
    }

    /// Returns a side over the working coordinates: fixed and dependent parameters are substituted.
    fn over_free(&self, side: &Side) -> (Vec<f64>, f64) {
        let mut limit = side.limit;
        let mut normal: Vec<f64> = self.free.iter().map(|i| side.coefficients[*i]).collect();
        for (i, a) in side.coefficients.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            if let Some(dependent) = self.linear.dependents.iter().find(|d| d.index == i) {
                limit -= a * dependent.constant;
                normal.iter_mut().zip(&dependent.coefficients).for_each(|(to, c)| *to += a * c);
            } else if self.coordinate_of(i).is_none() {
                limit -= a * self.x0[i];
            }
        }
        (normal, limit)
    }

    /// Solves the equalities for some of the free parameters, by Gauss-Jordan elimination with complete
    /// pivoting in units of the sizes, and removes these parameters from the free ones.
    fn eliminate(&mut self, constraints: &[LinearConstraint]) -> Result<Vec<Dependent>, Error> {
        let equalities: Vec<(usize, &LinearConstraint)> =
            constraints.iter().enumerate().filter(|(_, row)| row.lower == row.upper).collect();
        let (m, n) = (equalities.len(), self.n_free());
        let (mut a, mut b) = (DMatrix::zeros(m, n), vec![0.0; m]);
        let mut scale = vec![0.0f64; m];
        for (i, (_, row)) in equalities.iter().enumerate() {
            b[i] = row.upper;
            for (index, c) in row.coefficients.iter().enumerate() {
                match self.coordinate_of(index) {
                    Some(k) => a[(i, k)] = c * self.sizes[k],
                    None => b[i] -= c * self.x0[index],
                }
                scale[i] = scale[i].max((c * self.x0[index]).abs());
            }
            scale[i] = (0..n).fold(scale[i].max(row.upper.abs()), |m, k| m.max(a[(i, k)].abs()));
        }
        let mut pivots: Vec<(usize, usize)> = Vec::new();
        let mut open: Vec<usize> = (0..m).collect();
        while !open.is_empty() {
            let places = open.iter().flat_map(|i| (0..n).map(move |k| (*i, k)));
            let share = |(i, k): (usize, usize)| a[(i, k)].abs() / scale[i].max(f64::MIN_POSITIVE);
            // With equal shares, the last parameter becomes dependent.
            let best =
                places.fold(
                    (0, 0, 0.0),
                    |best, (i, k)| {
                        if share((i, k)) >= best.2 { (i, k, share((i, k))) } else { best }
                    },
                );
            let (i, k, share) = best;
            if share <= NEGLIGIBLE {
                break;
            }
            open.retain(|other| *other != i);
            pivots.push((i, k));
            let pivot = a[(i, k)];
            (0..n).for_each(|j| a[(i, j)] /= pivot);
            b[i] /= pivot;
            for other in (0..m).filter(|other| *other != i) {
                let factor = a[(other, k)];
                if factor != 0.0 {
                    (0..n).for_each(|j| a[(other, j)] -= factor * a[(i, j)]);
                    a[(other, k)] = 0.0;
                    b[other] -= factor * b[i];
                }
            }
        }
        // The remaining equalities follow from the others or contradict them.
        if let Some(i) = open.iter().find(|i| b[**i].abs() > SAME * scale[**i]) {
            return Err(infeasible(Some(equalities[*i].0)));
        }
        pivots.sort_by_key(|(_, k)| *k);
        let kept: Vec<usize> = (0..n).filter(|k| pivots.iter().all(|(_, other)| other != k)).collect();
        let dependents = pivots
            .iter()
            .map(|(i, k)| Dependent {
                index: self.free[*k],
                constant: b[*i] * self.sizes[*k],
                coefficients: kept.iter().map(|j| -a[(*i, *j)] * self.sizes[*k] / self.sizes[*j]).collect(),
            })
            .collect();
        pivots.iter().rev().for_each(|(_, k)| self.remove(*k));
        Ok(dependents)
    }

    /// Finds a point inside all constraints, and moves the start point into them.
    fn find_interior(&mut self, constraints: &[LinearConstraint]) -> Result<(), Error> {
        let n = self.n_free();
        let mut u = vec![0.0; n];
        self.to_working(&self.x0.clone(), &mut u);
        if !self.linear.rows.is_empty() {
            let rows = self.scaled_rows();
            let z: Vec<f64> = u.iter().zip(&self.sizes).map(|(u, size)| u / size).collect();
            let nearest = nearest(&z, &rows, 0.0).ok_or_else(|| self.contradiction(constraints, &z))?;
            // Distances from 1e-1 to 1e-9 sizes.
            let inside = (1..10).find_map(|k| Some((k, inside(&nearest, &rows, 10f64.powi(-k))?)));
            let (_, inside) = inside.ok_or(Error::NoInterior)?;
            self.linear.interior = inside.iter().zip(&self.sizes).map(|(z, size)| z * size).collect();
            self.restore(&mut u);
        }
        let mut x = self.x0.clone();
        self.to_user(&u, &mut x);
        self.x0 = x;
        Ok(())
    }

    /// Returns the error for an empty set, with a constraint that contradicts the bounds and the constraints
    /// before it.
    fn contradiction(&self, constraints: &[LinearConstraint], z: &[f64]) -> Error {
        let rows = self.scaled_rows();
        let n_rows = self.linear.rows.len();
        for end in 1..=n_rows {
            let some: Vec<HalfSpace> = rows[..end].iter().chain(&rows[n_rows..]).cloned().collect();
            if nearest(z, &some, 0.0).is_none() {
                return infeasible(self.linear.origins[end - 1]);
            }
        }
        infeasible((constraints.len() == 1).then_some(0))
    }

    /// Returns the rows and the finite bounds in units of the sizes.
    fn scaled_rows(&self) -> Vec<HalfSpace> {
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

    /// Shortens the way from a feasible point to `u` so that it ends at the first row that it meets. Does
    /// nothing without rows or if the point is feasible.
    pub(crate) fn shorten(&self, from: &[f64], u: &mut [f64]) {
        if self.satisfies_rows(u) {
            return;
        }
        let mut share = 1.0f64;
        for row in &self.linear.rows {
            let (here, there) = (row.value(from), row.value(u));
            if there > row.limit {
                share = share.min(((row.limit - here) / (there - here)).max(0.0));
            }
        }
        if !share.is_finite() {
            share = 0.0;
        }
        u.iter_mut().zip(from).for_each(|(u, from)| *u = from + share * (*u - from));
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

fn infeasible(constraint: Option<usize>) -> Error {
    Error::Infeasible { constraint }
}

/// Returns the nearest point that has this distance from all rows.
fn nearest(z: &[f64], rows: &[HalfSpace], distance: f64) -> Option<Vec<f64>> {
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

/// Like [`nearest`], for a distance that must be visible in the rows.
fn inside(z: &[f64], rows: &[HalfSpace], distance: f64) -> Option<Vec<f64>> {
    nearest(z, rows, distance).filter(|z| rows.iter().all(|row| row.contains(z)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const INF: f64 = f64::INFINITY;

    fn row(coefficients: &[f64], lower: f64, upper: f64) -> LinearConstraint {
        LinearConstraint { coefficients: coefficients.to_vec(), lower, upper }
    }

    fn space(x0: &[f64], lower: &[f64], upper: &[f64], scales: &[Transform]) -> Space {
        Space::new(x0, Bounds::new(lower, upper).unwrap(), scales, &[]).unwrap()
    }

    fn unit_box(x0: &[f64]) -> Space {
        space(x0, &vec![0.0; x0.len()], &vec![1.0; x0.len()], &[])
    }

    #[test]
    fn fractions_that_sum_to_one_lose_one_dimension() {
        let fractions = unit_box(&[0.2, 0.3, 0.9]).with_linear(&[row(&[1.0; 3], 1.0, 1.0)]).unwrap();
        assert_eq!((fractions.n_free(), fractions.free()), (2, &[0, 1][..]));
        // x2 = 1 - x0 - x1; only its lower bound can be met within the other bounds.
        assert_eq!(fractions.dependents().collect::<Vec<_>>(), [(2, &[-1.0, -1.0][..])]);
        assert_eq!(fractions.x0(), [0.2, 0.3, 0.5]);
        let mut x = [0.0; 3];
        let mut u = [0.7, 0.9];
        fractions.restore(&mut u);
        fractions.to_user(&u, &mut x);
        assert!((x[0] - 0.4).abs() < 1e-12 && (x[1] - 0.6).abs() < 1e-12 && x[2].abs() < 1e-12, "{x:?}");
        assert!(fractions.admits(&x) && !fractions.admits(&[0.2, 0.3, 0.4]));
    }

    #[test]
    fn ratios_keep_logarithmic_scales_and_sums_do_not() {
        let log = [Transform::Log; 2];
        let both = || space(&[3.0, 2.0], &[0.1; 2], &[100.0; 2], &log);
        let ordered = both().with_linear(&[row(&[1.0, -2.0], -INF, 0.0)]).unwrap();
        assert_eq!((ordered.transform(0), ordered.rows().len()), (Transform::Log, 1));
        assert!(ordered.satisfies_rows(&[2f64.ln(), 1f64.ln()]));
        assert!(!ordered.satisfies_rows(&[2.1f64.ln(), 1f64.ln()]));
        let sum = both().with_linear(&[row(&[1.0, 1.0], -INF, 4.0)]).unwrap();
        assert_eq!((sum.transform(0), sum.working_bounds(0)), (Transform::Linear, (0.1, 100.0)));
        assert!((sum.x0()[0] + sum.x0()[1] - 4.0).abs() < 1e-14, "{:?}", sum.x0());
    }

    #[test]
    fn single_parameters_become_bounds_or_fixed() {
        let bounded = unit_box(&[0.5, 0.5]).with_linear(&[row(&[0.0, 2.0], -INF, 1.2)]).unwrap();
        assert_eq!((bounded.rows().len(), bounded.working_bounds(1)), (0, (0.0, 0.6)));
        let fixed = unit_box(&[0.5, 0.5]).with_linear(&[row(&[4.0, 0.0], 1.0, 1.0)]).unwrap();
        assert_eq!((fixed.n_free(), fixed.x0()), (1, &[0.25, 0.5][..]));
        let both = [row(&[4.0, 0.0], 1.0, INF), row(&[8.0, 0.0], -INF, 2.0), row(&[1.0, 1.0], -INF, 0.5)];
        let squeezed = unit_box(&[0.5, 0.5]).with_linear(&both).unwrap();
        assert_eq!((squeezed.n_free(), squeezed.x0()[0]), (1, 0.25));
        assert!(squeezed.x0()[1] <= 0.25 && squeezed.working_bounds(0).1 <= 0.25);
    }

    #[test]
    fn contradictions_are_named() {
        let sums = [row(&[1.0, 1.0], -INF, 0.5), row(&[1.0, 1.0], 0.7, INF)];
        assert_eq!(unit_box(&[0.5; 2]).with_linear(&sums), Err(Error::Infeasible { constraint: Some(1) }));
        let equal = [row(&[1.0, 1.0], 0.5, 0.5), row(&[2.0, 2.0], 1.0, 1.0)];
        assert_eq!(unit_box(&[0.5; 2]).with_linear(&equal).map(|space| space.n_free()), Ok(1));
        let equal = [row(&[1.0, 1.0], 0.5, 0.5), row(&[2.0, 2.0], 1.1, 1.1)];
        let error = unit_box(&[0.5; 2]).with_linear(&equal);
        assert!(matches!(error, Err(Error::Infeasible { constraint: Some(_) })), "{error:?}");
        let flat = [row(&[1.0, -1.0], -INF, 0.0), row(&[-1.0, 1.0], -INF, 0.0)];
        assert_eq!(unit_box(&[0.5, 0.2]).with_linear(&flat), Err(Error::NoInterior));
        let beyond = [row(&[1.0, 1.0], 2.5, INF)];
        assert_eq!(unit_box(&[0.5; 2]).with_linear(&beyond), Err(Error::Infeasible { constraint: Some(0) }));
        let whole = unit_box(&[1.0; 2]).with_kinds(&[ParameterKind::Integer, ParameterKind::Continuous]);
        let error = whole.unwrap().with_linear(&[row(&[1.0, 1.0], -INF, 1.5)]);
        assert!(matches!(error, Err(Error::DiscreteConstraint { index: 0, .. })), "{error:?}");
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
                    row(&a, -INF, 0.3 * (random() + 0.6))
                })
                .collect();
            let x0: Vec<f64> = size.iter().map(|size| size * random()).collect();
            let space = space(&x0, &lower, &size, &[]).with_linear(&rows).unwrap();
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
