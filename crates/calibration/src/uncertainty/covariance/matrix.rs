//! The covariance of the parameters from the changes of the residuals, with the variances of the residuals
//! that an estimator supposes.

use crate::error::CalibrationError;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::covariance::autocorrelation::Group;
use crate::uncertainty::diagnostics::residual_check::{is_rounding, square_of_rounding};
use crate::uncertainty::differences::Differences;
use crate::uncertainty::p_values::OfIndependent;
use crate::uncertainty::result::Estimator;
use crate::uncertainty::row_blocks::{ThinSvd, inner_products, thin_svd, triangle, weighted_products};
use crate::uncertainty::scores::{Criterion, Working};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use std::ops::Range;

/// A parameter with more than this share in a combination that the residuals do not determine is not
/// determined itself.
const SHARE: f64 = 0.03;

/// A variance without bias that is below this part of the mean square is that of chance: a group says nothing
/// of its own.
const LEAST: f64 = 0.05;

/// Assumptions on the noise of the residuals.
pub(crate) struct Noise {
    /// Variance of each residual, if they are independent.
    pub(crate) variances: Vec<f64>,
    /// Those that share a variance.
    pub(crate) groups: Vec<Group>,
    /// Residuals less free parameters.
    pub(crate) degrees_of_freedom: usize,
}

/// The factors of `C = G U' S U G'`, where S is the covariance of the residuals, and who is left out.
pub(crate) struct Factors {
    /// G, p x q, in the coordinates of the search.
    pub(crate) inverse: DMatrix<f64>,
    /// U, m x q: an orthonormal base of the changes that are no noise.
    pub(crate) base: DMatrix<f64>,
    /// True for those of the p parameters that the residuals do not determine.
    pub(crate) is_undetermined: Vec<bool>,
}

/// Outputs that share a variance, by number: those of a variable of the model, over all of its recordings
/// with the same weight ([`Estimator::Sandwich`]) or with any (the likelihood); one group of all with
/// [`Estimator::Pooled`], and where all residuals are rounding.
pub(crate) fn groups(
    layout: &ResidualLayout,
    residuals: &[f64],
    estimator: Estimator,
    criterion: Criterion,
) -> Vec<Vec<usize>> {
    let is_all_rounding =
        layout.outputs.iter().all(|output| is_rounding(output, &residuals[output.range.clone()]));
    let mut groups: BTreeMap<(&str, Option<u64>), Vec<usize>> = BTreeMap::new();
    for (k, output) in layout.outputs.iter().enumerate() {
        let key = match (estimator, criterion) {
            (_, Criterion::Likelihood) => (output.variable.as_str(), None),
            (Estimator::Sandwich, _) if !is_all_rounding => group(output),
            _ => ("", None),
        };
        groups.entry(key).or_default().push(k);
    }
    groups.into_values().collect()
}

impl Noise {
    /// The variances of the groups are without bias: of residuals `r = M e` with `M = I - U U'`, U an
    /// orthonormal base of the changes that the parameters make, the mean of `r_g'r_g` is the sum over the
    /// groups of their variances times `tr(M_gh M_hg)` (Searle, Casella and McCulloch, Variance Components,
    /// 1992, section 5.2). Of one group it is `r'r / (N - p)`. Where this leaves no variance to one of
    /// several, all are `r'r / N_g N / (N - p)`. Residuals of priors have the variance 1: they are measured
    /// in standard deviations.
    pub(crate) fn estimate(
        layout: &ResidualLayout,
        plain: &[f64],
        working: &Working,
        groups: &[Vec<usize>],
        base: &DMatrix<f64>,
        p: usize,
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let n = working.residuals.len();
        let degrees_of_freedom = n.saturating_sub(p);
        let is_rounded = |output: &OutputResiduals| is_rounding(output, &plain[output.range.clone()]);
        let is_all_rounding = layout.outputs.iter().all(is_rounded);
        let outputs = |g: usize| groups[g].iter().map(|k| &layout.outputs[*k]);
        let sum = |output: &OutputResiduals| {
            let squares = working.residuals[output.range.clone()].iter().map(|r| r * r).sum::<f64>();
            // An exact output beside others: less than rounding would be a variance that rounding of the derivatives outweighs.
            let root = working.roots[output.range.start];
            squares.max(if is_all_rounding { 0.0 } else { root * root * square_of_rounding(output) })
        };
        let sums: Vec<f64> = (0..groups.len()).map(|g| outputs(g).map(sum).sum()).collect();
        let counts: Vec<usize> =
            (0..groups.len()).map(|g| outputs(g).map(|output| output.range.len()).sum()).collect();
        let gram = |range: Range<usize>| {
            let rows = base.rows(range.start, range.len());
            inner_products(rows.as_view(), rows.as_view(), context)
        };
        let zero = || DMatrix::zeros(base.ncols(), base.ncols());
        let of_group = |g: usize| -> Result<DMatrix<f64>, CalibrationError> {
            outputs(g).try_fold(zero(), |sum, output| Ok(sum + gram(output.range.clone())?))
        };
        let grams: Vec<DMatrix<f64>> = (0..groups.len()).map(of_group).collect::<Result<_, _>>()?;
        let of_priors = (layout.n_measurements()..n).try_fold(zero(), |sum, i| {
            Ok::<_, CalibrationError>(sum + gram(i..i + 1)? * working.corrections[i])
        })?;
        let shares = DMatrix::from_fn(groups.len(), groups.len(), |g, h| {
            let own = if g == h { counts[g] as f64 - 2.0 * grams[g].trace() } else { 0.0 };
            own + grams[g].dot(&grams[h])
        });
        let left = (sums.iter().zip(&grams)).map(|(sum, gram)| sum - gram.dot(&of_priors));
        let left = DVector::from_iterator(groups.len(), left);
        let plainly = |g: usize| match counts[g] {
            0 => 0.0,
            count => sums[g] / count as f64 * n as f64 / degrees_of_freedom as f64,
        };
        let found = shares.lu().solve(&left).filter(|found| {
            degrees_of_freedom > 0
                && (0..groups.len()).all(|g| found[g] > LEAST * plainly(g) || sums[g] == 0.0)
        });
        let mut variances = working.corrections.clone();
        let of_group = |g: usize| {
            let correction = outputs(g).next().map_or(1.0, |output| working.corrections[output.range.start]);
            let variance = found.as_ref().map_or_else(|| plainly(g), |found| found[g].max(0.0)) * correction;
            outputs(g).for_each(|output| variances[output.range.clone()].fill(variance));
            let series = outputs(g).map(|output| output.range.clone()).collect();
            Group { series, variance, correction, is_rounding: outputs(g).all(is_rounded) }
        };
        let groups = (0..groups.len()).map(of_group).collect();
        Ok(Self { variances, groups, degrees_of_freedom })
    }
}

impl Noise {
    /// The covariance that independent errors leave to the residuals of each output, U the base; none where
    /// all have many.
    pub(crate) fn of_independent(
        &self,
        layout: &ResidualLayout,
        base: &DMatrix<f64>,
        context: &RunContext<'_>,
    ) -> Result<Vec<OfIndependent>, CalibrationError> {
        if layout.outputs.iter().all(|output| OfIndependent::is_of_many(output.range.len())) {
            return Ok(Vec::new());
        }
        let middle = weighted_products(base, &self.variances, context)?;
        let of = |output: &OutputResiduals| {
            let rows = base.rows(output.range.start, output.range.len());
            OfIndependent::of_fit(rows.as_view(), &(&middle / self.variances[output.range.start]))
        };
        Ok(layout.outputs.iter().map(of).collect())
    }
}

impl Factors {
    /// By the singular values of the changes: combinations below the noise are left out.
    pub(crate) fn new(differences: &Differences, context: &RunContext<'_>) -> Result<Self, CalibrationError> {
        let Differences { changes, steps, noise, .. } = differences;
        let (m, p) = changes.shape();
        let Some(ThinSvd { u, values, v_t }) = thin_svd(changes, context)? else {
            return Ok(Self {
                inverse: DMatrix::zeros(p, 0),
                base: DMatrix::zeros(m, 0),
                is_undetermined: vec![true; p],
            });
        };
        let largest = values.iter().copied().fold(0.0, f64::max);
        let least = noise.max(f64::EPSILON * m.max(p) as f64 * largest);
        let kept: Vec<usize> = (0..p).filter(|k| values[*k] > least).collect();
        let column = |k: &usize| steps * v_t.row(*k).transpose() / values[*k];
        let inverse: Vec<DVector<f64>> = kept.iter().map(column).collect();
        let base = if kept.len() == p { u } else { u.select_columns(&kept) };
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
        let inverse = if inverse.is_empty() { DMatrix::zeros(p, 0) } else { DMatrix::from_columns(&inverse) };
        Ok(Self { inverse, base, is_undetermined })
    }

    /// The covariance with uncorrelated residuals of these variances, in the coordinates of the search.
    pub(crate) fn covariance(
        &self,
        variances: &[f64],
        context: &RunContext<'_>,
    ) -> Result<DMatrix<f64>, CalibrationError> {
        let middle = weighted_products(&self.base, variances, context)?;
        Ok(&self.inverse * middle * self.inverse.transpose())
    }
}

/// Fewer rows with their variances that have the covariances of all, and of each choice of columns: the
/// triangle of the rows of each variance.
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
        let (own, known) = (triangle(rows, &ranges, context)?, few.nrows());
        of_few.resize(known + own.nrows(), f64::from_bits(variance));
        few = few.resize_vertically(known + own.nrows(), 0.0);
        few.rows_mut(known, own.nrows()).copy_from(&own);
    }
    Ok((few, of_few))
}

/// Recordings that share a variance: those of a variable with the same constant weight, which states how
/// large the noise is, and those whose samples have weights of their own.
fn group(output: &OutputResiduals) -> (&str, Option<u64>) {
    let first = output.weights.first();
    let constant = first.filter(|first| output.weights.iter().all(|weight| weight == *first));
    (&output.variable, constant.map(|weight| weight.to_bits()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::residual_layout::OutputResiduals;

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

    fn estimate(
        layout: &ResidualLayout,
        residuals: &[f64],
        base: &DMatrix<f64>,
        estimator: Estimator,
    ) -> Noise {
        let criterion = Criterion::default();
        let groups = groups(layout, residuals, estimator, criterion);
        let working = Working::new(criterion, layout, residuals, &groups, base.ncols());
        Noise::estimate(layout, residuals, &working, &groups, base, base.ncols(), &RunContext::new()).unwrap()
    }

    fn factors(differences: &Differences) -> Factors {
        Factors::new(differences, &RunContext::new()).unwrap()
    }

    fn line() -> Differences {
        // y = a + b t at t = 0, 1, 2, 3, with steps 2 and 0.5: (X'X)^-1 = [[0.7, -0.3], [-0.3, 0.2]].
        let changes = DMatrix::from_fn(4, 2, |t, k| if k == 0 { 2.0 } else { 0.5 * t as f64 });
        Differences::of(changes, DMatrix::from_diagonal(&DVector::from_vec(vec![2.0, 0.5])), 1e-12)
    }

    #[test]
    fn a_line_has_the_textbook_covariances() {
        let residuals = [0.1, -0.2, 0.3, -0.1];
        let (factors, s2) = (factors(&line()), 0.15 / 2.0);
        let pooled = estimate(&layout(&[("y", 4)]), &residuals, &factors.base, Estimator::Pooled);
        assert!((pooled.variances[0] - s2).abs() < 1e-15 && pooled.degrees_of_freedom == 2);
        let covariance = factors.covariance(&pooled.variances, &RunContext::new()).unwrap();
        for (got, expected) in covariance.iter().zip([0.7, -0.3, -0.3, 0.2]) {
            assert!((got - s2 * expected).abs() < 1e-14, "{covariance}");
        }
        // Two outputs of two residuals each: (X'X)^-1 X'SX (X'X)^-1 by hand.
        let two = estimate(&layout(&[("y", 2), ("z", 2)]), &residuals, &factors.base, Estimator::Sandwich);
        // The squares of the entries of M = I - X (X'X)^-1 X' in the blocks (0, 0), (0, 1) and (1, 1), by symmetry: those of
        // [[3, -4, -1, 2], [-4, 7, -2, -1], [-1, -2, 7, -4], [2, -1, -4, 3]] / 10.
        let (own, other) = (0.9, 0.1);
        let solved = |a: f64, b: f64| (own * a - other * b) / (own * own - other * other);
        let (first, second) = (solved(0.05, 0.1), solved(0.1, 0.05));
        let variances = [first, first, second, second];
        let mut expected = DMatrix::zeros(2, 2);
        for (t, variance) in variances.iter().enumerate() {
            let t = t as f64;
            let row = DVector::from_vec(vec![0.7 - 0.3 * t, -0.3 + 0.2 * t]);
            expected += *variance * &row * row.transpose();
        }
        two.variances.iter().zip(variances).for_each(|(got, v)| assert!((got - v).abs() < 1e-15));
        assert!((factors.covariance(&two.variances, &RunContext::new()).unwrap() - &expected).amax() < 1e-14);
        // Triangles of the rows of each variance have the same.
        let Differences { changes, steps, noise, .. } = line();
        let (changes, variances) = compressed(&changes, &two.variances, &RunContext::new()).unwrap();
        let few = super::tests::factors(&Differences::of(changes, steps, noise));
        assert!((few.covariance(&variances, &RunContext::new()).unwrap() - expected).amax() < 1e-14);
    }

    #[test]
    fn recordings_share_a_variance_where_their_weights_are_equal() {
        let residuals = [0.1, -0.1, 0.2, -0.2, 3.0, -3.0];
        let mut layout = layout(&[("y", 2), ("y", 2), ("y", 2)]);
        layout.outputs[2].weights = vec![10.0; 2].into();
        let noise = estimate(&layout, &residuals, &DMatrix::zeros(6, 0), Estimator::Sandwich);
        for (got, expected) in noise.variances.iter().zip([0.025, 0.025, 0.025, 0.025, 9.0, 9.0]) {
            assert!((got - expected).abs() < 1e-14, "{:?}", noise.variances);
        }
        // One exact output beside others has that of rounding.
        layout.outputs[2].measured = vec![1e14; 2].into();
        let variances = estimate(&layout, &residuals, &DMatrix::zeros(6, 0), Estimator::Sandwich).variances;
        assert!(
            (variances[0] - 0.025).abs() < 1e-14 && (variances[4] / 1e10 - 1.0).abs() < 1e-12,
            "{variances:?}"
        );
        // Rounding has no variances of its own.
        layout.outputs.iter_mut().for_each(|output| output.measured = vec![1e14; 2].into());
        let pooled = estimate(&layout, &residuals, &DMatrix::zeros(6, 0), Estimator::Sandwich).variances;
        assert!(pooled.iter().all(|variance| (variance - 18.1 / 6.0).abs() < 1e-14), "{pooled:?}");
    }

    #[test]
    fn what_is_below_the_noise_is_not_determined() {
        // a + b up to noise, and c.
        let changes =
            DMatrix::from_fn(5, 3, |t, k| if k == 2 { t as f64 } else { 1.0 + 1e-9 * (t * t * k) as f64 });
        let differences = |noise| Differences::of(changes.clone(), DMatrix::identity(3, 3), noise);
        assert_eq!(factors(&differences(1e-6)).is_undetermined, [true, true, false]);
        assert_eq!(factors(&differences(0.0)).is_undetermined, [false; 3]);
        let none = Differences::of(DMatrix::zeros(5, 1), DMatrix::identity(1, 1), 1e-9);
        assert_eq!(factors(&none).is_undetermined, [true]);
    }
}
