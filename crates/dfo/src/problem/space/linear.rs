//! Adds linear constraints to a space: equalities reduce its dimension, and inequalities become half-spaces
//! of the working coordinates.

use super::bounds::Bounds;
use super::coordinates::{Space, typical_size};
use super::linear_points::{SAME, nearest};
use super::linear_set::{Dependent, LinearSet};
use crate::error::Error;
use crate::problem::constraints::LinearConstraint;
use crate::problem::constraints::quadratic_program::HalfSpace;
use crate::values::choices::{ParameterKind, Transform};
use nalgebra::DMatrix;

/// Coefficients and pivots below this fraction of the largest one of their row are rounding errors.
const NEGLIGIBLE: f64 = 1e-12;
/// Distances, in sizes, of the interior point from all rows that are tried: 10^-k.
const DISTANCES: std::ops::Range<i32> = 1..10;

/// One side of a constraint over all parameters: `coefficients . x <= limit`. The sign is -1 for a lower
/// limit.
struct Side {
    coefficients: Vec<f64>,
    limit: f64,
    sign: f64,
    origin: Option<usize>,
}

/// A side over the working coordinates.
struct Reduced {
    normal: Vec<f64>,
    limit: f64,
    /// The largest term of an entry of the normal, in units of the sizes, and the sum of the terms of the
    /// limit. They determine the rounding errors.
    terms: f64,
    magnitude: f64,
}

/// An equality that follows from inequalities.
enum Flat {
    /// A parameter has this value.
    Parameter(usize, f64),
    /// A constraint has this value.
    Row(usize, f64),
}

impl Space {
    /// Adds linear constraints. Each equality removes a free parameter: the value of a *dependent* parameter
    /// follows from the others. A constraint on a single parameter becomes a bound. Parameters with a
    /// logarithmic scale get a linear scale, unless the constraint is a ratio of two of them (`a <= 2 b`).
    /// The start point moves to the nearest feasible point, in units of the sizes.
    ///
    /// Inequalities that leave no room on one side of a plane are equalities of this plane.
    ///
    /// # Errors
    /// Returns an error if a constraint contains a discrete parameter, or if no point is feasible.
    pub fn with_linear(self, constraints: &[LinearConstraint]) -> Result<Self, Error> {
        if constraints.is_empty() {
            return Ok(self);
        }
        self.check_kinds(constraints)?;
        let (mut start, mut rows) = (self, constraints.to_vec());
        // Each turn but the last fixes a parameter or turns an inequality into an equality. It starts with all
        // other parameters, because a turn removes dependent ones.
        loop {
            let mut space = start.clone().with_linear_scales(&rows);
            let mut sides = Vec::new();
            let found = match space.reduce(&rows, &mut sides)? {
                None => space.find_interior(&sides, rows.len())?,
                fixed => fixed,
            };
            match found {
                None => return Ok(space),
                Some(Flat::Parameter(index, value)) => start = start.fixing(index, value)?,
                Some(Flat::Row(constraint, limit)) => {
                    (rows[constraint].lower, rows[constraint].upper) = (limit, limit);
                }
            }
        }
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
                sign,
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

    /// Returns this space with one parameter fixed.
    fn fixing(self, index: usize, value: f64) -> Result<Self, Error> {
        let (mut lower, mut upper) = (self.bounds.lower().to_vec(), self.bounds.upper().to_vec());
        (lower[index], upper[index]) = (value, value);
        let mut space = Self { bounds: Bounds::new(&lower, &upper)?, ..self };
        space.x0[index] = value;
        if let Some(k) = space.coordinate_of(index) {
            space.remove(k);
        }
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

    /// Eliminates the equalities and forms the rows of the inequalities. `of_rows` receives the side of each
    /// row. Returns a parameter that the constraints fix, with its value; the caller then starts again.
    fn reduce(
        &mut self,
        constraints: &[LinearConstraint],
        of_rows: &mut Vec<Side>,
    ) -> Result<Option<Flat>, Error> {
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
                    sides.push(Side { coefficients, limit, sign, origin: None });
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
            } else if let Some(fixed) = self.add_side(&side)? {
                return Ok(Some(fixed));
            }
            if self.linear.rows.len() > of_rows.len() {
                of_rows.push(side);
            }
        }
        Ok(None)
    }

    /// Adds a side as a bound or as a row. Returns a parameter whose bounds have become equal.
    fn add_side(&mut self, side: &Side) -> Result<Option<Flat>, Error> {
        let Reduced { normal, limit, terms, magnitude } = self.over_free(side);
        let sized = |k: usize| (normal[k] * self.sizes[k]).abs();
        let largest = (0..normal.len()).map(sized).fold(0.0, f64::max);
        let nonzero: Vec<usize> = (0..normal.len()).filter(|k| sized(*k) > NEGLIGIBLE * terms).collect();
        if nonzero.is_empty() {
            // Over fixed parameters only: true or false.
            let error = SAME * magnitude.max(largest);
            return if limit >= -error { Ok(None) } else { Err(infeasible(side.origin)) };
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
        // The bounds have the rounding errors of the terms from which they follow.
        let terms = (lower[index].abs() + upper[index].abs()).max(magnitude / normal[k].abs());
        let width = upper[index] - lower[index];
        if width < -SAME * terms {
            return Err(infeasible(side.origin));
        }
        if width.is_finite() && width <= NEGLIGIBLE * terms {
            return Ok(Some(Flat::Parameter(index, 0.5 * (lower[index] + upper[index]))));
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
    fn over_free(&self, side: &Side) -> Reduced {
        let (mut limit, mut magnitude) = (side.limit, side.limit.abs());
        let mut normal: Vec<f64> = self.free.iter().map(|i| side.coefficients[*i]).collect();
        let largest = |v: &[f64], factor: f64| {
            v.iter().zip(&self.sizes).map(|(a, size)| (factor * a * size).abs()).fold(0.0, f64::max)
        };
        let mut terms = largest(&normal, 1.0);
        for (i, a) in side.coefficients.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            let constant = if let Some(dependent) = self.linear.dependents.iter().find(|d| d.index == i) {
                terms = terms.max(largest(&dependent.coefficients, *a));
                normal.iter_mut().zip(&dependent.coefficients).for_each(|(to, c)| *to += a * c);
                a * dependent.constant
            } else if self.coordinate_of(i).is_none() {
                a * self.x0[i]
            } else {
                continue;
            };
            limit -= constant;
            magnitude += constant.abs();
        }
        Reduced { normal, limit, terms, magnitude }
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

    /// Finds a point inside all constraints, and moves the start point into them. Returns an inequality that
    /// every feasible point satisfies with equality; the caller then starts again.
    fn find_interior(&mut self, sides: &[Side], n_constraints: usize) -> Result<Option<Flat>, Error> {
        let n = self.n_free();
        let mut u = vec![0.0; n];
        self.to_working(&self.x0.clone(), &mut u);
        if !self.linear.rows.is_empty() {
            let rows = self.scaled_rows();
            let z: Vec<f64> = u.iter().zip(&self.sizes).map(|(u, size)| u / size).collect();
            let nearest = nearest(&z, &rows, 0.0).ok_or_else(|| self.contradiction(n_constraints, &z))?;
            let Some(inside) = DISTANCES.into_iter().find_map(|k| inside(&nearest, &rows, 10f64.powi(-k)))
            else {
                return self.flat_row(sides, &nearest, rows).map(Some).ok_or(Error::NoInterior);
            };
            self.linear.interior = inside.iter().zip(&self.sizes).map(|(z, size)| z * size).collect();
            self.restore(&mut u);
        }
        let mut x = self.x0.clone();
        self.to_user(&u, &mut x);
        self.x0 = x;
        Ok(None)
    }

    /// Returns a row or a bound from which no feasible point has a distance.
    fn flat_row(&self, sides: &[Side], z: &[f64], mut rows: Vec<HalfSpace>) -> Option<Flat> {
        for k in 0..rows.len() {
            let limit = rows[k].limit;
            let length = rows[k].normal.iter().map(|a| a * a).sum::<f64>().sqrt();
            rows[k].limit = limit - 10f64.powi(1 - DISTANCES.end) * length;
            let has_room = nearest(z, &rows, 0.0).is_some();
            rows[k].limit = limit;
            if has_room {
                continue;
            }
            let Some(side) = sides.get(k) else {
                let j = rows[k].normal.iter().position(|a| *a != 0.0)?;
                let is_upper = rows[k].normal[j] > 0.0;
                let bounds = if is_upper { self.bounds.upper() } else { self.bounds.lower() };
                return Some(Flat::Parameter(self.free[j], bounds[self.free[j]]));
            };
            let value = side.sign * side.limit;
            return match side.origin {
                Some(constraint) => Some(Flat::Row(constraint, value)),
                None => Some(Flat::Parameter(side.coefficients.iter().position(|a| *a != 0.0)?, value)),
            };
        }
        None
    }

    /// Returns the error for an empty set, with a constraint that contradicts the bounds and the constraints
    /// before it.
    fn contradiction(&self, n_constraints: usize, z: &[f64]) -> Error {
        let rows = self.scaled_rows();
        let n_rows = self.linear.rows.len();
        for end in 1..=n_rows {
            let some: Vec<HalfSpace> = rows[..end].iter().chain(&rows[n_rows..]).cloned().collect();
            if nearest(z, &some, 0.0).is_none() {
                return infeasible(self.linear.origins[end - 1]);
            }
        }
        infeasible((n_constraints == 1).then_some(0))
    }
}

fn infeasible(constraint: Option<usize>) -> Error {
    Error::Infeasible { constraint }
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
        let beyond = [row(&[1.0, 1.0], 2.5, INF)];
        assert_eq!(unit_box(&[0.5; 2]).with_linear(&beyond), Err(Error::Infeasible { constraint: Some(0) }));
        let whole = unit_box(&[1.0; 2]).with_kinds(&[ParameterKind::Integer, ParameterKind::Continuous]);
        let error = whole.unwrap().with_linear(&[row(&[1.0, 1.0], -INF, 1.5)]);
        assert!(matches!(error, Err(Error::DiscreteConstraint { index: 0, .. })), "{error:?}");
    }

    #[test]
    fn inequalities_without_room_become_equalities() {
        let flat = [row(&[1.0, -1.0], -INF, 0.0), row(&[-1.0, 1.0], -INF, 0.0)];
        let line = unit_box(&[0.5, 0.2]).with_linear(&flat).unwrap();
        assert_eq!((line.n_free(), line.x0()[0]), (1, line.x0()[1]));
        // Only a corner of the box.
        let corner = unit_box(&[0.5, 0.2, 0.1]).with_linear(&[row(&[1.0, 1.0, 0.0], 2.0, INF)]).unwrap();
        assert_eq!((corner.free(), corner.x0()), (&[2][..], &[1.0, 1.0, 0.1][..]));
        // The point (0.1, 0.3) as the tip of a cone, with rounding.
        let cone = [row(&[1.0, 0.2], -INF, 0.16), row(&[-1.0, 0.1], -INF, -0.07), row(&[0.0, 3.0], 0.9, INF)];
        let tip = unit_box(&[0.5, 0.2]).with_linear(&cone).unwrap();
        let error = (tip.x0()[0] - 0.1).abs() + (tip.x0()[1] - 0.3).abs();
        assert!(tip.n_free() == 0 && error < 1e-12, "{:?}", tip.x0());
    }

    /// A parameter that inequalities fix does not fix the parameters that depend on it.
    #[test]
    fn fixed_parameters_keep_dependent_ones() {
        let rows =
            [row(&[1.0; 3], 1.0, 1.0), row(&[4.0, 0.0, 0.0], 1.0, INF), row(&[8.0, 0.0, 0.0], -INF, 2.0)];
        let space = unit_box(&[0.2, 0.3, 0.5]).with_linear(&rows).unwrap();
        assert_eq!((space.free(), space.x0()), (&[1][..], &[0.25, 0.3, 0.45][..]));
        assert_eq!(space.dependents().collect::<Vec<_>>(), [(2, &[-1.0][..])]);
    }
}
