//! The step of a Gauss-Newton model within a ball, a box and linear inequalities.

use super::points::{difference, dot, norm};
use super::triangle::{
    Triangle, add_product, diagonal, rows_at_once, solve, solve_transposed, times_transposed, without,
};
use crate::problem::constraints::quadratic_program::{self, HalfSpace, Solution};
use base::RunContext;
use nalgebra::{Cholesky, DMatrix, DVector, SVD};
use std::borrow::Cow;

/// Maximum number of Newton steps for the multiplier of the ball. From a good bracket, three or four are
/// enough.
const MOST_STEPS: usize = 60;
/// Singular values below this fraction of the largest are rounding errors, because differences of residuals
/// have lost some digits.
const RANK: f64 = 1e-13;
/// Maximum number of sweeps per singular value. A few are enough.
const MOST_SWEEPS: usize = 100;
/// Maximum number of parameters for which the step in the ball is exact. With more parameters, the step is
/// the best one in a subspace of this dimension.
const SUBSPACE: usize = 12;
/// Number of inverse iterations for the smallest singular value of a triangle.
const INVERSE_STEPS: usize = 10;

/// Ratio of the diagonal entries of a triangle below which the step needs a least multiplier.
const REGULAR: f64 = 1e-10;
/// Relative accuracy of the length of a step that ends at the ball, if rows are active.
const ON_BALL: f64 = 1e-3;
/// Share of the length of a step below which rows count as blocking it.
const NARROW: f64 = 0.1;
/// Distances, in units of the radius, of the points whose nearest feasible points are compared.
const FAR_AWAY: [f64; 4] = [1.0, 4.0, 16.0, 64.0];

/// The run was interrupted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cancelled;

/// Residuals as a linear function of the displacement `s` from a base point, rotated to n values: `|r + J
/// s|^2 = |c + F s|^2 + constant`. With at least as many residuals as parameters, `F` is the triangle of the
/// QR factorisation of `J`. Otherwise `F` is `J` itself.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    pub(super) factor: DMatrix<f64>,
    pub(super) reached: DVector<f64>,
}

impl Linear {
    pub(super) fn nothing() -> Self {
        Self { factor: DMatrix::zeros(0, 0), reached: DVector::zeros(0) }
    }

    /// Rotates residuals and their m x n Jacobian, in blocks of rows. Checks the context before each block
    /// except the first.
    pub(super) fn new(
        m: usize,
        n: usize,
        residual: impl Fn(usize) -> f64,
        jacobian: impl Fn(usize, usize) -> f64,
        context: &RunContext<'_>,
    ) -> Result<Self, Cancelled> {
        if m < n {
            return Ok(Self {
                factor: DMatrix::from_fn(m, n, jacobian),
                reached: DVector::from_fn(m, |i, _| residual(i)),
            });
        }
        let mut triangle = Triangle::zero(n);
        let at_once = rows_at_once(n).min(m);
        let mut block = Vec::with_capacity(at_once * (n + 1));
        for from in (0..m).step_by(at_once) {
            if from > 0 && context.is_over() {
                return Err(Cancelled);
            }
            let rows = from..(from + at_once).min(m);
            block.clear();
            for k in 0..n {
                block.extend(rows.clone().map(|i| jacobian(i, k)));
            }
            block.extend(rows.clone().map(&residual));
            triangle.absorb(rows.len(), &mut block);
        }
        Ok(Self { factor: triangle.factor, reached: triangle.reached })
    }

    /// Returns the decrease of the sum of squares at a step.
    pub(super) fn decrease(&self, step: &[f64]) -> f64 {
        let after = if self.factor.is_square() {
            let mut after = self.reached.clone();
            add_product(&self.factor, step, after.as_mut_slice());
            after
        } else {
            &self.reached + &self.factor * DVector::from_column_slice(step)
        };
        self.reached.norm_squared() - after.norm_squared()
    }

    /// Returns the function with one additional residual.
    pub(super) fn with_row(&self, row: &[f64], residual: f64) -> Self {
        let m = self.reached.len();
        let mut factor = self.factor.clone().insert_row(m, 0.0);
        factor.row_mut(m).iter_mut().zip(row).for_each(|(to, from)| *to = *from);
        Self::turned(self.reached.clone().push(residual), factor)
    }

    /// Rotates residuals and a Jacobian that are already in memory.
    pub(super) fn turned(residuals: DVector<f64>, jacobian: DMatrix<f64>) -> Self {
        let (m, n) = jacobian.shape();
        if m < n {
            return Self { factor: jacobian, reached: residuals };
        }
        let turned = Self::new(m, n, |i| residuals[i], |i, k| jacobian[(i, k)], &RunContext::new());
        turned.unwrap_or_else(|Cancelled| Self::nothing())
    }
}

/// Steps from a point that stay in the box and satisfy the linear inequalities.
#[derive(Debug, Clone)]
pub(super) struct Room {
    pub(super) lower: Vec<f64>,
    pub(super) upper: Vec<f64>,
    /// Linear inequalities, with normals of length 1. The step 0 satisfies them.
    pub(super) rows: Vec<HalfSpace>,
}

impl Room {
    /// Returns the room around the end of a step.
    pub(super) fn after(&self, step: &[f64]) -> Self {
        let row = |row: &HalfSpace| HalfSpace { limit: row.limit - row.value(step), ..row.clone() };
        Self {
            lower: difference(&self.lower, step),
            upper: difference(&self.upper, step),
            rows: self.rows.iter().map(row).collect(),
        }
    }

    /// Returns the rows and the finite bounds.
    pub(super) fn half_spaces(&self) -> Vec<HalfSpace> {
        let bounds = (0..self.lower.len()).flat_map(|k| [(k, 1.0, self.upper[k]), (k, -1.0, -self.lower[k])]);
        let bounds = bounds.filter(|(.., limit)| limit.is_finite()).map(|(k, sign, limit)| {
            let mut normal = vec![0.0; self.lower.len()];
            normal[k] = sign;
            HalfSpace { normal, limit }
        });
        self.rows.iter().cloned().chain(bounds).collect()
    }

    /// Clamps a step to the box, and ends it at the first row.
    pub(super) fn clipped(&self, step: &[f64]) -> Vec<f64> {
        let clamped = step.iter().enumerate().map(|(k, s)| s.clamp(self.lower[k], self.upper[k]));
        let mut step: Vec<f64> = clamped.collect();
        let share = self.rows.iter().fold(1.0f64, |share, row| {
            let value = row.value(&step);
            if value > row.limit { share.min(row.limit.max(0.0) / value) } else { share }
        });
        if share < 1.0 {
            step.iter_mut().for_each(|s| *s *= share);
        }
        step
    }

    /// Returns the nearest step to the given one.
    fn nearest(&self, step: &[f64]) -> Vec<f64> {
        let gradient: Vec<f64> = step.iter().map(|s| -s).collect();
        quadratic_program::identity(step.len())
            .and_then(|hessian| quadratic_program::minimize(&hessian, &gradient, &self.half_spaces()))
            .map_or_else(|| vec![0.0; step.len()], |solution| solution.x)
    }

    /// Returns a step of the given length along a unit vector or opposite to it, on the side with more space.
    /// If rows leave little space on both sides, the step slides along them.
    pub(super) fn along(&self, direction: &[f64], length: f64) -> Vec<f64> {
        let wanted = |sign: f64| direction.iter().map(|d| sign * length * d).collect::<Vec<f64>>();
        let better = |forth: Vec<f64>, back: Vec<f64>, size: &dyn Fn(&[f64]) -> f64| {
            if size(&back) > size(&forth) { back } else { forth }
        };
        let straight = better(self.clipped(&wanted(1.0)), self.clipped(&wanted(-1.0)), &norm);
        if self.rows.is_empty() || norm(&straight) >= NARROW * length.abs() {
            return straight;
        }
        // The nearest step to `w` has a component along `w`, or the nearest step to `-w` has one along `-w`.
        let along = |step: &[f64]| dot(step, direction).abs();
        better(straight, better(self.nearest(&wanted(1.0)), self.nearest(&wanted(-1.0)), &along), &along)
    }

    /// Returns the rows and bounds that hold a minimum of `|r + J s|` with this gradient at the end of a
    /// step: the distance to them is below `near`, and their multipliers exceed `least`.
    pub(super) fn holding(&self, step: &[f64], gradient: &[f64], near: f64, least: f64) -> Vec<HalfSpace> {
        let active: Vec<HalfSpace> = self
            .after(step)
            .half_spaces()
            .into_iter()
            .filter(|row| row.limit <= near)
            .map(|row| HalfSpace { limit: 0.0, ..row })
            .collect();
        let found = quadratic_program::identity(step.len())
            .and_then(|hessian| quadratic_program::minimize(&hessian, gradient, &active));
        let multipliers = found.map_or_else(Vec::new, |solution| solution.active);
        let holds = multipliers.into_iter().filter(|(_, multiplier)| *multiplier > least);
        holds.map(|(row, _)| active[row].clone()).collect()
    }
}

/// A step from the best point in a [`Room`] with `|s| <= radius` at which `|r + J s|` is (nearly) minimal.
///
/// The problem in the ball alone is solved exactly with the singular values of `J` (Moré and Sorensen 1983,
/// with `J'J` in place of the Hessian). If the solution leaves the box, the coordinate that reaches its bound
/// first is fixed there. The remaining problem is then solved again. If the solution violates linear
/// inequalities, the multiplier of the ball is the root of the length of the solutions of quadratic programs.
pub(super) struct Subproblem<'a> {
    pub(super) linear: &'a Linear,
    pub(super) radius: f64,
    pub(super) room: &'a Room,
}

impl Subproblem<'_> {
    /// Returns the step, and the predicted decrease of the sum of squares.
    pub(super) fn solve(&self) -> (Vec<f64>, f64) {
        let (step, decrease) = self.solve_in_box();
        if self.room.rows.iter().all(|row| row.contains(&step)) {
            return (step, decrease);
        }
        let step = self.solve_in_rows().unwrap_or_else(|| vec![0.0; step.len()]);
        let decrease = self.linear.decrease(&step);
        if decrease > 0.0 && decrease.is_finite() { (step, decrease) } else { (vec![0.0; step.len()], 0.0) }
    }

    /// Returns the step in the ball, the box and the rows. The minimum of `|r + J s|^2 + multiplier |s|^2` in
    /// box and rows is a quadratic program. Newton's method finds the multiplier at which its length is the
    /// radius.
    fn solve_in_rows(&self) -> Option<Vec<f64>> {
        let (Linear { factor, reached }, radius) = (self.linear, self.radius);
        let (m, n) = factor.shape();
        let gradient = transposed_product(factor, reached);
        let rows = self.room.half_spaces();
        // The factor of the Hessian comes from the Jacobian, without squares of it.
        let hessian = |multiplier: f64| {
            let mut all = factor.clone().resize_vertically(m + n, 0.0);
            (0..n).for_each(|k| all[(m + k, k)] = multiplier.sqrt());
            Cholesky::<f64, nalgebra::Dyn>::pack_dirty(all.qr().r().transpose())
        };
        let is_regular = factor.is_square() && {
            let (least, most) = diagonal(factor);
            least > REGULAR * most
        };
        let least = if is_regular { 0.0 } else { (REGULAR * factor.norm()).powi(2) };
        let (mut low, mut high) = (least, gradient.norm() / radius);
        let mut multiplier = least;
        for _ in 0..MOST_STEPS {
            let hessian = hessian(multiplier);
            let Solution { mut x, active } =
                quadratic_program::minimize(&hessian, gradient.as_slice(), &rows)?;
            let length = norm(&x);
            if (length <= radius && (multiplier == least || length >= (1.0 - ON_BALL) * radius))
                || high <= low * (1.0 + f64::EPSILON)
            {
                return Some(x);
            }
            if length > radius && length <= (1.0 + ON_BALL) * radius {
                x.iter_mut().for_each(|x| *x *= radius / length);
                return Some(x);
            }
            if length > radius {
                low = multiplier
            } else {
                high = multiplier
            }
            // The derivative of the length, in the null space of the active rows.
            let turned = |v: &[f64]| {
                let mut v = DVector::from_column_slice(v);
                hessian.l_dirty().solve_lower_triangular_mut(&mut v);
                v
            };
            let mut rest = turned(&x);
            if !active.is_empty() {
                let normals: Vec<_> = active.iter().map(|(row, _)| turned(&rows[*row].normal)).collect();
                let q = DMatrix::from_columns(&normals).qr().q();
                rest -= &q * q.tr_mul(&rest);
            }
            let next = multiplier + (length / radius - 1.0) * length * length / rest.norm_squared();
            let middle = (low.max(f64::EPSILON * high) * high).sqrt();
            multiplier = if next > low && next < high { next } else { middle };
        }
        None
    }

    fn solve_in_box(&self) -> (Vec<f64>, f64) {
        let (lower, upper) = (&self.room.lower, &self.room.upper);
        let Linear { factor, reached } = self.linear;
        let n = factor.ncols();
        let gradient = transposed_product(factor, reached);
        let mut step = vec![0.0; n];
        // At a bound, and the descent direction leaves the box.
        let blocked =
            |k: usize| (lower[k] >= 0.0 && gradient[k] > 0.0) || (upper[k] <= 0.0 && gradient[k] < 0.0);
        let mut free: Vec<usize> = (0..n).filter(|&k| !blocked(k)).collect();
        let mut left = self.radius * self.radius;
        let (mut a, mut rest) = (Cow::Borrowed(factor), Cow::Borrowed(reached));
        if free.len() < n {
            let (some, turned) = columns_of(factor, &free, reached);
            (a, rest) = (Cow::Owned(some), Cow::Owned(turned));
        }
        while !free.is_empty() && left > 0.0 {
            let part = within_ball(&a, &rest, left.sqrt());
            let share = |(place, &k): (usize, &usize)| {
                let s = part[place];
                let bound = if s > 0.0 { upper[k] } else { lower[k] };
                if s != 0.0 && (bound / s) < 1.0 { bound / s } else { 1.0 }
            };
            let shares: Vec<f64> = free.iter().enumerate().map(share).collect();
            let first = shares.iter().copied().fold(1.0, f64::min);
            if first >= 1.0 {
                free.iter().enumerate().for_each(|(place, &k)| step[k] = part[place]);
                break;
            }
            let mut kept = Vec::with_capacity(free.len());
            let mut reached = rest.into_owned();
            for (place, &k) in free.iter().enumerate() {
                if shares[place] > first {
                    kept.push(place);
                    continue;
                }
                step[k] = if part[place] > 0.0 { upper[k] } else { lower[k] };
                left -= step[k] * step[k];
                reached += a.column(place) * step[k];
            }
            free = kept.iter().map(|place| free[*place]).collect();
            let (some, turned) = columns_of(&a, &kept, &reached);
            (a, rest) = (Cow::Owned(some), Cow::Owned(turned));
        }
        let decrease = self.linear.decrease(&step);
        // For values near the largest floating-point number, the decrease may not be finite.
        if decrease.is_finite() { (step, decrease) } else { (vec![0.0; n], 0.0) }
    }
}

/// Selects columns. A triangle is rotated to a triangle again.
fn columns_of(a: &DMatrix<f64>, kept: &[usize], r: &DVector<f64>) -> (DMatrix<f64>, DVector<f64>) {
    if a.is_square() { without(a, kept, r) } else { (a.select_columns(kept), r.clone()) }
}

/// Returns the step that minimises `|r + A s|`, if `A` is a well-conditioned triangle.
fn unlimited(a: &DMatrix<f64>, r: &DVector<f64>) -> Option<DVector<f64>> {
    if !a.is_square() {
        return None;
    }
    let (least, most) = diagonal(a);
    // A matrix near the rounding of its entries is not invertible.
    if least <= 1e-10 * most {
        return None;
    }
    let mut step = -r;
    solve(a, step.as_mut_slice(), 0.0);
    step.iter().all(|s| s.is_finite()).then_some(step)
}

fn transposed_product(a: &DMatrix<f64>, r: &DVector<f64>) -> DVector<f64> {
    if a.is_square() { DVector::from_vec(times_transposed(a, r.as_slice())) } else { a.tr_mul(r) }
}

/// Returns an orthonormal basis that (nearly) contains the best step within any ball. For small balls, the
/// basis contains powers of `A'A` times the gradient. For large balls, it contains powers of its inverse
/// times the step without a ball (an extended Krylov space: Druskin and Knizhnerman, SIAM J. Matrix Anal.
/// Appl. 19, 1998, 755).
fn subspace(a: &DMatrix<f64>, r: &DVector<f64>) -> DMatrix<f64> {
    let n = a.ncols();
    let least = RANK * a.norm();
    let mut basis: Vec<DVector<f64>> = Vec::with_capacity(SUBSPACE);
    let mut add = |v: &DVector<f64>| {
        let mut rest = v.clone();
        for _ in 0..2 {
            for b in &basis {
                rest.axpy(-b.dot(&rest), b, 1.0);
            }
        }
        let length = rest.norm();
        let is_new = length > 1e-10 * v.norm() && length.is_finite();
        if is_new {
            basis.push(rest / length);
        }
        is_new.then(|| basis[basis.len() - 1].clone())
    };
    let (mut near, mut far) = (Some(transposed_product(a, r)), None);
    if a.is_square() && least > 0.0 {
        let mut step = r.clone();
        solve(a, step.as_mut_slice(), least);
        far = Some(step);
    }
    for turn in 0..SUBSPACE {
        if turn % 2 == 0 || !a.is_square() {
            near = near.and_then(|v| add(&v)).map(|v| transposed_product(a, &(a * v)));
        } else {
            far = far.and_then(|v| add(&v)).map(|mut v| {
                solve_transposed(a, v.as_mut_slice(), least);
                solve(a, v.as_mut_slice(), least);
                v
            });
        }
    }
    if basis.is_empty() { DMatrix::zeros(n, 1) } else { DMatrix::from_columns(&basis) }
}

/// Returns the smallest singular value of a triangle. Large triangles use inverse iteration (Golub and Van
/// Loan, section 8.2.2). Returns 0 if there is no such value.
pub(super) fn smallest_singular_value(r: &DMatrix<f64>) -> f64 {
    let n = r.ncols();
    if !r.iter().all(|r| r.is_finite()) {
        return 0.0;
    }
    if n <= SUBSPACE {
        let svd = SVD::try_new(r.clone(), false, false, f64::EPSILON, MOST_SWEEPS * n);
        return svd.map_or(0.0, |svd| svd.singular_values.min());
    }
    if !r.is_square() || diagonal(r).0 == 0.0 {
        return 0.0;
    }
    let mut v = DVector::from_fn(n, |k, _| 1.0 + (k % 7) as f64);
    let mut length = v.norm();
    for _ in 0..INVERSE_STEPS {
        v /= length;
        solve_transposed(r, v.as_mut_slice(), 0.0);
        solve(r, v.as_mut_slice(), 0.0);
        length = v.norm();
    }
    if length.is_finite() { length.sqrt().recip() } else { 0.0 }
}

/// Returns the shortest step that minimises `|r + A s|` within `|s| <= radius`.
fn within_ball(a: &DMatrix<f64>, r: &DVector<f64>, radius: f64) -> DVector<f64> {
    if let Some(step) = unlimited(a, r).filter(|step| step.norm() <= radius) {
        return step;
    }
    if a.ncols() <= SUBSPACE {
        return on_the_ball(a.clone(), r, radius);
    }
    let basis = subspace(a, r);
    let Linear { factor, reached } = Linear::turned(r.clone(), a * &basis);
    &basis * on_the_ball(factor, &reached, radius)
}

/// Returns the step of `within_ball`, computed with singular values.
fn on_the_ball(a: DMatrix<f64>, r: &DVector<f64>, radius: f64) -> DVector<f64> {
    let n = a.ncols();
    if !a.iter().all(|a| a.is_finite()) {
        return DVector::zeros(n);
    }
    // The decomposition may fail for values near the largest floating-point number.
    let svd = SVD::try_new(a, true, true, f64::EPSILON, MOST_SWEEPS * n);
    let Some(SVD { u: Some(u), v_t: Some(v_t), singular_values: sigma }) = &svd else {
        return DVector::zeros(n);
    };
    let c = u.tr_mul(r);
    let largest = sigma.max();
    let at = |multiplier: f64| {
        DVector::from_iterator(
            sigma.len(),
            sigma
                .iter()
                .zip(c.iter())
                .map(|(s, c)| if *s <= RANK * largest { 0.0 } else { -s * c / (s * s + multiplier) }),
        )
    };
    let mut part = at(0.0);
    if part.norm() > radius {
        // 1 / |s| is nearly linear in the multiplier. Newton's method started from below stays below.
        let gradient = DVector::from_iterator(sigma.len(), sigma.iter().zip(c.iter()).map(|(s, c)| s * c));
        let (mut low, mut high) = (0.0f64, gradient.norm() / radius);
        let mut multiplier = 0.0;
        for _ in 0..MOST_STEPS {
            part = at(multiplier);
            let norm = part.norm();
            if (norm / radius - 1.0).abs() < 1e-6 {
                break;
            }
            if norm > radius {
                low = multiplier
            } else {
                high = multiplier
            }
            let slope: f64 = part
                .iter()
                .zip(sigma.iter())
                .filter(|(p, _)| **p != 0.0)
                .map(|(p, s)| p * p / (s * s + multiplier))
                .sum();
            let next = multiplier + (norm / radius - 1.0) * norm * norm / slope;
            multiplier = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        let norm = part.norm();
        if norm > radius {
            part *= radius / norm;
        }
    }
    v_t.tr_mul(&part)
}

/// Returns the point of a ball and a box that maximises `|g s|`. The point is along `g` or opposite to `g`,
/// with coordinates that exceed their bounds fixed there. `other` selects the opposite side. With rows, the
/// point is (nearly) maximal: the best one of the nearest feasible points to several multiples of `g`.
pub(super) fn longest(g: &[f64], radius: f64, room: &Room, other: bool) -> Vec<f64> {
    let Room { lower, upper, rows } = room;
    let value = |step: &[f64]| g.iter().zip(step).map(|(g, s)| g * s).sum::<f64>().abs();
    let in_rows = |sign: f64| {
        let unit = sign * radius / norm(g);
        let at = |far: &f64| {
            let mut step = room.nearest(&g.iter().map(|g| far * unit * g).collect::<Vec<f64>>());
            let share = radius / norm(&step);
            if share < 1.0 {
                step.iter_mut().for_each(|s| *s *= share);
            }
            step
        };
        let all = FAR_AWAY.iter().map(at);
        all.reduce(|best, next| if value(&next) > value(&best) { next } else { best }).unwrap_or_default()
    };
    let along = |sign: f64| {
        let mut step = vec![0.0; g.len()];
        let mut free: Vec<usize> = (0..g.len()).filter(|&k| g[k] != 0.0).collect();
        let mut left = radius * radius;
        while !free.is_empty() && left > 0.0 {
            let norm = free.iter().map(|&k| g[k] * g[k]).sum::<f64>().sqrt();
            let wanted = |k: usize| sign * g[k] / norm * left.sqrt();
            let set: Vec<usize> =
                free.iter().copied().filter(|&k| !(lower[k]..=upper[k]).contains(&wanted(k))).collect();
            if set.is_empty() {
                free.iter().for_each(|&k| step[k] = wanted(k));
                break;
            }
            for k in set {
                step[k] = wanted(k).clamp(lower[k], upper[k]);
                free.retain(|&other| other != k);
            }
            left = radius * radius - step.iter().map(|s| s * s).sum::<f64>();
        }
        if rows.iter().all(|row| row.contains(&step)) { step } else { in_rows(sign) }
    };
    let (forth, back) = (along(1.0), along(-1.0));
    if (value(&back) > value(&forth)) != other { back } else { forth }
}
