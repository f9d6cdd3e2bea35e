//! Factors of the covariance of the parameters, computed from the changes of the residuals.

use crate::error::CalibrationError;
use crate::uncertainty::differences::Differences;
use crate::uncertainty::row_blocks::{ThinSvd, thin_svd, triangle, weighted_products};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use std::ops::Range;

/// Share in an undetermined combination above which a parameter counts as undetermined.
const SHARE: f64 = 0.03;

/// Factors of `C = G U' S U G'`, where S is the covariance of the residuals, and the undetermined parameters.
pub(crate) struct Factors {
    /// G, p x q, in the coordinates of the search.
    pub(crate) inverse: DMatrix<f64>,
    /// U, m x q: an orthonormal base of the changes above the noise.
    pub(crate) base: DMatrix<f64>,
    /// True for each of the p parameters that the residuals do not determine.
    pub(crate) is_undetermined: Vec<bool>,
}

impl Factors {
    /// Computes the factors from the singular values of the changes. Combinations below the noise are left
    /// out.
    pub(crate) fn new(differences: &Differences, context: &RunContext<'_>) -> Result<Self, CalibrationError> {
        let Differences { changes, steps, noise, .. } = differences;
        let (m, p) = changes.shape();
        let Some(ThinSvd { u, values, v_t }) = thin_svd(changes, context)? else {
            return Ok(Self {
                inverse: DMatrix::zeros(steps.nrows(), 0),
                base: DMatrix::zeros(m, 0),
                is_undetermined: vec![true; steps.nrows()],
            });
        };
        let largest = values.iter().copied().fold(0.0, f64::max);
        let least = noise.max(f64::EPSILON * m.max(p) as f64 * largest);
        let kept: Vec<usize> = (0..p).filter(|k| values[*k] > least).collect();
        let column = |k: &usize| steps * v_t.row(*k).transpose() / values[*k];
        let inverse: Vec<DVector<f64>> = kept.iter().map(column).collect();
        let base = if kept.len() == p { u } else { u.select_columns(&kept) };
        let mut is_undetermined = vec![false; steps.nrows()];
        // In a combination that is left out, parameters are compared relative to their longest
        // steps.
        let sizes: Vec<f64> = steps.row_iter().map(|row| row.amax().max(f64::MIN_POSITIVE)).collect();
        for k in (0..p).filter(|k| !kept.contains(k)) {
            let shares: Vec<f64> = (steps * v_t.row(k).transpose())
                .iter()
                .zip(&sizes)
                .map(|(s, size)| (s / size).abs())
                .collect();
            let most = shares.iter().copied().fold(0.0, f64::max);
            for (flag, share) in is_undetermined.iter_mut().zip(&shares) {
                *flag |= *share > SHARE * most;
            }
        }
        let none = || DMatrix::zeros(steps.nrows(), 0);
        let inverse = if inverse.is_empty() { none() } else { DMatrix::from_columns(&inverse) };
        Ok(Self { inverse, base, is_undetermined })
    }

    /// Returns the covariance for uncorrelated residuals with these variances, in the coordinates of the
    /// search.
    pub(crate) fn covariance(
        &self,
        variances: &[f64],
        context: &RunContext<'_>,
    ) -> Result<DMatrix<f64>, CalibrationError> {
        let middle = weighted_products(&self.base, variances, context)?;
        Ok(&self.inverse * middle * self.inverse.transpose())
    }
}

/// Returns fewer rows with variances that have the same covariances, for all columns and for each selection
/// of columns. They are the triangles of the rows with equal variance.
pub(crate) fn compressed(
    rows: &DMatrix<f64>,
    variances: &[f64],
    context: &RunContext<'_>,
) -> Result<(DMatrix<f64>, Vec<f64>), CalibrationError> {
    let mut runs: BTreeMap<u64, Vec<Range<usize>>> = BTreeMap::new();
    let mut from = 0;
    for run in variances.chunk_by(|a, b| a.to_bits() == b.to_bits()) {
        runs.entry(run[0].to_bits()).or_default().push(from..from + run.len());
        from += run.len();
    }
    let (mut few, mut of_few) = (DMatrix::zeros(0, rows.ncols()), Vec::new());
    for (variance, ranges) in runs {
        let (rows_of_block, n_rows) = (triangle(rows, &ranges, context)?, few.nrows());
        of_few.resize(n_rows + rows_of_block.nrows(), f64::from_bits(variance));
        few = few.resize_vertically(n_rows + rows_of_block.nrows(), 0.0);
        few.rows_mut(n_rows, rows_of_block.nrows()).copy_from(&rows_of_block);
    }
    Ok((few, of_few))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factors(differences: &Differences) -> Factors {
        Factors::new(differences, &RunContext::new()).unwrap()
    }

    fn line() -> Differences {
        // The line is y = a + b t at t = 0, 1, 2, 3, with steps 2 and 0.5: (X'X)^-1 = [[0.7, -0.3],
        // [-0.3, 0.2]].
        let changes = DMatrix::from_fn(4, 2, |t, k| if k == 0 { 2.0 } else { 0.5 * t as f64 });
        Differences::of(changes, DMatrix::from_diagonal(&DVector::from_vec(vec![2.0, 0.5])), 1e-12)
    }

    #[test]
    fn covariance_of_line_matches_textbook() {
        let (factors, variances) = (factors(&line()), [0.3, 0.3, 0.2, 0.1]);
        let mut expected = DMatrix::zeros(2, 2);
        for (t, variance) in variances.iter().enumerate() {
            let t = t as f64;
            let row = DVector::from_vec(vec![0.7 - 0.3 * t, -0.3 + 0.2 * t]);
            expected += *variance * &row * row.transpose();
        }
        assert!((factors.covariance(&variances, &RunContext::new()).unwrap() - &expected).amax() < 1e-14);
        // The triangles of the rows of each variance have the same covariance.
        let Differences { changes, steps, noise, .. } = line();
        let (changes, variances) = compressed(&changes, &variances, &RunContext::new()).unwrap();
        let few = super::tests::factors(&Differences::of(changes, steps, noise));
        assert!((few.covariance(&variances, &RunContext::new()).unwrap() - expected).amax() < 1e-14);
    }

    #[test]
    fn factors_mark_parameters_undetermined_below_noise() {
        // The data determine a + b up to noise, and c.
        let changes =
            DMatrix::from_fn(5, 3, |t, k| if k == 2 { t as f64 } else { 1.0 + 1e-9 * (t * t * k) as f64 });
        let differences = |noise| Differences::of(changes.clone(), DMatrix::identity(3, 3), noise);
        assert_eq!(factors(&differences(1e-6)).is_undetermined, [true, true, false]);
        assert_eq!(factors(&differences(0.0)).is_undetermined, [false; 3]);
        let none = Differences::of(DMatrix::zeros(5, 1), DMatrix::identity(1, 1), 1e-9);
        assert_eq!(factors(&none).is_undetermined, [true]);
    }
}
