//! Linear model of least squares around the best point: the Jacobian of the residuals in the user's units,
//! and the covariance of the parameters.

use crate::problem::constraints::ActiveConstraint;
use crate::problem::constraints::quadratic_program::{self, HalfSpace};
use crate::problem::space::Space;
use crate::values::choices::Transform;
use base::RunContext;
use nalgebra::{Cholesky, DMatrix, RowDVector};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Relative rank tolerance: the square root of the rounding unit. The columns of the Jacobian are scaled to
/// length one. Pivots smaller than this fraction of the largest pivot count as zero, because a
/// finite-difference Jacobian is not more accurate.
const RANK_TOLERANCE: f64 = 1.5e-8;

/// A parameter counts as at its bound if its distance from the bound is within this fraction of its size.
const AT_BOUND: f64 = 1e-10;

/// Linear model of the residuals near the best point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinearModel {
    /// Derivatives, row by row, in the user's units: one row per residual and one column per parameter. The
    /// derivatives are with respect to the parameter itself, even if it is searched on a logarithmic scale.
    /// Columns of fixed parameters are zero.
    pub jacobian: Vec<f64>,
    /// -1 if a parameter is at its lower bound or fixed, 1 if it is at its upper bound, otherwise 0.
    pub active: Vec<i8>,
    /// Parameters that change with others: through linear equalities, and through linear inequalities that
    /// are active at the point.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dependent: Vec<Dependence>,
    /// Multipliers of the active linear inequalities, for the sum of squares.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub multipliers: Vec<ActiveConstraint>,
}

/// A parameter that changes with others while constraints stay active.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Dependence {
    /// Index of the parameter.
    pub index: usize,
    /// Its derivatives with respect to the parameters, in the user's units, one per parameter. Entries of
    /// dependent parameters and of parameters that are fixed or at a bound are zero.
    pub coefficients: Vec<f64>,
}

/// Coefficients of active inequalities below this fraction of the largest one are rounding errors.
const NEGLIGIBLE: f64 = 1e-12;

/// Number of rows of the Jacobian that are factorised together. This many rows of ten columns fit into a
/// cache.
const ROWS_AT_ONCE: usize = 1 << 12;

impl LinearModel {
    /// Creates the model at the point `x` with `m` residuals. `derivative(i, k)` is the derivative of
    /// residual `i` with respect to working coordinate `k`. `None` if a derivative is not finite in the
    /// user's units.
    pub(crate) fn new(
        space: &Space,
        x: &[f64],
        m: usize,
        derivative: impl Fn(usize, usize) -> f64,
    ) -> Option<Self> {
        let n = space.n();
        let (jacobian, active) = (vec![0.0; m * n], vec![-1; n]);
        let mut model = Self { jacobian, active, dependent: Vec::new(), multipliers: Vec::new() };
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

    /// Adds the parameters that depend on others through linear constraints, and the multipliers.
    /// `gradient(k)` is the derivative of the cost with respect to working coordinate `k`, and `hessian(k,
    /// j)` the second derivative of its Gauss-Newton model.
    pub(crate) fn constrain(
        &mut self,
        space: &Space,
        x: &[f64],
        gradient: impl Fn(usize) -> f64,
        hessian: impl Fn(usize, usize) -> f64,
    ) {
        let (n, free) = (space.n_free(), space.free());
        let mut u = vec![0.0; n];
        space.to_working(x, &mut u);
        let per_unit = |k: usize| match space.transform(k) {
            Transform::Linear => 1.0,
            Transform::Log => x[free[k]],
        };
        let is_active = |row: &&(usize, HalfSpace)| {
            let size: f64 = row.1.normal.iter().map(|a| a.abs()).sum();
            row.1.limit <= AT_BOUND * size
        };
        // In units of the sizes, relative to the point.
        let row = |(place, row): (usize, &HalfSpace)| {
            let normal = row.normal.iter().enumerate().map(|(k, a)| a * space.size(k)).collect();
            (place, HalfSpace { normal, limit: row.limit - row.value(&u) })
        };
        let rows: Vec<(usize, HalfSpace)> = space.rows().iter().enumerate().map(row).collect();
        let active: Vec<&(usize, HalfSpace)> = rows.iter().filter(is_active).collect();
        let loose: Vec<usize> = (0..n).filter(|k| self.active[free[*k]] == 0).collect();
        let eliminated = eliminated(active.iter().map(|(_, row)| &row.normal[..]), &loose);
        // Derivatives of the working coordinates with respect to the independent parameters.
        let change = |k: usize| {
            let mut change = vec![0.0; space.n()];
            match eliminated.iter().find(|(pivot, _)| *pivot == k) {
                Some((_, shares)) => shares.iter().for_each(|(j, share)| {
                    change[free[*j]] = share * space.size(k) / space.size(*j) / per_unit(*j);
                }),
                None if loose.contains(&k) => change[free[k]] = 1.0 / per_unit(k),
                None => {}
            }
            change
        };
        for (k, _) in &eliminated {
            let coefficients = change(*k).iter().map(|c| c * per_unit(*k)).collect();
            self.dependent.push(Dependence { index: free[*k], coefficients });
        }
        let changes: Vec<Vec<f64>> = (0..n).map(change).collect();
        for (index, shares) in space.dependents() {
            let mut coefficients = vec![0.0; space.n()];
            for (share, change) in shares.iter().zip(&changes) {
                coefficients.iter_mut().zip(change).for_each(|(to, c)| *to += share * c);
            }
            self.active[index] = 0;
            self.dependent.push(Dependence { index, coefficients });
        }
        self.dependent.sort_by_key(|dependence| dependence.index);
        // Multipliers of the Gauss-Newton step. An error of the Jacobian along a direction of high curvature
        // hardly changes them, unlike those of the steepest descent.
        let scaled = |k: usize| space.size(k);
        let gradient: Vec<f64> = (0..n).map(|k| gradient(k) * scaled(k)).collect();
        let mut hessian = DMatrix::from_fn(n, n, |i, j| hessian(i, j) * scaled(i) * scaled(j));
        let least = f64::EPSILON * hessian.diagonal().amax();
        (0..n).for_each(|k| hessian[(k, k)] += least.max(f64::MIN_POSITIVE));
        let bound = |k: usize| {
            let mut normal = vec![0.0; n];
            normal[k] = f64::from(self.active[free[k]]);
            HalfSpace { normal, limit: 0.0 }
        };
        let held = (0..n).filter(|k| self.active[free[*k]] != 0).map(bound);
        let zero = |row: &HalfSpace| HalfSpace { limit: 0.0, ..row.clone() };
        let all: Vec<HalfSpace> = active.iter().map(|(_, row)| zero(row)).chain(held).collect();
        let found =
            Cholesky::new(hessian).and_then(|hessian| quadratic_program::minimize(&hessian, &gradient, &all));
        for (place, multiplier) in found.map_or_else(Vec::new, |found| found.active) {
            let Some((row, _)) = active.get(place) else { continue };
            if let Some(index) = space.origin_of_row(*row) {
                let multiplier = multiplier / space.limit_slope(*row, x);
                self.multipliers.push(ActiveConstraint { is_linear: true, index, multiplier });
            }
        }
    }
}

/// Solves the rows, set to zero, for some of the coordinates: Gauss-Jordan elimination with complete
/// pivoting. Returns each of these coordinates with the coefficients of the others.
fn eliminated<'a>(
    rows: impl Iterator<Item = &'a [f64]>,
    coordinates: &[usize],
) -> Vec<(usize, Vec<(usize, f64)>)> {
    let mut rows: Vec<Vec<f64>> =
        rows.map(|row| coordinates.iter().map(|k| row[*k]).collect::<Vec<f64>>()).collect();
    let most = |row: &[f64]| row.iter().fold(0.0f64, |most, a| most.max(a.abs()));
    for row in &mut rows {
        let largest = most(row);
        row.iter_mut().for_each(|a| *a = if largest > 0.0 { *a / largest } else { 0.0 });
    }
    let mut pivots: Vec<(usize, usize)> = Vec::new();
    loop {
        let open = (0..rows.len()).filter(|i| pivots.iter().all(|(other, _)| other != i));
        let places = open.flat_map(|i| (0..coordinates.len()).map(move |k| (i, k)));
        // With equal coefficients, the last parameter becomes dependent.
        let best = places.fold((0, 0, 0.0), |best, (i, k)| {
            if rows[i][k].abs() >= best.2 { (i, k, rows[i][k].abs()) } else { best }
        });
        let (i, k, size) = best;
        if size <= NEGLIGIBLE {
            break;
        }
        pivots.push((i, k));
        let pivot = rows[i][k];
        rows[i].iter_mut().for_each(|a| *a /= pivot);
        let row = rows[i].clone();
        for other in (0..rows.len()).filter(|other| *other != i) {
            let share = rows[other][k];
            rows[other].iter_mut().zip(&row).for_each(|(a, b)| *a -= share * b);
            rows[other][k] = 0.0;
        }
    }
    let is_pivot = |k: usize| pivots.iter().any(|(_, pivot)| *pivot == k);
    let others = |i: usize| (0..coordinates.len()).filter(|k| !is_pivot(*k)).map(move |k| (i, k));
    let shares = |i: usize| others(i).map(|(i, k)| (coordinates[k], -rows[i][k])).collect();
    pivots.iter().map(|(i, k)| (coordinates[*k], shares(*i))).collect()
}

/// Uncertainty of the parameters of a fit, see [`Report::covariance`](crate::Report::covariance).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Covariance {
    /// Covariance matrix, row by row, n x n, in the user's units. Parameters that the residuals do not
    /// determine have infinite variances, and the covariances between them are NaN. Entries of parameters at
    /// a bound are zero.
    pub matrix: Vec<f64>,
    /// Variance of a residual: the sum of squares divided by the degrees of freedom. NaN without degrees of
    /// freedom.
    pub variance: f64,
    /// Number of residuals minus the number of free parameters that are not at a bound and do not depend on
    /// others.
    pub degrees_of_freedom: usize,
    /// Indices of parameters that the residuals do not determine.
    pub undetermined: Vec<usize>,
    /// Indices of parameters that are fixed or at a bound. They are treated as known.
    pub held: Vec<usize>,
    /// Indices of parameters that follow from others through equalities or active inequalities. Their
    /// variances result from those of the others.
    pub dependent: Vec<usize>,
}

impl Covariance {
    /// Computes `s^2 (J' J)^-1` of the parameters that are not held, with `s^2 = r' r / (m - n)` (Seber and
    /// Wild, Nonlinear Regression, 1989, section 2.1.2). Uses a QR factorisation with column pivoting of J,
    /// with the columns of J scaled to length one.
    ///
    /// Returns `None` if there are many residuals and the context has ended.
    pub(crate) fn new(
        residuals: &[f64],
        jacobian: &[f64],
        active: &[i8],
        dependent: &[Dependence],
        context: &RunContext<'_>,
    ) -> Option<Self> {
        let (m, n) = (residuals.len(), active.len());
        let (mut free, held): (Vec<usize>, Vec<usize>) = (0..n).partition(|&index| active[index] == 0);
        free.retain(|index| dependent.iter().all(|other| other.index != *index));
        let jacobian = with_dependent(jacobian, n, dependent);
        let jacobian = &*jacobian;
        let p = free.len();
        let degrees_of_freedom = m.saturating_sub(p);
        let variance = if degrees_of_freedom == 0 {
            f64::NAN
        } else {
            residuals.iter().map(|r| r * r).sum::<f64>() / degrees_of_freedom as f64
        };
        // Computes the column lengths without overflow. A zero column remains zero.
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
        // Adds rows block by block to the triangular factor of a QR factorisation.
        let mut columns = DMatrix::zeros(0, p);
        let blocks = jacobian.chunks(ROWS_AT_ONCE * n.max(1));
        for (block, rows) in blocks.enumerate().filter(|_| p > 0) {
            if block > 0 {
                if context.is_over() {
                    return None;
                }
                columns = columns.qr().r();
            }
            let above = columns.nrows();
            columns = DMatrix::from_fn(above + rows.len() / n, p, |i, k| match i.checked_sub(above) {
                Some(i) => rows[i * n + free[k]] / lengths[k],
                None => columns[(i, k)],
            });
        }
        let (inverse, determined) = inverse_of_normal_matrix(columns, p);
        let mut matrix = vec![0.0; n * n];
        for (a, &i) in free.iter().enumerate() {
            for (b, &j) in free.iter().enumerate() {
                let is_determined = degrees_of_freedom > 0 && (determined[a] || determined[b]);
                matrix[i * n + j] = match is_determined {
                    true => inverse[(a, b)] * (variance.sqrt() / lengths[a]) * (variance.sqrt() / lengths[b]),
                    false if a == b => f64::INFINITY,
                    false => f64::NAN,
                };
            }
        }
        let mut undetermined: Vec<usize> = free
            .iter()
            .zip(&determined)
            .filter(|(_, is_determined)| !**is_determined)
            .map(|(index, _)| *index)
            .collect();
        propagate(&mut matrix, n, &free, dependent);
        let open = |other: &&Dependence| undetermined.iter().any(|k| other.coefficients[*k] != 0.0);
        let more: Vec<usize> = dependent.iter().filter(open).map(|other| other.index).collect();
        undetermined.extend(more);
        undetermined.sort_unstable();
        let dependent = dependent.iter().map(|other| other.index).collect();
        Some(Self { matrix, variance, degrees_of_freedom, undetermined, held, dependent })
    }

    /// Returns remarks on the covariance, with these names of the parameters. Empty if there are none.
    pub fn message(&self, name: impl Fn(usize) -> String) -> String {
        let names =
            |indices: &[usize]| indices.iter().map(|index| name(*index)).collect::<Vec<_>>().join(", ");
        let mut reported = Vec::new();
        if self.variance.is_nan() && self.held.len() * self.held.len() < self.matrix.len() {
            reported.push(
                "there are not more residuals than parameters, so the variance cannot be estimated"
                    .to_owned(),
            );
        }
        if !self.undetermined.is_empty() {
            let what = "do not determine these parameters (other values fit equally well)";
            reported.push(format!("the residuals {what}: {}", names(&self.undetermined)));
        }
        if !self.held.is_empty() {
            reported.push(format!("at a bound or fixed, assumed to be known: {}", names(&self.held)));
        }
        if !self.dependent.is_empty() {
            reported.push(format!("follow from the others through constraints: {}", names(&self.dependent)));
        }
        reported.join("; ")
    }
}

/// Returns the derivatives with respect to the independent parameters: the columns of dependent parameters
/// are added to those of the others.
fn with_dependent<'a>(jacobian: &'a [f64], n: usize, dependent: &[Dependence]) -> Cow<'a, [f64]> {
    if dependent.is_empty() {
        return Cow::Borrowed(jacobian);
    }
    let mut whole = jacobian.to_vec();
    for row in whole.chunks_exact_mut(n) {
        for Dependence { index, coefficients } in dependent {
            let derivative = row[*index];
            row.iter_mut().zip(coefficients).for_each(|(to, c)| *to += derivative * c);
        }
    }
    Cow::Owned(whole)
}

/// Fills the rows and columns of dependent parameters in a covariance matrix: `T C T'`. The variance is
/// infinite if one of the parameters that it depends on has an infinite variance.
fn propagate(matrix: &mut [f64], n: usize, free: &[usize], dependent: &[Dependence]) {
    for Dependence { index, coefficients } in dependent {
        let used: Vec<usize> = free.iter().copied().filter(|k| coefficients[*k] != 0.0).collect();
        for j in 0..n {
            let sum = used.iter().map(|k| coefficients[*k] * matrix[k * n + j]).fold(0.0, |sum, c| sum + c);
            let covariance = if sum.is_finite() { sum } else { f64::NAN };
            (matrix[index * n + j], matrix[j * n + index]) = (covariance, covariance);
        }
        let variance: f64 =
            used.iter().map(|k| coefficients[*k] * matrix[index * n + k]).fold(0.0, |s, c| s + c);
        let is_known = used.iter().all(|k| matrix[k * n + k].is_finite());
        matrix[index * n + index] = if is_known { variance } else { f64::INFINITY };
    }
}

/// Computes a generalised inverse of `A' A` for columns of length one or zero. Also returns which unknowns do
/// not contribute to the null space. For these unknowns, all generalised inverses agree (Searle, Linear
/// Models, 1971, section 5.4).
fn inverse_of_normal_matrix(columns: DMatrix<f64>, p: usize) -> (DMatrix<f64>, Vec<bool>) {
    let mut inverse = DMatrix::zeros(p, p);
    if p == 0 || columns.nrows() == 0 || columns.iter().any(|a| !a.is_finite()) {
        return (inverse, vec![false; p]);
    }
    let qr = columns.col_piv_qr();
    let r = qr.r();
    let mut order = RowDVector::from_fn(p, |_, k| k);
    qr.p().permute_columns(&mut order);
    let diagonal: Vec<f64> = (0..r.nrows()).map(|k| r[(k, k)].abs()).collect();
    let smallest = RANK_TOLERANCE * diagonal.iter().copied().fold(0.0, f64::max);
    let rank = diagonal.iter().take_while(|d| **d > smallest).count();
    let mut determined = vec![true; p];
    order.iter().skip(rank).for_each(|k| determined[*k] = false);
    let kept = r.view((0, 0), (rank, rank));
    let (Some(root), Some(dependent)) = (
        kept.solve_upper_triangular(&DMatrix::identity(rank, rank)),
        kept.solve_upper_triangular(&r.view((0, rank), (rank, p - rank)).into_owned()),
    ) else {
        return (inverse, vec![false; p]);
    };
    for null in dependent.column_iter() {
        // The null vector has a one in the dependent column.
        let length = (1.0 + null.norm_squared()).sqrt();
        for (k, share) in null.iter().enumerate() {
            determined[order[k]] &= share.abs() <= RANK_TOLERANCE.sqrt() * length;
        }
    }
    let product = &root * root.transpose();
    for (a, &i) in order.iter().take(rank).enumerate() {
        order.iter().take(rank).enumerate().for_each(|(b, &j)| inverse[(i, j)] = product[(a, b)]);
    }
    (inverse, determined)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;

    fn computed(residuals: &[f64], jacobian: &[f64], active: &[i8]) -> Covariance {
        Covariance::new(residuals, jacobian, active, &[], &RunContext::new()).unwrap()
    }

    fn reported(covariance: &Covariance) -> String {
        covariance.message(|index| format!("x[{index}]"))
    }

    #[test]
    fn line_fit_has_textbook_variances() {
        // y = a + b t at t = 0, 1, 2, 3: (X' X)^-1 = [[0.7, -0.3], [-0.3, 0.2]].
        let jacobian: Vec<f64> = (0..4).flat_map(|t| [1.0, f64::from(t)]).collect();
        let residuals = [0.1, -0.2, 0.3, -0.1];
        let s2 = 0.15 / 2.0;
        let covariance = computed(&residuals, &jacobian, &[0, 0]);
        for (got, expected) in covariance.matrix.iter().zip([0.7, -0.3, -0.3, 0.2]) {
            assert!((got - s2 * expected).abs() < 1e-15, "{covariance:?}");
        }
        assert_eq!((covariance.degrees_of_freedom, reported(&covariance)), (2, String::new()));
        // With b at a bound, this is the variance of a mean.
        let covariance = computed(&residuals, &jacobian, &[0, 1]);
        assert!((covariance.matrix[0] - 0.05 / 4.0).abs() < 1e-15 && covariance.matrix[1..] == [0.0; 3]);
        assert_eq!(reported(&covariance), "at a bound or fixed, assumed to be known: x[1]");
    }

    #[test]
    fn covariance_is_independent_of_scales() {
        let jacobian: Vec<f64> = (0..4).flat_map(|t| [1e200, 1e-200 * f64::from(t)]).collect();
        let matrix = computed(&[0.1, -0.2, 0.3, -0.1], &jacobian, &[0, 0]).matrix;
        assert!((matrix[1] / (-0.3 * 0.075) - 1.0).abs() < 1e-12 && matrix[3] == f64::INFINITY, "{matrix:?}");
    }

    #[test]
    fn undetermined_parameters_are_infinite_and_named() {
        // Only a + b, and c, are determined.
        let jacobian: Vec<f64> = (0..5).flat_map(|t| [1.0, 1.0, f64::from(t)]).collect();
        let covariance = computed(&[1.0, -1.0, 0.5, 0.5, -1.0], &jacobian, &[0, 0, 0]);
        let of = |i: usize, j: usize| covariance.matrix[3 * i + j];
        assert!(of(0, 0) == f64::INFINITY && of(1, 1) == f64::INFINITY && of(0, 1).is_nan());
        assert!(of(2, 2).is_finite() && of(0, 2).is_finite());
        assert_eq!(covariance.undetermined, [0, 1]);
        assert!(
            reported(&covariance).ends_with("fit equally well): x[0], x[1]"),
            "{}",
            reported(&covariance)
        );
        let none = computed(&[1.0, 2.0], &[1.0, 0.0, 0.0, 1.0], &[0, 0]);
        assert!(none.matrix[0] == f64::INFINITY && none.matrix[1].is_nan() && none.variance.is_nan());
        let zero = computed(&[1.0, 2.0], &[1.0, 0.0, 1.0, 0.0], &[0, 0]);
        assert_eq!(zero.undetermined, [1]);
        assert_eq!(computed(&[], &[], &[-1]).matrix, [0.0]);
    }

    #[test]
    fn dependent_parameters_have_propagated_variances() {
        // y = a + b t with b = 1 - 2 a, so that dy/da = 1 - 2 t; c is fixed.
        let jacobian: Vec<f64> = (0..4).flat_map(|t| [1.0, f64::from(t), 7.0]).collect();
        let dependent = [Dependence { index: 1, coefficients: vec![-2.0, 0.0, 0.0] }];
        let residuals = [0.1, -0.2, 0.3, -0.1];
        let found =
            Covariance::new(&residuals, &jacobian, &[0, 0, -1], &dependent, &RunContext::new()).unwrap();
        // 1 + 1 + 9 + 25 = 36.
        let variance = 0.15 / 3.0 / 36.0;
        let expected = [1.0, -2.0, 0.0, -2.0, 4.0, 0.0, 0.0, 0.0, 0.0].map(|c| c * variance);
        let is_near = |(a, b): (&f64, f64)| (a - b).abs() < 1e-16;
        assert!(found.matrix.iter().zip(expected).all(is_near) && found.degrees_of_freedom == 3, "{found:?}");
        assert!(reported(&found).ends_with("follow from the others through constraints: x[1]"));
        let none =
            Covariance::new(&[1.0, 2.0], &[0.0; 4], &[0, 0], &dependent_on_first(), &RunContext::new());
        let none = none.unwrap();
        assert!(none.matrix[3] == f64::INFINITY && none.undetermined == [0, 1], "{none:?}");
    }

    fn dependent_on_first() -> [Dependence; 1] {
        [Dependence { index: 1, coefficients: vec![-1.0, 0.0] }]
    }

    #[test]
    fn derivatives_are_with_respect_to_the_parameters() {
        let bounds = Bounds::new(&[0.0, 1.0, 0.1], &[4.0, 1.0, 10.0]).unwrap();
        let log = [Transform::Linear, Transform::Linear, Transform::Log];
        let space = Space::new(&[4.0, 1.0, 2.0], bounds, &log, &[]).unwrap();
        let model = LinearModel::new(&space, space.x0(), 1, |_, k| [3.0, 5.0][k]).unwrap();
        assert_eq!((model.jacobian, model.active), (vec![3.0, 0.0, 2.5], vec![1, -1, 0]));
        assert_eq!(LinearModel::new(&space, space.x0(), 1, |_, _| f64::NAN), None);
    }
}
