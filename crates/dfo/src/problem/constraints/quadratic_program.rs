//! Strictly convex quadratic programs with linear inequalities, by the dual active-set method of Goldfarb and
//! Idnani (Mathematical Programming 27, 1983, 1-33).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// The half-space `normal . x <= limit`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct HalfSpace {
    /// Normal, which points out of the half-space.
    pub(crate) normal: Vec<f64>,
    /// Largest value of `normal . x`.
    pub(crate) limit: f64,
}

impl HalfSpace {
    /// Returns `normal . x`, summed from left to right.
    pub(crate) fn value(&self, x: &[f64]) -> f64 {
        self.normal.iter().zip(x).map(|(a, x)| a * x).sum()
    }

    /// Returns the magnitude of the terms of `normal . x - limit`, which bounds their rounding error.
    pub(crate) fn magnitude(&self, x: &[f64]) -> f64 {
        self.normal.iter().zip(x).map(|(a, x)| (a * x).abs()).sum::<f64>() + self.limit.abs()
    }

    /// True if the point is in the half-space, without a tolerance.
    pub(crate) fn contains(&self, x: &[f64]) -> bool {
        self.value(x) <= self.limit
    }
}

/// Violations below this fraction of the terms of a row are rounding errors.
pub(crate) const ROUNDING: f64 = 16.0 * f64::EPSILON;
/// A normal whose part outside the active normals is shorter than this fraction depends on them.
const DEPENDENT: f64 = 1e-11;

/// A row that depends on the active ones and is violated by less than this fraction of its terms follows from
/// them up to rounding.
const IMPLIED: f64 = 1e-10;

/// Solution of a quadratic program.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Solution {
    /// The minimum.
    pub(crate) x: Vec<f64>,
    /// Indices of the active rows with their Lagrange multipliers, which are positive.
    pub(crate) active: Vec<(usize, f64)>,
}

/// Returns the minimum of `1/2 x' H x + g . x` in the intersection of half-spaces. `hessian` is the Cholesky
/// factorisation of `H`. Returns `None` if the intersection is empty, or if values are not finite.
pub(crate) fn minimize(
    hessian: &Cholesky<f64, Dyn>,
    gradient: &[f64],
    rows: &[HalfSpace],
) -> Option<Solution> {
    let n = gradient.len();
    let mut x = -hessian.solve(&DVector::from_column_slice(gradient));
    let lengths: Vec<f64> = rows.iter().map(|row| norm(&row.normal)).collect();
    // Steps from the first point have rounding errors of its magnitude, also if they end near zero.
    let first: Vec<f64> = rows.iter().map(|row| row.magnitude(x.as_slice())).collect();
    let mut implied: Vec<usize> = Vec::new();
    let mut active: Vec<(usize, f64)> = Vec::new();
    // Each turn adds a row to the active ones. No set of active rows occurs twice.
    for _ in 0..100 * (n + rows.len() + 1) {
        if !x.iter().all(|x| x.is_finite()) {
            return None;
        }
        let excess = |i: usize| {
            let row = &rows[i];
            let excess = row.value(x.as_slice()) - row.limit;
            let counts = excess > ROUNDING * first[i].max(row.magnitude(x.as_slice()));
            if counts && lengths[i] > 0.0 { excess / lengths[i] } else { 0.0 }
        };
        let is_active = |i: usize| implied.contains(&i) || active.iter().any(|(row, _)| *row == i);
        let worst = (0..rows.len()).filter(|i| !is_active(*i)).map(|i| (i, excess(i)));
        let worst = worst.fold((0, 0.0), |worst, next| if next.1 > worst.1 { next } else { worst });
        if worst.1 <= 0.0 {
            active.sort_by_key(|(row, _)| *row);
            return Some(Solution { x: x.as_slice().to_vec(), active });
        }
        if !enter(hessian, rows, worst.0, &mut x, &mut active)? {
            let row = &rows[worst.0];
            let terms = first[worst.0].max(row.magnitude(x.as_slice()));
            if row.value(x.as_slice()) - row.limit > IMPLIED * terms {
                return None;
            }
            implied.push(worst.0);
        }
    }
    None
}

/// Makes a violated row active, and removes the rows whose multipliers become negative on the way. Returns
/// false if no point satisfies the row and the active ones, and `None` if values are not finite.
fn enter(
    hessian: &Cholesky<f64, Dyn>,
    rows: &[HalfSpace],
    entering: usize,
    x: &mut DVector<f64>,
    active: &mut Vec<(usize, f64)>,
) -> Option<bool> {
    let row = &rows[entering];
    // In coordinates in which the Hessian is the identity.
    let turned = |row: &HalfSpace| {
        let mut normal = DVector::from_column_slice(&row.normal);
        hessian.l_dirty().solve_lower_triangular_mut(&mut normal);
        normal
    };
    let normal = turned(row);
    let mut multiplier = 0.0;
    // Each turn but the last removes a row.
    for _ in 0..=active.len() {
        let (mut rest, mut shares) = (normal.clone(), DVector::zeros(active.len()));
        if !active.is_empty() {
            let columns: Vec<DVector<f64>> = active.iter().map(|(i, _)| turned(&rows[*i])).collect();
            let qr = DMatrix::from_columns(&columns).qr();
            let (q, r) = qr.unpack();
            let mut inside = q.tr_mul(&normal);
            rest -= &q * &inside;
            if !r.solve_upper_triangular_mut(&mut inside) {
                return None;
            }
            shares = inside;
        }
        let dual = active.iter().zip(shares.iter()).enumerate();
        let dual = dual.filter(|(_, (_, share))| **share > 0.0).map(|(k, ((_, u), share))| (k, u / share));
        let (leaving, dual) =
            dual.fold((None, f64::INFINITY), |least, (k, t)| if t < least.1 { (Some(k), t) } else { least });
        let squared = rest.norm_squared();
        let excess = row.value(x.as_slice()) - row.limit;
        let primal = if squared > DEPENDENT * DEPENDENT * normal.norm_squared() {
            excess / squared
        } else {
            f64::INFINITY
        };
        let step = primal.min(dual);
        if !step.is_finite() {
            return Some(false);
        }
        active.iter_mut().zip(shares.iter()).for_each(|((_, u), share)| *u = (*u - step * share).max(0.0));
        multiplier += step;
        if primal.is_finite() {
            let mut direction = rest;
            hessian.l_dirty().tr_solve_lower_triangular_mut(&mut direction);
            x.axpy(-step, &direction, 1.0);
        }
        match leaving.filter(|_| dual < primal) {
            Some(k) => _ = active.remove(k),
            None => {
                active.push((entering, multiplier));
                return Some(true);
            }
        }
    }
    None
}

/// Returns the Cholesky factorisation of the identity.
pub(crate) fn identity(n: usize) -> Option<Cholesky<f64, Dyn>> {
    Cholesky::new(DMatrix::identity(n, n))
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(normal: &[f64], limit: f64) -> HalfSpace {
        HalfSpace { normal: normal.to_vec(), limit }
    }

    /// Example of Goldfarb and Idnani, section 7: minimum (1, 1/3) after one row is dropped.
    #[test]
    fn minimize_solves_a_program_that_drops_a_row() {
        let hessian = Cholesky::new(DMatrix::from_row_slice(2, 2, &[4.0, -2.0, -2.0, 4.0])).unwrap();
        let rows = [row(&[-1.0, 0.0], 0.0), row(&[0.0, -1.0], 0.0), row(&[-1.0, -1.0], -2.0)];
        let solution = minimize(&hessian, &[6.0, 0.0], &rows).unwrap();
        assert!((solution.x[0] - 0.5).abs() < 1e-14 && (solution.x[1] - 1.5).abs() < 1e-14, "{solution:?}");
        assert_eq!(solution.active.len(), 1);
        assert!(solution.active[0].0 == 2 && (solution.active[0].1 - 5.0).abs() < 1e-13, "{solution:?}");
    }

    #[test]
    fn minimize_recognises_empty_sets() {
        let rows = [row(&[1.0, 1.0], 1.0), row(&[-1.0, -1.0], -1.1)];
        assert_eq!(minimize(&identity(2).unwrap(), &[0.0, 0.0], &rows), None);
        let parallel = [row(&[1.0, 1.0], 1.0), row(&[2.0, 2.0], 2.0), row(&[-1.0, -1.0], -1.0)];
        let solution = minimize(&identity(2).unwrap(), &[-3.0, -1.0], &parallel).unwrap();
        assert!((solution.x[0] - 1.5).abs() < 1e-14 && (solution.x[1] + 0.5).abs() < 1e-14, "{solution:?}");
    }

    /// The minimum satisfies the conditions of Karush, Kuhn and Tucker.
    #[test]
    fn minimize_satisfies_the_optimality_conditions() {
        let mut state = 11u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let mut n_active = 0;
        for case in 0..300 {
            let n = 1 + case % 7;
            let root = DMatrix::from_fn(n, n, |_, _| random());
            let h = &root * root.transpose() + DMatrix::identity(n, n) * 1e-3;
            let gradient: Vec<f64> = (0..n).map(|_| 4.0 * random()).collect();
            let rows: Vec<HalfSpace> = (0..case % 11)
                .map(|_| row(&(0..n).map(|_| random()).collect::<Vec<_>>(), 0.5 + random()))
                .collect();
            let Solution { x, active } =
                minimize(&Cholesky::new(h.clone()).unwrap(), &gradient, &rows).unwrap();
            let mut slope = &h * DVector::from_column_slice(&x) + DVector::from_column_slice(&gradient);
            for (i, multiplier) in &active {
                assert!(*multiplier >= 0.0);
                assert!((rows[*i].value(&x) - rows[*i].limit).abs() < 1e-9);
                slope += DVector::from_column_slice(&rows[*i].normal) * *multiplier;
            }
            n_active += active.len();
            assert!(slope.norm() < 1e-9, "case {case}: {slope}");
            assert!(rows.iter().all(|row| row.value(&x) <= row.limit + 1e-12));
        }
        assert!(n_active > 200, "{n_active}");
    }
}
