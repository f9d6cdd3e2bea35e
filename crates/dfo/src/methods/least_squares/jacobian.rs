//! Jacobian at the best point, from the points evaluated during the run.
//!
//! The Jacobian is a regression on the differences from the best point. The error of a point at distance d is
//! d^2 from curvature, plus the noise. The weight of the point is the inverse of their sum. Distances are in
//! units of the parameter size or of the value at the best point, whichever is larger. A start of another
//! magnitude then has no effect. Residuals may change faster than in proportion to the distance (for example,
//! a diverging exponential). Then d^2 is far below the error of the linear model. The weight of the point is
//! reduced by the square of this ratio.

use super::interpolation::Interpolation;
use super::points::{BARELY_INDEPENDENT, Selection, difference, distance, norm};
use super::state::LeastSquaresState;
use crate::values::choices::Transform;
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;

/// Noise of the residuals relative to their change over the distance unit. The smallest value consistent with
/// the points is used.
const NOISE: [f64; 6] = [1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2];
/// Maximum curvature over the distance unit, relative to the derivatives, at which a misfit is not noise.
const BENT: f64 = 10.0;
/// Minimum significant change of the residuals, in standard errors.
const SIGNIFICANT: f64 = 3.0;
/// Relative distance from a plane below which points do not determine the direction across the plane.
const IN_PLANE: f64 = 1.5e-8;
/// Number of parameters from which only the differences within the set determine the Jacobian. A regression
/// would take longer than a factorisation of the Jacobian.
const MANY: usize = 100;
/// Maximum number of nearest points in a regression, but at least twice the required number.
const MOST_POINTS: usize = 400;
/// Number of residuals per block.
const AT_ONCE: usize = 1 << 18;

/// A point other than the best one.
struct Neighbour<'a> {
    /// Step to the point in distance units, and its length.
    step: Vec<f64>,
    length: f64,
    residuals: Cow<'a, [f64]>,
}

impl LeastSquaresState {
    /// Returns the derivatives of the residuals with respect to the coordinates in units of their sizes, one
    /// row per residual. Returns `None` if the points are in a plane, or if the context has ended.
    pub(super) fn jacobian(&self, best: usize, context: &RunContext<'_>) -> Option<DMatrix<f64>> {
        let m = self.points[best].residuals.len();
        match self.n() {
            0 => Some(DMatrix::zeros(m, 0)),
            MANY.. => self.jacobian_of_set(best, context),
            _ => self.jacobian_of_points(best, context),
        }
    }

    /// Returns the differences within the set times the gradients of the Lagrange polynomials.
    fn jacobian_of_set(&self, best: usize, context: &RunContext<'_>) -> Option<DMatrix<f64>> {
        let (n, residuals) = (self.n(), &self.points[best].residuals);
        let kept = self.model.as_ref().filter(|_| self.set.len() == n + 1 && self.set.contains(&best));
        let (set, made) = match kept {
            Some(_) => (self.set.clone(), None),
            None => {
                let chosen = Selection::nearest(&self.points, &self.points[best].z, n).chosen;
                let set: Vec<usize> = std::iter::once(best).chain(chosen).collect();
                let places: Vec<_> =
                    set.iter().map(|k| (&self.points[*k].z[..], &self.points[*k].residuals[..])).collect();
                if set.len() <= n {
                    return None;
                }
                let made = Interpolation::new(&places, 0, context).ok()??;
                (set, Some(made))
            }
        };
        let model = made.as_ref().or(kept)?;
        let gradients = DMatrix::from_fn(n + 1, n, |place, k| model.gradient(place)[k]);
        let counted: Vec<_> = set.iter().map(|k| self.residuals_near(best, *k)).collect();
        let mut jacobian = DMatrix::zeros(residuals.len(), n);
        let at_once = (AT_ONCE / n).max(1);
        for from in (0..residuals.len()).step_by(at_once) {
            if from > 0 && context.is_over() {
                return None;
            }
            let len = at_once.min(residuals.len() - from);
            let changes = DMatrix::from_fn(len, n + 1, |i, k| counted[k][from + i] - residuals[from + i]);
            jacobian.rows_mut(from, len).copy_from(&(changes * &gradients));
        }
        jacobian.iter().all(|j| j.is_finite()).then_some(jacobian)
    }

    /// Returns the distance units, in units of the parameter sizes.
    fn units_at(&self, best: usize) -> Vec<f64> {
        let space = &self.setup.space;
        let of = |(k, &index): (usize, &usize)| match space.transform(k) {
            Transform::Linear => (self.points[best].x[index].abs() / space.size(k)).max(1.0),
            Transform::Log => 1.0,
        };
        space.free().iter().enumerate().map(of).collect()
    }

    fn jacobian_of_points(&self, best: usize, context: &RunContext<'_>) -> Option<DMatrix<f64>> {
        let (residuals, units) = (&self.points[best].residuals, self.units_at(best));
        let mut others = Vec::with_capacity(self.points.len());
        for (place, point) in self.points.iter().enumerate() {
            let mut step = difference(&point.z, &self.points[best].z);
            step.iter_mut().zip(&units).for_each(|(step, unit)| *step /= unit);
            let (length, counted) = (norm(&step), self.residuals_near(best, place));
            if length > 0.0 && length.is_finite() {
                others.push(Neighbour { step, length, residuals: counted });
            }
        }
        let mut jacobian = regression(others, residuals, context)?;
        jacobian.column_iter_mut().zip(&units).for_each(|(mut column, unit)| column /= *unit);
        jacobian.iter().all(|j| j.is_finite()).then_some(jacobian)
    }
}

/// Returns the derivatives from a regression on differences from a point with these residuals. Returns `None`
/// if the points are in a plane, or if there are many residuals and the context has ended.
fn regression(
    mut others: Vec<Neighbour<'_>>,
    residuals: &[f64],
    context: &RunContext<'_>,
) -> Option<DMatrix<f64>> {
    let (m, n) = (residuals.len(), others.first()?.step.len());
    others.sort_by(|a, b| a.length.total_cmp(&b.length));
    others.truncate(MOST_POINTS.max(2 * (n + 1)));
    let at_once = (AT_ONCE / others.len()).max(1);
    if m > at_once && context.is_over() {
        return None;
    }
    let changes: Vec<f64> = others.iter().map(|other| distance(&other.residuals, residuals)).collect();
    let mut selection = Selection::new();
    let is_new = |k: &usize| selection.add(&others[*k].step, BARELY_INDEPENDENT);
    let nearest: Vec<usize> = (0..others.len()).filter(is_new).take(n).collect();
    if nearest.len() < n {
        return None;
    }
    // Largest slope of the nearest points. Residuals that change faster are curved.
    let slope = nearest.iter().map(|k| changes[*k] / others[*k].length).fold(0.0, f64::max);
    let faster =
        |k: usize| if slope > 0.0 { (changes[k] / (slope * others[k].length)).max(1.0) } else { 1.0 };
    let sizes = (0..others.len()).filter(|k| faster(*k) == 1.0).map(|k| norm(&others[k].residuals));
    let rounding = f64::EPSILON * sizes.fold(norm(residuals), f64::max);
    let freedom = (others.len() - n).max(1) as f64;
    let mut found = None;
    for noise in NOISE {
        let weight = |k: usize, _| ((others[k].length * faster(k)).powi(2) + noise).recip();
        let weights = DVector::from_fn(others.len(), weight);
        let qr = DMatrix::from_fn(others.len(), n, |k, j| weights[k] * others[k].step[j]).qr();
        let (q, r) = (qr.q(), qr.r());
        let diagonal = || (0..n).map(|k| r[(k, k)].abs());
        if diagonal().fold(f64::INFINITY, f64::min) <= IN_PLANE * diagonal().fold(0.0, f64::max) {
            break;
        }
        let (mut turned, mut misfit) = (DMatrix::zeros(n, m), 0.0);
        for from in (0..m).step_by(at_once) {
            if from > 0 && context.is_over() {
                return None;
            }
            let len = at_once.min(m - from);
            let of = |k: usize, i: usize| weights[k] * (others[k].residuals[from + i] - residuals[from + i]);
            let changes = DMatrix::from_fn(others.len(), len, of);
            let part = q.tr_mul(&changes);
            misfit += (changes - &q * &part).norm_squared();
            turned.columns_mut(from, len).copy_from(&part);
        }
        let spread = (misfit / freedom).sqrt();
        let noise_along = |direction: &DVector<f64>| {
            let rounded = (&q * direction).component_mul(&weights).norm();
            SIGNIFICANT * spread.max(rounding * rounded)
        };
        // The rows of the derivatives are linear combinations of the rotated rows.
        let combinations = r.transpose().solve_lower_triangular(&DMatrix::identity(n, n))?;
        let is_none = |k: &usize| take_noise(&mut turned, &combinations.column(*k).normalize(), &noise_along);
        let without_effect: Vec<usize> = (0..n).filter(is_none).collect();
        take_noise_of_all(&mut turned, &noise_along);
        let mut transposed = r.solve_upper_triangular(&turned)?;
        without_effect.iter().for_each(|k| transposed.row_mut(*k).fill(0.0));
        let agrees = misfit <= BENT * BENT * freedom * transposed.norm_squared();
        found = Some(transposed.transpose());
        if agrees {
            break;
        }
    }
    found
}

/// Removes the combination of the rows by a unit vector if it is below the noise. The residuals do not
/// determine this direction, and its remainder would look like information. Returns true if the combination
/// was removed.
fn take_noise(
    rows: &mut DMatrix<f64>,
    direction: &DVector<f64>,
    noise: &impl Fn(&DVector<f64>) -> f64,
) -> bool {
    let part = rows.tr_mul(direction);
    let is_noise = part.norm() <= noise(direction);
    if is_noise {
        rows.ger(-1.0, direction, &part, 1.0);
    }
    is_noise
}

/// Removes each principal combination that is below the noise.
fn take_noise_of_all(rows: &mut DMatrix<f64>, noise: &impl Fn(&DVector<f64>) -> f64) {
    let n = rows.nrows();
    // The triangle has the left singular vectors of the rows.
    let triangle = rows.transpose().qr().r();
    let size = triangle.nrows().max(n);
    let svd = triangle.resize_vertically(size, 0.0).try_svd(false, true, f64::EPSILON, 100 * n.max(100));
    let Some(v_t) = svd.and_then(|svd| svd.v_t) else { return };
    for k in 0..n {
        take_noise(rows, &v_t.row(k).transpose(), noise);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn neighbour(step: Vec<f64>, residuals: Vec<f64>) -> Neighbour<'static> {
        Neighbour { length: norm(&step), step, residuals: Cow::Owned(residuals) }
    }

    /// Returns points around (1, 1) on a spiral, and the residuals with noise that is not a function of the
    /// distance.
    fn spiral(n_points: i32, noise: f64) -> (Vec<Neighbour<'static>>, Vec<f64>) {
        let r = |z: [f64; 2]| -> Vec<f64> {
            let smooth = [z[0] * z[0] + 2.0 * z[1], z[0] - z[1] * z[1], (z[0] * z[1]).exp()];
            let noisy = |(i, r)| r + noise * (1e7 * (z[0] + 3.0 * z[1]) + i as f64).sin();
            smooth.into_iter().enumerate().map(noisy).collect()
        };
        let around = |k: i32| {
            let (d, angle) = (0.5f64.powi(k), 2.4 * f64::from(k));
            let step = [d * angle.cos(), d * angle.sin()];
            neighbour(step.to_vec(), r([1.0 + step[0], 1.0 + step[1]]))
        };
        ((0..n_points).map(around).collect(), r([1.0; 2]))
    }

    fn jacobian(others: Vec<Neighbour<'_>>, residuals: &[f64]) -> Option<DMatrix<f64>> {
        regression(others, residuals, &RunContext::new())
    }

    #[test]
    fn regression_finds_derivatives_despite_curvature_and_noise() {
        let e = 1f64.exp();
        let expected = DMatrix::from_row_slice(3, 2, &[2.0, 2.0, 1.0, -2.0, e, e]);
        for (noise, tolerance) in [(0.0, 1e-5), (1e-7, 2e-3), (1e-3, 0.2)] {
            let (others, residuals) = spiral(40, noise);
            let found = jacobian(others, &residuals).unwrap();
            assert!((&found - &expected).amax() < tolerance, "{noise} {found}");
        }
    }

    #[test]
    fn regression_ignores_points_with_diverging_residuals() {
        let (mut others, residuals) = spiral(12, 0.0);
        let before = jacobian(others.split_off(0), &residuals).unwrap();
        let (mut others, _) = spiral(12, 0.0);
        others.push(neighbour(vec![3.0, 4.0], vec![1e26, -1e20, 1e10]));
        let after = jacobian(others, &residuals).unwrap();
        assert!((after - before).amax() < 1e-9);
    }

    #[test]
    fn columns_are_parallel_when_they_differ_only_by_curvature_and_rounding() {
        // Residuals depend only on the sum of two parameters, with rounding of about 1e-12.
        let r = |s: &[f64]| -> Vec<f64> {
            let sum = 1e4 + s[0] + s[1];
            (1..6).map(|i| (f64::from(i) * sum + 0.1 * (s[0] + s[1]).powi(2)) - f64::from(i) * 1e4).collect()
        };
        let steps = [[0.1, 0.0], [0.0, 0.1], [0.02, -0.03], [1e-3, 2e-3], [-2e-3, 1e-3], [1e-4, 1e-4]];
        let others = steps.iter().map(|s| neighbour(s.to_vec(), r(s))).collect();
        let found = jacobian(others, &r(&[0.0, 0.0])).unwrap();
        let (a, b) = (found.column(0).normalize(), found.column(1).normalize());
        assert!((a - b).amax() < 1e-14 && (found[(2, 0)] - 3.0).abs() < 1e-3, "{found}");
    }

    #[test]
    fn jacobian_is_none_when_points_are_in_a_plane() {
        let line = [[0.5, 0.0], [1.0, 0.0], [-1.0, 0.0]].map(|s| neighbour(s.to_vec(), vec![s[0], 1.0]));
        assert_eq!(jacobian(line.into(), &[0.0, 1.0]), None);
        assert_eq!(jacobian(Vec::new(), &[0.0, 1.0]), None);
    }
}
