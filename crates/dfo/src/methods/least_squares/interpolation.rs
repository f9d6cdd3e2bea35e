//! Linear interpolation of the residuals at n + 1 points.
//!
//! A new point changes the model by a matrix of rank one. The Lagrange polynomials and the QR factors of the
//! Jacobian are updated, so a step costs O(mn + n^2). With at least as many residuals as parameters, the
//! Jacobian itself is never formed. Its products are computed from the residuals and the gradients of the
//! Lagrange polynomials.

use super::points::{axpy, difference, distance, dot, norm};
use super::subproblem::{Cancelled, Linear};
use super::triangle::{Triangle, add_product, diagonal, solve, solve_transposed, times_transposed};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Relative distance from the plane of the other points below which a point counts as being in the plane.
const IN_PLANE: f64 = 1e-12;
/// Minimum ratio of the diagonal entries of `R` for which an update of the factors is accurate. The normal
/// equations square the ratio.
const LEAST_RATIO: f64 = 1e-7;
/// Below this ratio, a second solution makes the update accurate (the corrected seminormal equations: Björck,
/// Linear Algebra Appl. 88/89, 1987, 31). The second solution is also used if a fraction above `IN_RANGE` of
/// the change is in the range of the Jacobian.
const GOOD_RATIO: f64 = 1e-3;
const IN_RANGE: f64 = 0.99;
/// Maximum error of the gradient computed from the factors, in units of the residuals and the Jacobian.
const DRIFT: f64 = 1e-8;
/// Number of residuals per block. Blocks of two vectors fit into a cache.
const AT_ONCE: usize = 1 << 10;

/// Model relative to its base point.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub(super) struct Interpolation {
    pub(super) linear: Linear,
    /// Index of the base point in the set.
    pub(super) base: usize,
    /// Concatenated gradients of the Lagrange polynomials.
    gradients: Vec<f64>,
}

/// Position of a point of the set, and its residuals.
pub(super) type Place<'a> = (&'a [f64], &'a [f64]);

/// A point that enters the set.
pub(super) struct NewPoint<'a> {
    /// Step from the base point to the new point.
    pub(super) step: &'a [f64],
    /// Values of the Lagrange polynomials at the new point.
    pub(super) lagrange: &'a [f64],
    /// Residuals of the new point.
    pub(super) residuals: &'a [f64],
    /// Differences between the residuals and the model.
    pub(super) misfit: &'a [f64],
}

impl Interpolation {
    /// Interpolates the residuals. Returns `None` if the points are in a plane up to rounding. Checks the
    /// context between blocks if there are many residuals.
    pub(super) fn new(
        points: &[Place<'_>],
        base: usize,
        context: &RunContext<'_>,
    ) -> Result<Option<Self>, Cancelled> {
        let n = points.len() - 1;
        // The neighbours of the start point give a diagonal matrix.
        let along = |(k, (z, _)): (usize, &Place<'_>)| {
            z.iter().zip(points[0].0).enumerate().all(|(j, (z, from))| j + 1 == k || k == 0 || z == from)
        };
        let is_diagonal = points.iter().enumerate().all(along);
        let reference = if is_diagonal { 0 } else { base };
        let others: Vec<usize> = (0..=n).filter(|k| *k != reference).collect();
        let steps: Vec<Vec<f64>> =
            others.iter().map(|k| difference(points[*k].0, points[reference].0)).collect();
        let lengths: Vec<f64> = steps.iter().map(|w| norm(w)).collect();
        if lengths.iter().any(|length| !(*length > 0.0 && length.is_finite())) {
            return Ok(None);
        }
        let mut gradients = vec![0.0; (n + 1) * n];
        let distances = if is_diagonal {
            (0..n).for_each(|k| gradients[(k + 1) * n + k] = 1.0 / steps[k][k]);
            None
        } else {
            let distances = DMatrix::from_fn(n, n, |k, j| steps[k][j] / lengths[k]).lu();
            let u = distances.u();
            if (0..n).any(|k| u[(k, k)].abs() < IN_PLANE) {
                return Ok(None);
            }
            let Some(inverse) = distances.try_inverse() else { return Ok(None) };
            for (k, &place) in others.iter().enumerate() {
                let gradient = &mut gradients[place * n..(place + 1) * n];
                gradient.iter_mut().zip(&inverse.column(k)).for_each(|(g, w)| *g = w / lengths[k]);
            }
            Some(distances)
        };
        let (before, after) = gradients.split_at_mut(reference * n);
        let (gradient, after) = after.split_at_mut(n);
        before.chunks_exact(n).chain(after.chunks_exact(n)).for_each(|g| axpy(-1.0, g, gradient));
        // Solve J W' = D. The differences D are reduced to n rows first, so that only these must be solved
        // for.
        let (zero, of_base) = (points[reference].1, points[base].1);
        let difference = |i: usize, k: usize| (points[others[k]].1[i] - zero[i]) / lengths[k];
        let turned = Linear::new(of_base.len(), n, |i| of_base[i], difference, context)?;
        let Linear { mut factor, reached } = turned;
        if let Some(distances) = &distances {
            let Some(jacobian) = distances.solve(&factor.transpose()) else { return Ok(None) };
            factor = jacobian.transpose();
        } else {
            (0..n).for_each(|k| factor.column_mut(k).scale_mut(lengths[k] / steps[k][k]));
        }
        let linear = if factor.is_square() && !is_diagonal {
            Linear::turned(reached, factor)
        } else {
            Linear { factor, reached }
        };
        let numbers = gradients.iter().chain(linear.factor.iter()).chain(linear.reached.iter());
        let finite = numbers.clone().all(|v| v.is_finite());
        Ok(finite.then_some(Self { linear, base, gradients }))
    }

    pub(super) fn n(&self) -> usize {
        self.linear.factor.ncols()
    }

    /// Returns the gradient of the Lagrange polynomial of a point.
    pub(super) fn gradient(&self, place: usize) -> &[f64] {
        &self.gradients[place * self.n()..(place + 1) * self.n()]
    }

    fn products(&self, v: &[f64]) -> Vec<f64> {
        self.gradients.chunks_exact(self.n()).map(|g| dot(g, v)).collect()
    }

    /// Returns the values of the Lagrange polynomials at a displacement from the base point.
    pub(super) fn lagrange(&self, step: &[f64]) -> Vec<f64> {
        let mut values = self.products(step);
        values[self.base] += 1.0;
        values
    }

    /// Makes another point of the set the base point; `step` leads to this point.
    pub(super) fn rebase(&mut self, place: usize, step: &[f64]) {
        if place != self.base {
            self.move_by(step);
            self.base = place;
        }
    }

    /// Replaces a point of the set by a new point. `residuals` are the residuals of the points of the set.
    /// Returns false if the factors would be inaccurate; the model must then be rebuilt.
    pub(super) fn exchange(
        &mut self,
        place: usize,
        new: &NewPoint<'_>,
        residuals: &[&[f64]],
        is_better: bool,
    ) -> bool {
        let NewPoint { step, lagrange, residuals: new, misfit } = *new;
        let n = self.n();
        let of_place = lagrange[place];
        let gradient: Vec<f64> = self.gradient(place).iter().map(|g| g / of_place).collect();
        // Value of the new Lagrange polynomial at the old base point.
        let gamma = if place == self.base { 1.0 / of_place } else { 0.0 };
        let is_base = is_better || place == self.base;
        let of_base = if is_base { new } else { residuals[self.base] };
        // Also compute the gradient of the sum of squares, which shows the effect of rounding on the factors.
        let [of_misfit, mut of_residuals] = products(residuals, of_base, [misfit, of_base]);
        // The new point replaces the removed point.
        of_residuals[place] = 0.0;
        let of_new: f64 = new.iter().zip(of_base).map(|(new, base)| (new - base) * base).sum();
        let of_new = of_new - dot(lagrange, &of_residuals);
        let [mut w, mut slope] = self.sums([&of_misfit, &of_residuals]);
        axpy(of_new, &gradient, &mut slope);
        let is_triangle = self.linear.factor.is_square();
        if is_triangle {
            let (least, most) = diagonal(&self.linear.factor);
            if least <= LEAST_RATIO * most {
                return false;
            }
            let before = residuals[self.base];
            let r = &self.linear.factor;
            solve_transposed(r, &mut w, 0.0);
            let (all, inside) = (dot(misfit, misfit), dot(&w, &w));
            let (mut rest, mut along) =
                (all - inside, dot(misfit, before) - dot(&w, self.linear.reached.as_slice()));
            if least < GOOD_RATIO * most || inside > IN_RANGE * all {
                let mut v = w.clone();
                solve(r, &mut v, 0.0);
                let mut outside = misfit.to_vec();
                combine(&mut outside, residuals, residuals[self.base], &self.products(&v));
                let [of_outside] = products(residuals, residuals[self.base], [&outside]);
                let [mut more] = self.sums([&of_outside]);
                solve_transposed(r, &mut more, 0.0);
                axpy(1.0, &more, &mut w);
                rest = dot(&outside, &outside) - dot(&more, &more);
                along = dot(&outside, before) - dot(&more, self.linear.reached.as_slice());
            }
            // With as many residuals as parameters, the range is the whole space.
            let rho = if misfit.len() > n { rest.max(0.0).sqrt() } else { 0.0 };
            let most = norm(before);
            let tau = if rho > 0.0 { (along / rho).clamp(-most, most) } else { 0.0 };
            let Linear { factor, reached } = std::mem::replace(&mut self.linear, Linear::nothing());
            let mut triangle = Triangle { factor, reached };
            triangle.change(&w, rho, tau, &gradient, gamma);
            self.linear = Linear { factor: triangle.factor, reached: triangle.reached };
        } else {
            let e = DVector::from_column_slice(misfit);
            self.linear.factor.ger(1.0, &e, &DVector::from_column_slice(&gradient), 1.0);
            self.linear.reached.axpy(gamma, &e, 1.0);
        }
        for (k, g) in self.gradients.chunks_exact_mut(n).enumerate() {
            if k == place {
                g.copy_from_slice(&gradient);
            } else {
                axpy(-lagrange[k], &gradient, g);
            }
        }
        if is_base {
            // Until here, the model is relative to the old base point.
            self.move_by(step);
            self.base = place;
        }
        let numbers = [&gradient[..], lagrange, self.linear.reached.as_slice()];
        let finite = numbers.iter().all(|v| v.iter().all(|v| v.is_finite()));
        finite && (!is_triangle || self.drift(&slope) <= DRIFT * norm(of_base))
    }

    /// Returns the error of the gradient computed from the factors, in units of the Jacobian.
    fn drift(&self, slope: &[f64]) -> f64 {
        let product = times_transposed(&self.linear.factor, self.linear.reached.as_slice());
        distance(&product, slope) / diagonal(&self.linear.factor).1
    }

    fn move_by(&mut self, step: &[f64]) {
        let Linear { factor, reached } = &mut self.linear;
        if factor.is_square() {
            add_product(factor, step, reached.as_mut_slice());
        } else {
            reached.gemv(1.0, factor, &DVector::from_column_slice(step), 1.0);
        }
    }

    /// Returns the weighted sums of the gradients of the Lagrange polynomials.
    fn sums<const K: usize>(&self, weights: [&[f64]; K]) -> [Vec<f64>; K] {
        let mut sums = weights.map(|_| vec![0.0; self.n()]);
        for (k, g) in self.gradients.chunks_exact(self.n()).enumerate() {
            sums.iter_mut().zip(weights).for_each(|(sum, weights)| axpy(weights[k], g, sum));
        }
        sums
    }

    pub(super) fn is_sound(&self, n: usize, m: usize) -> bool {
        self.n() == n && self.linear.factor.nrows() == m.min(n)
    }
}

/// Subtracts a weighted sum of residuals, each relative to `base`.
pub(super) fn combine(from: &mut [f64], residuals: &[&[f64]], base: &[f64], weights: &[f64]) {
    let whole: f64 = weights.iter().sum();
    for (block, from) in from.chunks_mut(AT_ONCE).enumerate() {
        let part = block * AT_ONCE..block * AT_ONCE + from.len();
        // Four at a time, so that the block is read and written once for them.
        let (fours, rest) = residuals.as_chunks::<4>();
        let (four_weights, rest_weights) = weights.as_chunks::<4>();
        for (r, w) in fours.iter().zip(four_weights) {
            let [a, b, c, d] = r.map(|r| &r[part.clone()]);
            for ((((from, a), b), c), d) in from.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                *from -= (w[0] * a + w[1] * b) + (w[2] * c + w[3] * d);
            }
        }
        for (r, weight) in rest.iter().zip(rest_weights) {
            axpy(-weight, &r[part.clone()], from);
        }
        axpy(whole, &base[part], from);
    }
}

/// Returns the products of the residuals, each relative to `base`, with the vectors.
fn products<const K: usize>(residuals: &[&[f64]], base: &[f64], vectors: [&[f64]; K]) -> [Vec<f64>; K] {
    let mut products = vectors.map(|_| vec![0.0; residuals.len()]);
    let mut rest = [0.0; AT_ONCE];
    for from in (0..base.len()).step_by(AT_ONCE) {
        let part = from..(from + AT_ONCE).min(base.len());
        for (k, r) in residuals.iter().enumerate() {
            let rest = &mut rest[..part.len()];
            let pairs = r[part.clone()].iter().zip(&base[part.clone()]);
            rest.iter_mut().zip(pairs).for_each(|(rest, (r, base))| *rest = r - base);
            for (products, vector) in products.iter_mut().zip(vectors) {
                products[k] += dot(rest, &vector[part.clone()]);
            }
        }
    }
    products
}

/// Stored form of the model.
#[derive(Clone, Serialize, Deserialize)]
struct Stored {
    base: usize,
    gradients: Vec<f64>,
    factor: Vec<f64>,
    reached: Vec<f64>,
}

impl From<Interpolation> for Stored {
    fn from(model: Interpolation) -> Self {
        let Linear { factor, reached } = model.linear;
        Self {
            base: model.base,
            gradients: model.gradients,
            factor: factor.as_slice().to_vec(),
            reached: reached.as_slice().to_vec(),
        }
    }
}

impl TryFrom<Stored> for Interpolation {
    type Error = &'static str;

    fn try_from(stored: Stored) -> Result<Self, Self::Error> {
        let Stored { base, gradients, factor, reached } = stored;
        let rows = reached.len();
        let n = factor.len().checked_div(rows).unwrap_or(0);
        let finite = gradients.iter().chain(&factor).chain(&reached).all(|v| v.is_finite());
        if n == 0 || factor.len() != n * rows || gradients.len() / n != n + 1 || base > n || !finite {
            return Err("the parts of the model are inconsistent");
        }
        let factor = DMatrix::from_vec(rows, n, factor);
        Ok(Self { linear: Linear { factor, reached: DVector::from_vec(reached) }, base, gradients })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dice(k: usize) -> f64 {
        ((k * 7919 + 13) % 1009) as f64 / 1009.0 - 0.5
    }

    fn residuals(z: &[f64], m: usize) -> Vec<f64> {
        let term = |i: usize, k: usize| (dice(i + 7 * k) * z[k] + 0.3 * z[k] * z[k]).sin();
        (0..m).map(|i| 0.2 + (0..z.len()).map(|k| term(i, k)).sum::<f64>()).collect()
    }

    fn squares(model: &Interpolation, s: &[f64]) -> f64 {
        (&model.linear.reached + &model.linear.factor * DVector::from_column_slice(s)).norm_squared()
    }

    /// A model updated with many new points equals the interpolation of its points.
    #[test]
    fn exchange_matches_a_new_interpolation() {
        for (n, m) in [(1, 1), (2, 7), (4, 4), (6, 3), (13, 40), (20, 12)] {
            let mut places: Vec<Vec<f64>> = vec![vec![0.0; n]; n + 1];
            (0..n).for_each(|k| places[k + 1][k] = 0.1);
            let mut values: Vec<Vec<f64>> = places.iter().map(|z| residuals(z, m)).collect();
            let fresh = |places: &[Vec<f64>], values: &[Vec<f64>], base: usize| {
                let set: Vec<Place<'_>> = places.iter().zip(values).map(|(z, r)| (&z[..], &r[..])).collect();
                Interpolation::new(&set, base, &RunContext::new()).unwrap().unwrap()
            };
            let mut model = fresh(&places, &values, 0);
            let mut n_fresh = 0;
            for turn in 0..60 {
                let base = model.base;
                let step: Vec<f64> = (0..n).map(|k| 0.2 * dice(turn * n + k + 5)).collect();
                let new: Vec<f64> = step.iter().zip(&places[base]).map(|(s, z)| s + 0.9 * z).collect();
                let step = difference(&new, &places[base]);
                let of_new = residuals(&new, m);
                let lagrange = model.lagrange(&step);
                let place = (0..=n).max_by(|a, b| lagrange[*a].abs().total_cmp(&lagrange[*b].abs())).unwrap();
                let nodes: Vec<&[f64]> = values.iter().map(Vec::as_slice).collect();
                let mut misfit = difference(&of_new, &values[base]);
                combine(&mut misfit, &nodes, &values[base], &lagrange);
                let of = NewPoint { step: &step, lagrange: &lagrange, residuals: &of_new, misfit: &misfit };
                let is_accurate = model.exchange(place, &of, &nodes, turn % 3 == 0);
                (places[place], values[place]) = (new, of_new);
                let again = fresh(&places, &values, if turn % 3 == 0 { place } else { model.base });
                if !is_accurate {
                    (model, n_fresh) = (again, n_fresh + 1);
                    continue;
                }
                let there = difference(&places[model.base], &places[again.base]);
                let gap = |s: &[f64]| squares(&model, s) - squares(&again, s);
                assert_eq!(there, vec![0.0; n]);
                for k in 0..=n {
                    let s = difference(&places[k], &places[model.base]);
                    let at = model.lagrange(&s);
                    assert!((0..=n).all(|j| (at[j] - f64::from(j == k)).abs() < 1e-7), "{n} {turn} {at:?}");
                    assert!((gap(&s) - gap(&vec![0.0; n])).abs() < 1e-9, "{n} {m} {turn}");
                }
            }
            assert!(n_fresh <= 6, "{n} {m}: {n_fresh}");
        }
    }

    #[test]
    fn interpolation_round_trips_and_rejects_inconsistent_state() {
        let (z, r) =
            ([vec![0.0, 0.0], vec![1.0, 0.0], vec![0.0, 1.0]], [[1.0, 2.0, 0.0], [3.0, 1.0, 1.0], [0.0; 3]]);
        let set: Vec<Place<'_>> = z.iter().zip(&r).map(|(z, r)| (&z[..], &r[..])).collect();
        let model = Interpolation::new(&set, 1, &RunContext::new()).unwrap().unwrap();
        let stored = Stored::from(model.clone());
        assert_eq!(squares(&stored.clone().try_into().unwrap(), &[0.3, 0.4]), squares(&model, &[0.3, 0.4]));
        let spoils: [fn(&mut Stored); 3] =
            [|s| s.base = 3, |s| s.factor.truncate(3), |s| s.gradients[1] = f64::NAN];
        for spoil in spoils {
            let mut other = stored.clone();
            spoil(&mut other);
            assert!(Interpolation::try_from(other).is_err());
        }
    }
}
