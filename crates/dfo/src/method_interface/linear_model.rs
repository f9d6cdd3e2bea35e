//! Linear model of least squares around its best point: the Jacobian of the residuals in the user's units,
//! and the covariance of the parameters that follows from it.

use crate::problem::space::Space;
use crate::values::choices::Transform;
use base::RunContext;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Singular values of the Jacobian with columns of length one that are smaller than this part of the largest
/// count as zero: a Jacobian from differences is not more accurate (square root of the rounding unit).
const RANK_TOLERANCE: f64 = 1.5e-8;

/// Within this part of its size from a bound a parameter lies at it.
const AT_BOUND: f64 = 1e-10;

/// The residuals near the best point: their derivatives by the user's parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinearModel {
    /// Row by row, one row for each residual and one column for each parameter, in the user's units; with
    /// respect to the parameter itself also where it is searched by its logarithm. Columns of fixed
    /// parameters are zero.
    pub jacobian: Vec<f64>,
    /// -1 where a parameter lies at its lower bound (a fixed one, too), 1 at its upper, else 0.
    pub active: Vec<i8>,
}

/// Noise of residuals relative to their change over the size of a parameter: the least of these that agrees
/// with the points.
const NOISE: [f64; 4] = [1e-8, 1e-6, 1e-4, 1e-2];

/// Differences of residuals that are looked at together.
const AT_ONCE: usize = 1 << 18;

/// Rows of the Jacobian that are factorised together: those of ten columns fit into a cache.
const ROWS_AT_ONCE: usize = 1 << 12;

/// Curvature over the size of a parameter relative to the derivatives, up to which a misfit is no noise.
const BENT: f64 = 10.0;

impl LinearModel {
    /// By regression on points of a search: their places in units of the sizes of the working coordinates and
    /// their residuals. `best`: the point itself, its place and its residuals. A point at the distance d from
    /// it is wrong by d^2 for curvature, and by the noise; its weight is the inverse of their sum. `None`
    /// where the points span no more than a plane, or where there are many residuals and the context is over.
    pub(crate) fn regression<'a>(
        space: &Space,
        x: &[f64],
        z: &[f64],
        residuals: &[f64],
        points: impl Iterator<Item = (&'a [f64], &'a [f64])> + Clone,
        context: &RunContext<'_>,
    ) -> Option<Self> {
        let (n, m) = (z.len(), residuals.len());
        let moved = |place: &[f64]| place.iter().zip(z).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let others: Vec<(Vec<f64>, f64, &[f64])> = points
            .map(|(place, residuals)| (moved(place), residuals))
            .map(|(step, residuals)| {
                let length = step.iter().map(|s| s * s).sum::<f64>().sqrt();
                (step, length, residuals)
            })
            .filter(|(_, length, residuals)| *length > 0.0 && length.is_finite() && residuals.len() == m)
            .collect();
        if n == 0 {
            return Self::new(space, x, m, |_, _| 0.0);
        }
        if others.len() < n {
            return None;
        }
        let mut found = None;
        for noise in NOISE {
            let weights: Vec<f64> = others.iter().map(|(_, d, _)| 1.0 / (d * d + noise)).collect();
            let steps = DMatrix::from_fn(others.len(), n, |k, j| weights[k] * others[k].0[j]);
            let svd = steps.clone().try_svd(true, true, f64::EPSILON, most_sweeps(steps.ncols()))?;
            if svd.singular_values.min() <= RANK_TOLERANCE * svd.singular_values.max() {
                break;
            }
            let at_once = (AT_ONCE / others.len()).max(1);
            if m > at_once && context.is_over() {
                return None;
            }
            let (mut transposed, mut misfit) = (DMatrix::zeros(n, m), 0.0);
            for from in (0..m).step_by(at_once) {
                if from > 0 && context.is_over() {
                    return None;
                }
                let len = at_once.min(m - from);
                let weighted = DMatrix::from_fn(others.len(), len, |k, i| {
                    weights[k] * (others[k].2[from + i] - residuals[from + i])
                });
                let solved = svd.solve(&weighted, 0.0).ok()?;
                misfit += (&steps * &solved - weighted).norm_squared();
                transposed.columns_mut(from, len).copy_from(&solved);
            }
            let freedom = (others.len() - n).max(1) as f64;
            let agrees = misfit <= BENT * BENT * freedom * transposed.norm_squared();
            found = Some(transposed);
            if agrees {
                break;
            }
        }
        let jacobian = found?;
        Self::new(space, x, m, |i, k| jacobian[(k, i)] / space.size(k))
    }

    /// From the derivatives of residual `i` by working coordinate `k` at the point `x`, of `m` residuals.
    /// `None` where one of them is not finite in the user's units.
    pub(crate) fn new(
        space: &Space,
        x: &[f64],
        m: usize,
        derivative: impl Fn(usize, usize) -> f64,
    ) -> Option<Self> {
        let n = space.n();
        let mut model = Self { jacobian: vec![0.0; m * n], active: vec![-1; n] };
        let mut u = vec![0.0; space.n_free()];
        space.to_working(x, &mut u);
        for (k, &index) in space.free().iter().enumerate() {
            let per_unit = match space.transform(k) {
                Transform::Linear => 1.0,
                Transform::Log => x[index].recip(),
            };
            for i in 0..m {
                model.jacobian[i * n + index] = derivative(i, k) * per_unit;
            }
            let ((lower, upper), near) = (space.working_bounds(k), AT_BOUND * space.size(k));
            model.active[index] = i8::from(upper - u[k] <= near) - i8::from(u[k] - lower <= near);
        }
        model.jacobian.iter().all(|j| j.is_finite()).then_some(model)
    }
}

/// Uncertainty of the parameters of a fit, see [`Report::covariance`](crate::Report::covariance).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Covariance {
    /// Row by row, n x n, in the user's units. Infinite on the diagonal, and NaN among them beside it, for
    /// parameters that the residuals do not determine; zero for those that are held by a bound.
    pub matrix: Vec<f64>,
    /// The variance of a residual: their sum of squares by the degrees of freedom; NaN where there are none.
    pub variance: f64,
    /// Number of residuals less that of the free parameters that lie at no bound.
    pub degrees_of_freedom: usize,
    /// Parameters that the residuals do not determine, by index.
    pub undetermined: Vec<usize>,
    /// Parameters that lie at a bound, or are fixed: taken as known.
    pub held: Vec<usize>,
}

impl Covariance {
    /// `s^2 (J' J)^-1` of the parameters that are not held, with `s^2 = r' r / (m - n)` (Seber and Wild,
    /// Nonlinear Regression, 1989, section 2.1.2), by the singular values of J with its columns scaled to
    /// length one.
    ///
    /// `None` where there are many residuals and the context is over.
    pub(crate) fn new(
        residuals: &[f64],
        jacobian: &[f64],
        active: &[i8],
        context: &RunContext<'_>,
    ) -> Option<Self> {
        let (m, n) = (residuals.len(), active.len());
        let (free, held): (Vec<usize>, Vec<usize>) = (0..n).partition(|&index| active[index] == 0);
        let p = free.len();
        let degrees_of_freedom = m.saturating_sub(p);
        let variance = if degrees_of_freedom == 0 {
            f64::NAN
        } else {
            residuals.iter().map(|r| r * r).sum::<f64>() / degrees_of_freedom as f64
        };
        // Lengths without overflow; a column of zeros stays one.
        let (mut largest, mut squares) = (vec![0.0f64; p], vec![0.0; p]);
        for row in jacobian.chunks_exact(n) {
            free.iter().zip(&mut largest).for_each(|(k, most)| *most = most.max(row[*k].abs()));
        }
        largest.iter_mut().filter(|most| **most == 0.0).for_each(|most| *most = 1.0);
        for row in jacobian.chunks_exact(n) {
            let of_row = free.iter().zip(&largest).map(|(k, most)| row[*k] / most);
            squares.iter_mut().zip(of_row).for_each(|(sum, share)| *sum += share * share);
        }
        let length = |(most, sum): (&f64, &f64)| if *sum > 0.0 { most * sum.sqrt() } else { 1.0 };
        let lengths: Vec<f64> = largest.iter().zip(&squares).map(length).collect();
        // The triangle of a QR factorisation, rows added block by block, has the same singular values.
        let mut columns = DMatrix::zeros(0, p);
        for (block, rows) in jacobian.chunks(ROWS_AT_ONCE * n).enumerate().filter(|_| p > 0) {
            if block > 0 && context.is_over() {
                return None;
            }
            let above = columns.nrows();
            let stacked = DMatrix::from_fn(above + rows.len() / n, p, |i, k| match i.checked_sub(above) {
                Some(i) => rows[i * n + free[k]] / lengths[k],
                None => columns[(i, k)],
            });
            columns = stacked.qr().r();
        }
        let (inverse, determined) = inverse_of_normal_matrix(columns, p);
        let mut matrix = vec![0.0; n * n];
        for (a, &i) in free.iter().enumerate() {
            for (b, &j) in free.iter().enumerate() {
                let known = degrees_of_freedom > 0 && (determined[a] || determined[b]);
                matrix[i * n + j] = match known {
                    true => inverse[(a, b)] * (variance.sqrt() / lengths[a]) * (variance.sqrt() / lengths[b]),
                    false if a == b => f64::INFINITY,
                    false => f64::NAN,
                };
            }
        }
        let undetermined: Vec<usize> =
            free.iter().zip(&determined).filter(|(_, known)| !**known).map(|(index, _)| *index).collect();
        Some(Self { matrix, variance, degrees_of_freedom, undetermined, held })
    }

    /// Remarks on the covariance, with these names for the parameters; empty if there are none.
    pub fn message(&self, name: impl Fn(usize) -> String) -> String {
        let names =
            |indices: &[usize]| indices.iter().map(|index| name(*index)).collect::<Vec<_>>().join(", ");
        let mut said = Vec::new();
        if self.variance.is_nan() && self.held.len() * self.held.len() < self.matrix.len() {
            said.push(
                "there are no more residuals than parameters: they tell nothing of the variance".to_owned(),
            );
        }
        if !self.undetermined.is_empty() {
            let what = "do not determine (another value, alone or with others, fits as well)";
            said.push(format!("the residuals {what}: {}", names(&self.undetermined)));
        }
        if !self.held.is_empty() {
            said.push(format!("at a bound or fixed, taken as known: {}", names(&self.held)));
        }
        said.join("; ")
    }
}

/// So many sweeps a decomposition of so many columns may take in all.
fn most_sweeps(n: usize) -> usize {
    10_000.max(100 * n)
}

/// `(A' A)^+` for columns of length one or zero, and which of the unknowns have no part in the null space.
fn inverse_of_normal_matrix(columns: DMatrix<f64>, p: usize) -> (DMatrix<f64>, Vec<bool>) {
    let nothing = (DMatrix::zeros(p, p), vec![false; p]);
    if p == 0 || columns.nrows() == 0 {
        return nothing;
    }
    // Rows of zeros, so that all p right singular vectors are there.
    let rows = columns.nrows().max(p);
    let columns = columns.resize_vertically(rows, 0.0);
    let Some(svd) = columns.try_svd(false, true, f64::EPSILON, most_sweeps(p)) else { return nothing };
    let Some(v_t) = svd.v_t else { return nothing };
    let smallest = RANK_TOLERANCE * svd.singular_values.max();
    let mut inverse = DMatrix::zeros(p, p);
    let mut determined = vec![true; p];
    for (k, s) in svd.singular_values.iter().enumerate() {
        for a in 0..p {
            if *s > smallest {
                (0..p).for_each(|b| inverse[(a, b)] += v_t[(k, a)] / s * (v_t[(k, b)] / s));
            } else if v_t[(k, a)].abs() > RANK_TOLERANCE.sqrt() {
                determined[a] = false;
            }
        }
    }
    (inverse, determined)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;

    fn computed(residuals: &[f64], jacobian: &[f64], active: &[i8]) -> Covariance {
        Covariance::new(residuals, jacobian, active, &RunContext::new()).unwrap()
    }

    fn said(covariance: &Covariance) -> String {
        covariance.message(|index| format!("x[{index}]"))
    }

    #[test]
    fn a_line_has_the_textbook_variances() {
        // y = a + b t at t = 0, 1, 2, 3: (X' X)^-1 = [[0.7, -0.3], [-0.3, 0.2]].
        let jacobian: Vec<f64> = (0..4).flat_map(|t| [1.0, f64::from(t)]).collect();
        let residuals = [0.1, -0.2, 0.3, -0.1];
        let s2 = 0.15 / 2.0;
        let covariance = computed(&residuals, &jacobian, &[0, 0]);
        for (got, expected) in covariance.matrix.iter().zip([0.7, -0.3, -0.3, 0.2]) {
            assert!((got - s2 * expected).abs() < 1e-15, "{covariance:?}");
        }
        assert_eq!((covariance.degrees_of_freedom, said(&covariance)), (2, String::new()));
        // With b at a bound: the variance of a mean.
        let covariance = computed(&residuals, &jacobian, &[0, 1]);
        assert!((covariance.matrix[0] - 0.05 / 4.0).abs() < 1e-15 && covariance.matrix[1..] == [0.0; 3]);
        assert_eq!(said(&covariance), "at a bound or fixed, taken as known: x[1]");
    }

    #[test]
    fn scales_make_no_difference() {
        let jacobian: Vec<f64> = (0..4).flat_map(|t| [1e200, 1e-200 * f64::from(t)]).collect();
        let matrix = computed(&[0.1, -0.2, 0.3, -0.1], &jacobian, &[0, 0]).matrix;
        assert!((matrix[1] / (-0.3 * 0.075) - 1.0).abs() < 1e-12 && matrix[3] == f64::INFINITY, "{matrix:?}");
    }

    #[test]
    fn what_is_not_determined_is_infinite_and_named() {
        // a + b only, and c.
        let jacobian: Vec<f64> = (0..5).flat_map(|t| [1.0, 1.0, f64::from(t)]).collect();
        let covariance = computed(&[1.0, -1.0, 0.5, 0.5, -1.0], &jacobian, &[0, 0, 0]);
        let of = |i: usize, j: usize| covariance.matrix[3 * i + j];
        assert!(of(0, 0) == f64::INFINITY && of(1, 1) == f64::INFINITY && of(0, 1).is_nan());
        assert!(of(2, 2).is_finite() && of(0, 2).is_finite());
        assert_eq!(covariance.undetermined, [0, 1]);
        assert!(said(&covariance).ends_with("fits as well): x[0], x[1]"), "{}", said(&covariance));
        let none = computed(&[1.0, 2.0], &[1.0, 0.0, 0.0, 1.0], &[0, 0]);
        assert!(none.matrix[0] == f64::INFINITY && none.matrix[1].is_nan() && none.variance.is_nan());
        let zero = computed(&[1.0, 2.0], &[1.0, 0.0, 1.0, 0.0], &[0, 0]);
        assert_eq!(zero.undetermined, [1]);
        assert_eq!(computed(&[], &[], &[-1]).matrix, [0.0]);
    }

    #[test]
    fn a_regression_finds_the_derivatives_through_curvature_and_noise() {
        let space = Space::new(&[1.0, 10.0], Bounds::unbounded(2), &[], &[]).unwrap();
        let r = |z: &[f64], noise: f64| {
            let smooth = [z[0] * z[0] + 2.0 * z[1], z[0] - z[1] * z[1], (z[0] * z[1]).exp()];
            smooth
                .iter()
                .enumerate()
                .map(|(i, r)| r + noise * (1e7 * (z[0] + 3.0 * z[1]) + i as f64).sin())
                .collect()
        };
        for (noise, tolerance) in [(0.0, 1e-3), (1e-7, 2e-3), (1e-3, 0.2)] {
            let best = [1.0, 1.0];
            let places: Vec<Vec<f64>> = (0..40)
                .map(|k| {
                    let (d, angle) = (0.5f64.powi(k), 2.4 * f64::from(k));
                    vec![best[0] + d * angle.cos(), best[1] + d * angle.sin()]
                })
                .collect();
            let values: Vec<Vec<f64>> = places.iter().map(|z| r(z, noise)).collect();
            let at_best: Vec<f64> = r(&best, noise);
            let points = places.iter().map(Vec::as_slice).zip(values.iter().map(Vec::as_slice));
            let context = RunContext::new();
            let model =
                LinearModel::regression(&space, &[1.0, 10.0], &best, &at_best, points, &context).unwrap();
            let e = 1f64.exp();
            let expected = [2.0, 0.2, 1.0, -0.2, e, 0.1 * e];
            for (k, (j, expected)) in model.jacobian.iter().zip(expected).enumerate() {
                let scale = if k % 2 == 0 { 1.0 } else { 10.0 };
                assert!((j - expected).abs() * scale < tolerance, "{noise} {:?}", model.jacobian);
            }
        }
        let line = [([1.5, 1.0], [0.0]), ([2.0, 1.0], [1.0])];
        let points = line.iter().map(|(z, r)| (&z[..], &r[..]));
        let context = RunContext::new();
        assert_eq!(
            LinearModel::regression(&space, &[1.0, 10.0], &[1.0, 1.0], &[1.0], points, &context),
            None
        );
    }

    #[test]
    fn derivatives_are_by_the_parameters_themselves() {
        let bounds = Bounds::new(&[0.0, 1.0, 0.1], &[4.0, 1.0, 10.0]).unwrap();
        let log = [Transform::Linear, Transform::Linear, Transform::Log];
        let space = Space::new(&[4.0, 1.0, 2.0], bounds, &log, &[]).unwrap();
        let model = LinearModel::new(&space, space.x0(), 1, |_, k| [3.0, 5.0][k]).unwrap();
        assert_eq!((model.jacobian, model.active), (vec![3.0, 0.0, 2.5], vec![1, -1, 0]));
        assert_eq!(LinearModel::new(&space, space.x0(), 1, |_, _| f64::NAN), None);
    }
}
