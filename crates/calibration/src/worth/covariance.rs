//! The covariance of the parameters from the changes of the residuals, with the variances of the residuals that an estimator supposes.

use super::differences::Differences;
use super::residual_check::{autocorrelation, is_rounding, square_of_rounding};
use crate::layout::{OutputResiduals, ResidualLayout};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use std::ops::Range;

/// A parameter with more than this share in a combination that the residuals do not determine is not determined itself.
const SHARE: f64 = 0.03;

/// The residuals and what is supposed of them.
pub(crate) struct Noise {
    /// Variance of each residual.
    pub(crate) variances: Vec<f64>,
    /// Residuals in a row whose noise may be correlated, with the correlation of neighbours.
    pub(crate) series: Vec<(Range<usize>, f64)>,
    /// Residuals less free parameters.
    pub(crate) degrees_of_freedom: usize,
}

/// The factors of `C = G U' S U G'`, where S is the covariance of the residuals, and who is left out.
pub(crate) struct Factors {
    /// G, p x q, in the coordinates of the search.
    inverse: DMatrix<f64>,
    /// U, m x q: an orthonormal base of the changes that are no noise.
    base: DMatrix<f64>,
    /// Which of the p parameters the residuals do not determine.
    pub(crate) is_undetermined: Vec<bool>,
}

impl Noise {
    /// `by_output`: one variance for the residuals of each variable of the model, over all of its recordings with the same weight,
    /// `r'r / N_o N / (N - p)`; else, and where all residuals are rounding, one for all, `r'r / (N - p)`. Residuals of priors have the
    /// variance 1: they are measured in standard deviations.
    pub(crate) fn estimate(layout: &ResidualLayout, residuals: &[f64], p: usize, by_output: bool) -> Self {
        let n = residuals.len();
        let degrees_of_freedom = n.saturating_sub(p);
        let factor = n as f64 / degrees_of_freedom as f64;
        let is_all_rounding =
            layout.outputs.iter().all(|output| is_rounding(output, &residuals[output.range.clone()]));
        let group = |output| if by_output && !is_all_rounding { group(output) } else { ("", None) };
        let mut sums: BTreeMap<(&str, Option<u64>), (f64, usize)> = BTreeMap::new();
        for output in &layout.outputs {
            let sum = sums.entry(group(output)).or_default();
            let squares = residuals[output.range.clone()].iter().map(|r| r * r).sum::<f64>();
            // An exact output beside others: less than rounding would be a variance that rounding of the derivatives outweighs.
            let least = if is_all_rounding { 0.0 } else { square_of_rounding(output) };
            sum.0 += squares.max(least);
            sum.1 += output.range.len();
        }
        let mut variances = vec![1.0; n];
        for output in &layout.outputs {
            let (sum, count) = sums[&group(output)];
            variances[output.range.clone()].fill(if count > 0 { sum / count as f64 * factor } else { 0.0 });
        }
        let correlation = |range: &Range<usize>| autocorrelation(&residuals[range.clone()]);
        let series = layout.outputs.iter().map(|output| (output.range.clone(), correlation(&output.range)));
        Self { variances, series: series.collect(), degrees_of_freedom }
    }
}

impl Factors {
    /// By the singular values of the changes: combinations below the noise are left out.
    pub(crate) fn new(differences: &Differences) -> Self {
        let Differences { changes, steps, noise } = differences;
        let (m, p) = changes.shape();
        let rows = m.max(p);
        let svd = (p > 0)
            .then(|| changes.clone().resize_vertically(rows, 0.0).try_svd(true, true, f64::EPSILON, 10_000));
        let Some((u, values, v_t)) =
            svd.flatten().and_then(|svd| Some((svd.u?, svd.singular_values, svd.v_t?)))
        else {
            return Self {
                inverse: DMatrix::zeros(p, 0),
                base: DMatrix::zeros(m, 0),
                is_undetermined: vec![true; p],
            };
        };
        let largest = values.iter().copied().fold(0.0, f64::max);
        let least = noise.max(f64::EPSILON * rows as f64 * largest);
        let kept: Vec<usize> = (0..p).filter(|k| values[*k] > least).collect();
        let column = |k: &usize| steps * v_t.row(*k).transpose() / values[*k];
        let inverse: Vec<DVector<f64>> = kept.iter().map(column).collect();
        let base: Vec<DVector<f64>> = kept.iter().map(|k| u.column(*k).rows(0, m).into_owned()).collect();
        let mut is_undetermined = vec![false; p];
        // In a combination that is left out parameters are compared by the longest steps that were made with them.
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
        let columns = |columns: Vec<DVector<f64>>, rows: usize| match columns.is_empty() {
            true => DMatrix::zeros(rows, 0),
            false => DMatrix::from_columns(&columns),
        };
        Self { inverse: columns(inverse, p), base: columns(base, m), is_undetermined }
    }

    /// The covariance with uncorrelated residuals, in the coordinates of the search.
    pub(crate) fn covariance(&self, noise: &Noise) -> DMatrix<f64> {
        let mut weighted = self.base.clone();
        for mut column in weighted.column_iter_mut() {
            column.iter_mut().zip(&noise.variances).for_each(|(u, variance)| *u *= variance);
        }
        self.between(&weighted)
    }

    /// The same with residuals of each output that follow a first-order autoregression, `S_ij = s^2 rho^|i - j|`: the covariance of
    /// ordinary least squares with such errors (Seber and Wild, Nonlinear Regression, 1989, chapter 6). Negative rho count as zero.
    pub(crate) fn corrected(&self, noise: &Noise) -> DMatrix<f64> {
        let mut weighted = self.base.clone();
        for mut column in weighted.column_iter_mut() {
            column.iter_mut().zip(&noise.variances).for_each(|(u, variance)| *u *= variance);
            for (range, rho) in noise.series.iter().filter(|(_, rho)| *rho > 0.0) {
                let own: Vec<f64> = column.rows(range.start, range.len()).iter().copied().collect();
                let mut sums = own.clone();
                add_neighbours(*rho, &own, &mut sums, 0..own.len());
                add_neighbours(*rho, &own, &mut sums, (0..own.len()).rev());
                column.rows_mut(range.start, range.len()).copy_from_slice(&sums);
            }
        }
        self.between(&weighted)
    }

    fn between(&self, weighted: &DMatrix<f64>) -> DMatrix<f64> {
        &self.inverse * (self.base.transpose() * weighted) * self.inverse.transpose()
    }
}

/// Recordings that share a variance: those of a variable with the same constant weight, which states how large the noise is, and those
/// whose samples have weights of their own.
fn group(output: &OutputResiduals) -> (&str, Option<u64>) {
    let first = output.weights.first();
    let constant = first.filter(|first| output.weights.iter().all(|weight| weight == *first));
    (&output.variable, constant.map(|weight| weight.to_bits()))
}

/// Adds to each sum the values that come before it in this order, each with the power of rho that its distance is.
fn add_neighbours(rho: f64, values: &[f64], sums: &mut [f64], order: impl Iterator<Item = usize>) {
    let mut before = 0.0;
    for i in order {
        sums[i] += rho * before;
        before = values[i] + rho * before;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::OutputResiduals;

    fn layout(lengths: &[(&str, usize)]) -> ResidualLayout {
        let mut layout = ResidualLayout::default();
        for (variable, n) in lengths {
            let from = layout.n_measurements();
            layout.outputs.push(OutputResiduals {
                experiment: 0,
                output: 0,
                variable: (*variable).to_owned(),
                column: String::new(),
                range: from..from + n,
                times: vec![0.0; *n].into(),
                measured: vec![0.0; *n].into(),
                weights: vec![1.0; *n].into(),
            });
        }
        layout
    }

    fn line() -> Differences {
        // y = a + b t at t = 0, 1, 2, 3, with steps 2 and 0.5: (X'X)^-1 = [[0.7, -0.3], [-0.3, 0.2]].
        Differences {
            changes: DMatrix::from_fn(4, 2, |t, k| if k == 0 { 2.0 } else { 0.5 * t as f64 }),
            steps: DMatrix::from_diagonal(&DVector::from_vec(vec![2.0, 0.5])),
            noise: 1e-12,
        }
    }

    #[test]
    fn a_line_has_the_textbook_covariances() {
        let residuals = [0.1, -0.2, 0.3, -0.1];
        let pooled = Noise::estimate(&layout(&[("y", 4)]), &residuals, 2, false);
        let (factors, s2) = (Factors::new(&line()), 0.15 / 2.0);
        assert!((pooled.variances[0] - s2).abs() < 1e-15 && pooled.degrees_of_freedom == 2);
        let covariance = factors.covariance(&pooled);
        for (got, expected) in covariance.iter().zip([0.7, -0.3, -0.3, 0.2]) {
            assert!((got - s2 * expected).abs() < 1e-14, "{covariance}");
        }
        // Two outputs of two residuals each: (X'X)^-1 X'SX (X'X)^-1 by hand.
        let two = Noise::estimate(&layout(&[("y", 2), ("z", 2)]), &residuals, 2, true);
        let variances = [0.05, 0.05, 0.1, 0.1];
        let mut expected = DMatrix::zeros(2, 2);
        for (t, variance) in variances.iter().enumerate() {
            let t = t as f64;
            let row = DVector::from_vec(vec![0.7 - 0.3 * t, -0.3 + 0.2 * t]);
            expected += *variance * &row * row.transpose();
        }
        two.variances.iter().zip(variances).for_each(|(got, v)| assert!((got - v).abs() < 1e-15));
        assert!((factors.covariance(&two) - expected).amax() < 1e-14);
    }

    #[test]
    fn recordings_share_a_variance_where_their_weights_are_equal() {
        let residuals = [0.1, -0.1, 0.2, -0.2, 3.0, -3.0];
        let mut layout = layout(&[("y", 2), ("y", 2), ("y", 2)]);
        layout.outputs[2].weights = vec![10.0; 2].into();
        let noise = Noise::estimate(&layout, &residuals, 0, true);
        for (got, expected) in noise.variances.iter().zip([0.025, 0.025, 0.025, 0.025, 9.0, 9.0]) {
            assert!((got - expected).abs() < 1e-14, "{:?}", noise.variances);
        }
        // One exact output beside others has that of rounding.
        layout.outputs[2].measured = vec![1e14; 2].into();
        let variances = Noise::estimate(&layout, &residuals, 0, true).variances;
        assert!(
            (variances[0] - 0.025).abs() < 1e-14 && (variances[4] / 1e10 - 1.0).abs() < 1e-12,
            "{variances:?}"
        );
        // Rounding has no variances of its own.
        layout.outputs.iter_mut().for_each(|output| output.measured = vec![1e14; 2].into());
        let pooled = Noise::estimate(&layout, &residuals, 0, true).variances;
        assert!(pooled.iter().all(|variance| (variance - 18.1 / 6.0).abs() < 1e-14), "{pooled:?}");
    }

    #[test]
    fn autoregressive_residuals_have_the_covariance_of_their_toeplitz_matrix() {
        let rho: f64 = 0.6;
        let noise = Noise { variances: vec![2.0; 4], series: vec![(0..4, rho)], degrees_of_freedom: 2 };
        let x = DMatrix::from_fn(4, 2, |t, k| if k == 0 { 1.0 } else { t as f64 });
        let s = DMatrix::from_fn(4, 4, |i, j| 2.0 * rho.powi((i as i32 - j as i32).abs()));
        let inverse = (x.transpose() * &x).try_inverse().unwrap();
        let expected = &inverse * (x.transpose() * s * x) * &inverse;
        let got = Factors::new(&line()).corrected(&noise);
        assert!((&got - &expected).amax() < 1e-13, "{got} {expected}");
    }

    #[test]
    fn what_is_below_the_noise_is_not_determined() {
        // a + b up to noise, and c.
        let changes =
            DMatrix::from_fn(5, 3, |t, k| if k == 2 { t as f64 } else { 1.0 + 1e-9 * (t * t * k) as f64 });
        let differences =
            |noise| Differences { changes: changes.clone(), steps: DMatrix::identity(3, 3), noise };
        assert_eq!(Factors::new(&differences(1e-6)).is_undetermined, [true, true, false]);
        assert_eq!(Factors::new(&differences(0.0)).is_undetermined, [false; 3]);
        let none = Differences { changes: DMatrix::zeros(5, 1), steps: DMatrix::identity(1, 1), noise: 1e-9 };
        assert_eq!(Factors::new(&none).is_undetermined, [true]);
    }
}
