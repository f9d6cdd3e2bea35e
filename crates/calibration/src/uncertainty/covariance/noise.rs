//! Noise of the residuals: one variance and one autocorrelation for each group of outputs. They are estimated
//! from the moments of the residuals of a fit, together with their precision.

use crate::error::CalibrationError;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::covariance::measured_start::MeasuredStart;
use crate::uncertainty::covariance::moments::{Moments, Variances};
use crate::uncertainty::diagnostics::residual_check::{is_rounding, square_of_rounding};
use crate::uncertainty::group::Group;
use crate::uncertainty::result::Estimator;
use crate::uncertainty::row_blocks::{ThinSvd, along, thin_svd};
use crate::uncertainty::scores::{Criterion, Working};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// Length below which a combination of columns of about unit length is rounding error.
const ROUNDING: f64 = 1e-10;

/// Returns the groups of the outputs. A group contains a variable of the model over all recordings with the
/// same weight ([`Estimator::Sandwich`]), or over all recordings (the likelihood). With
/// [`Estimator::Pooled`], or if all residuals are rounding errors, one group contains all outputs. Outputs
/// whose noise is known are a separate group, if the fit minimises the sum of squares; `is_noise_known`: all
/// outputs.
pub(crate) fn groups(
    layout: &ResidualLayout,
    residuals: &[f64],
    estimator: Estimator,
    criterion: Criterion,
    is_noise_known: bool,
) -> Vec<Group> {
    let is_all_rounding =
        layout.outputs.iter().all(|output| is_rounding(output, &residuals[output.range.clone()]));
    let mut groups: BTreeMap<(bool, &str, Option<u64>), Group> = BTreeMap::new();
    for (k, output) in layout.outputs.iter().enumerate() {
        let is_known = criterion.is_sum_of_squares() && (is_noise_known || output.is_noise_known);
        let (variable, weight) = match (estimator, criterion) {
            _ if is_known => ("", None),
            (_, Criterion::Likelihood) => (output.variable.as_str(), None),
            (Estimator::Sandwich, _) if !is_all_rounding => key(output),
            _ => ("", None),
        };
        let group = groups.entry((is_known, variable, weight)).or_default();
        group.is_known = is_known;
        group.outputs.push(k);
        let first = output.range.start;
        let rows: Vec<usize> = output.range.clone().filter(|i| output.weights[i - first] != 0.0).collect();
        group.starts.extend(rows.first().filter(|i| output.starts_simulation && **i == first));
        let runs = rows.chunk_by(|a, b| a + 1 == *b);
        group.series.extend(runs.map(|run| run[0]..run[run.len() - 1] + 1));
    }
    groups.into_values().collect()
}

/// Returns the key of recordings that share a variance. Recordings of a variable share it if they have the
/// same constant weight, because the weight declares the size of the noise. All recordings with separate
/// weights for their rows also share a variance.
fn key(output: &OutputResiduals) -> (&str, Option<u64>) {
    let first = output.weights.first();
    let constant = first.filter(|first| output.weights.iter().all(|weight| weight == *first));
    (&output.variable, constant.map(|weight| weight.to_bits()))
}

/// Noise of the working residuals: `S = sum_g s_g^2 (R_g + D_g D_g') + S_0`.
///
/// R_g is the correlation of a first-order autoregression over each series of a group. D_g contains the
/// changes of all residuals by one standard deviation of those measurements of the group that simulations
/// start from. S_0 is the identity for priors, whose residuals are in units of their standard deviations.
///
/// To estimate the noise, a measured initial state is one more parameter, and the row of its measurement is
/// an ordinary residual. S is then diagonal except for the autocorrelation.
pub(crate) struct Noise {
    /// Variance of each residual under the assumption of independence.
    pub(crate) variances: Vec<f64>,
    /// Number of rows with separate noise, minus the trace of a projection over these rows. The projection is
    /// onto the changes due to the parameters (Hastie and Tibshirani, Generalized Additive Models, 1990,
    /// section 3.5). A prior removes no degree of freedom. The measurements lose degrees of freedom only for
    /// what they determine themselves. Infinite if the noise of all outputs is known.
    pub(crate) degrees_of_freedom: f64,
    /// Model with independent residuals.
    pub(crate) independent: NoiseModel,
    /// Model with autocorrelated residuals, if any are.
    pub(crate) autocorrelated: Option<NoiseModel>,
    /// U'S_0 U.
    pub(crate) of_priors: DMatrix<f64>,
    /// Noise of measured initial states.
    pub(crate) starts: Vec<StartNoise>,
}

/// Noise of a measured initial state.
pub(crate) struct StartNoise {
    /// Group of the measurement.
    pub(crate) group: usize,
    /// Row of the measurement; `None` if it is not compared.
    row: Option<usize>,
    /// Standard deviation of the state divided by the standard deviation of a working residual of the group.
    pub(crate) scale: f64,
    /// Change of the working residuals by a change of the state that corresponds to one standard deviation of
    /// a working residual.
    change: DVector<f64>,
    /// U' times the change.
    pub(crate) along: DVector<f64>,
}

/// Estimates of the variances and autocorrelations. The noise parameters are the logarithms of the variances,
/// then `artanh rho` of each autocorrelated group.
pub(crate) struct NoiseModel {
    /// Variance of each group.
    pub(crate) variances: Vec<f64>,
    /// Autocorrelation at lag one of each group.
    pub(crate) autocorrelations: Vec<f64>,
    /// `U' dS U` for the derivative of S with respect to each noise parameter.
    pub(crate) slopes: Vec<DMatrix<f64>>,
    /// Covariance of the noise parameters.
    pub(crate) uncertainty: DMatrix<f64>,
}

impl Noise {
    /// Estimates the noise by equating the moments of the residuals of a fit to their expectations. The
    /// expectation of `r'B r` is `tr(B M S M)` (Searle, Casella and McCulloch, Variance Components, 1992,
    /// section 5.2). For the variance of a group, B is its sum of squares; for its autocorrelation, B is the
    /// sum of products of neighbours. The estimated autocorrelation is therefore corrected for the part that
    /// the fit has removed. Unlike the restricted likelihood, this method does not assume that the columns of
    /// the Jacobian are free of noise. The columns contain noise if weights are computed from measurements.
    ///
    /// A group is autocorrelated if its sum of products exceeds the sum of independent residuals by 1.96
    /// standard deviations. This is tested for residuals of one variance, and for residuals of any variances,
    /// `sum r_i^2 r_(i+1)^2` (Lo and MacKinlay, Rev. Financial Studies 1, 1988). The autocorrelation is at
    /// most `exp(-1 / n)`, for noise that lasts as long as the series. Longer noise is an offset. It is
    /// estimated from the residuals of the group without the changes due to the parameters. Otherwise the
    /// effect of a prior, or of the noise of another group, would look like autocorrelation.
    ///
    /// The covariance of the estimates is the covariance of quadratic forms of normal errors: `cov(r'B r, r'C
    /// r) = 2 tr(B M S M C M S M)`. It uses the residuals of the whole fit, also for autocorrelations.
    ///
    /// The unbiased equations may leave no variance for one of several groups. All groups then use the
    /// variance `r'r / n_g` times N divided by the degrees of freedom.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Cancelled`] if the context has ended.
    pub(crate) fn estimate(
        layout: &ResidualLayout,
        plain: &[f64],
        working: &Working,
        groups: &[Group],
        starts: &[MeasuredStart],
        base: &DMatrix<f64>,
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let starts = StartNoise::all(layout, plain, working, groups, starts, base, context)?;
        let mut working_groups = groups.to_vec();
        let (whole_base, mut residuals) =
            with_starts(base, &working.residuals, &mut working_groups, &starts, context)?;
        residuals.iter_mut().zip(&working.corrections).for_each(|(r, factor)| *r *= factor.sqrt());
        let priors = layout.n_measurements()..working.residuals.len();
        let mut moments = Moments::new(&working_groups, &whole_base, &residuals, priors.clone(), context)?;
        let is_rounded = |k: &usize| {
            let output = &layout.outputs[*k];
            is_rounding(output, &plain[output.range.clone()])
        };
        let is_rounding: Vec<bool> = groups.iter().map(|g| g.outputs.iter().all(is_rounded)).collect();
        if !is_rounding.iter().all(|is| *is) {
            // An output may be exact while others are not. A variance below the variance of rounding would be
            // smaller than the rounding errors of the derivatives.
            let least = |k: &usize| {
                let output = &layout.outputs[*k];
                working.roots[output.range.start].powi(2) * square_of_rounding(output)
            };
            for (g, group) in groups.iter().enumerate() {
                moments.raise_squares(g, group.outputs.iter().map(least).sum());
            }
        }
        let model = |transforms: Vec<f64>| -> Result<NoiseModel, CalibrationError> {
            let found = moments.variances(transforms, context)?;
            let uncertainty = moments.uncertainty(&found, context)?;
            NoiseModel::new(found, uncertainty, (groups, base, &starts), context)
        };
        let independent = model(vec![0.0; groups.len()])?;
        let mut transforms = vec![0.0; groups.len()];
        if moments.degrees_of_freedom > 0.0 && base.ncols() > 0 {
            for (g, group) in working_groups.iter().enumerate() {
                if group.is_known
                    || is_rounding[g]
                    || group.n_rows() <= base.ncols() + 2
                    || group.n_pairs() == 0
                {
                    continue;
                }
                transforms[g] = alone(group, &whole_base, &residuals, context)?.unwrap_or(0.0);
            }
        }
        let is_any = transforms.iter().any(|transform| *transform > 0.0);
        let autocorrelated = is_any.then(|| model(transforms)).transpose()?;
        let is_known = !groups.is_empty() && groups.iter().all(|group| group.is_known);
        let degrees_of_freedom = if is_known { f64::INFINITY } else { moments.degrees_of_freedom };
        let priors = base.rows_range(priors);
        let of_priors = priors.tr_mul(&priors);
        let mut variances = working.corrections.clone();
        for (group, variance) in groups.iter().zip(&independent.variances) {
            let ranges = group.outputs.iter().map(|k| layout.outputs[*k].range.clone());
            ranges.for_each(|range| variances[range].fill(*variance));
        }
        Ok(Self { variances, degrees_of_freedom, independent, autocorrelated, of_priors, starts })
    }

    /// Returns the changes of the working residuals by one standard deviation of each measured initial state.
    pub(crate) fn changes_by_starts(&self) -> Vec<DVector<f64>> {
        let of = |start: &StartNoise| &start.change * self.independent.variances[start.group].sqrt();
        self.starts.iter().map(of).collect()
    }
}

impl NoiseModel {
    /// Creates the model with the changes due to the parameters and to measured initial states. The noise of
    /// these states is independent of the noise of the other measurements.
    fn new(
        found: Variances,
        uncertainty: DMatrix<f64>,
        (groups, base, starts): (&[Group], &DMatrix<f64>, &[StartNoise]),
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let mut slopes = found.slopes(groups, base, context)?;
        for start in starts {
            slopes[start.group] += &start.along * start.along.transpose() * found.values[start.group];
        }
        let autocorrelations = found.transforms.iter().map(|z| z.tanh()).collect();
        Ok(Self { variances: found.values, autocorrelations, slopes, uncertainty })
    }
}

impl StartNoise {
    fn all(
        layout: &ResidualLayout,
        plain: &[f64],
        working: &Working,
        groups: &[Group],
        starts: &[MeasuredStart],
        base: &DMatrix<f64>,
        context: &RunContext<'_>,
    ) -> Result<Vec<Self>, CalibrationError> {
        let plain_over_working = working.plain_over_working(layout, plain, groups);
        let of = |start: &MeasuredStart| -> Result<Self, CalibrationError> {
            let group = groups.iter().position(|group| group.outputs.contains(&start.output));
            // The start has the noise of a measurement, whatever the loss does to the residuals.
            let scale = plain_over_working[start.output].sqrt() / start.weight;
            let change = working.weighed(&start.change) * scale;
            let along = along(base, change.as_slice(), context)?;
            Ok(Self { group: group.unwrap_or(0), row: start.row, scale, change, along })
        };
        starts.iter().map(of).collect()
    }
}

/// Returns the base and the residuals of a fit in which measured initial states are also parameters.
/// Measurements of starts that are not compared are added to their groups as rows after all others.
fn with_starts(
    base: &DMatrix<f64>,
    residuals: &[f64],
    groups: &mut [Group],
    starts: &[StartNoise],
    context: &RunContext<'_>,
) -> Result<(DMatrix<f64>, Vec<f64>), CalibrationError> {
    let (mut residuals, m, q) = (residuals.to_vec(), base.nrows(), base.ncols());
    if starts.is_empty() {
        return Ok((base.clone(), residuals));
    }
    for start in starts.iter().filter(|start| start.row.is_none()) {
        groups[start.group].series.push(residuals.len()..residuals.len() + 1);
        residuals.push(0.0);
    }
    let mut columns = base.clone().resize(residuals.len(), q + starts.len(), 0.0);
    let mut behind = m..;
    for (s, start) in starts.iter().enumerate() {
        let mut column = columns.column_mut(q + s);
        column.rows_mut(0, m).copy_from(&start.change);
        column[start.row.or_else(|| behind.next()).unwrap_or(m)] = -1.0;
        column.normalize_mut();
    }
    left_by(&columns, &residuals, context)
}

/// Returns the autocorrelation of a group alone, from its residuals without the changes due to the
/// parameters; see [`Moments::autocorrelation`].
fn alone(
    group: &Group,
    base: &DMatrix<f64>,
    residuals: &[f64],
    context: &RunContext<'_>,
) -> Result<Option<f64>, CalibrationError> {
    let rows: Vec<usize> = group.series.iter().cloned().flatten().collect();
    let of_rows: Vec<f64> = rows.iter().map(|row| residuals[*row]).collect();
    let (base, residuals) = left_by(&base.select_rows(&rows), &of_rows, context)?;
    let mut end = 0;
    let series = group.series.iter().map(|range| {
        end += range.len();
        end - range.len()..end
    });
    let groups = [Group { series: series.collect(), ..Group::default() }];
    Moments::new(&groups, &base, &residuals, 0..0, context)?.autocorrelation(context)
}

/// Returns an orthonormal base of columns of about unit length, and the residuals minus their projection onto
/// it.
fn left_by(
    columns: &DMatrix<f64>,
    residuals: &[f64],
    context: &RunContext<'_>,
) -> Result<(DMatrix<f64>, Vec<f64>), CalibrationError> {
    let base = match thin_svd(columns, context)? {
        None => DMatrix::zeros(columns.nrows(), 0),
        Some(ThinSvd { u, values, .. }) => {
            let kept: Vec<usize> = (0..values.len()).filter(|k| values[*k] > ROUNDING).collect();
            u.select_columns(&kept)
        }
    };
    let left = DVector::from_column_slice(residuals) - &base * along(&base, residuals, context)?;
    Ok((base, left.as_slice().to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uncertainty::covariance::joint::JointMatrices;
    use crate::uncertainty::covariance::matrix::Factors;
    use crate::uncertainty::differences::Differences;
    use crate::uncertainty::robust::normal_numbers;

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
                starts_simulation: false,
                is_noise_known: false,
                is_log: false,
            });
        }
        layout
    }

    /// Returns the noise of residuals by this estimator, and the factors of the columns of a Jacobian.
    fn found(
        layout: &ResidualLayout,
        residuals: &[f64],
        jacobian: &DMatrix<f64>,
        estimator: Estimator,
        starts: &[MeasuredStart],
    ) -> (Noise, Factors) {
        let (context, criterion) = (RunContext::new(), Criterion::default());
        let groups = groups(layout, residuals, estimator, criterion, false);
        let working = Working::new(criterion, layout, residuals, &groups, jacobian.ncols());
        let n = jacobian.ncols();
        let factors = match n {
            0 => Factors {
                inverse: DMatrix::zeros(0, 0),
                base: DMatrix::zeros(jacobian.nrows(), 0),
                is_undetermined: Vec::new(),
            },
            _ => Factors::new(&Differences::of(jacobian.clone(), DMatrix::identity(n, n), 1e-12), &context)
                .unwrap(),
        };
        let noise = Noise::estimate(layout, residuals, &working, &groups, starts, &factors.base, &context);
        (noise.unwrap(), factors)
    }

    /// Returns the residuals of a fit of these columns to the errors.
    fn left(errors: &[f64], jacobian: &DMatrix<f64>) -> Vec<f64> {
        let base = jacobian.clone().qr().q();
        let errors = DVector::from_column_slice(errors);
        (&errors - &base * base.tr_mul(&errors)).as_slice().to_vec()
    }

    fn line(n: usize) -> DMatrix<f64> {
        DMatrix::from_fn(n, 2, |i, k| if k == 0 { 1.0 } else { i as f64 })
    }

    fn autoregressive(rho: f64, n: usize, state: &mut u64) -> Vec<f64> {
        let mut last = normal_numbers(1, state)[0];
        let next = |e: f64| {
            last = rho * last + (1.0 - rho * rho).sqrt() * e;
            last
        };
        normal_numbers(n, state).into_iter().map(next).collect()
    }

    #[test]
    fn variances_of_groups_are_unbiased() {
        // By symmetry, the values are the squares of the entries of M = I - X (X'X)^-1 X' in the blocks (0, 0),
        // (0, 1) and (1, 1):
        // [[3, -4, -1, 2], [-4, 7, -2, -1], [-1, -2, 7, -4], [2, -1, -4, 3]] / 10.
        let residuals = [0.1, -0.2, 0.3, -0.1];
        let (pooled, _) = found(&layout(&[("y", 4)]), &residuals, &line(4), Estimator::Pooled, &[]);
        assert!(
            (pooled.variances[0] - 0.075).abs() < 1e-15 && (pooled.degrees_of_freedom - 2.0).abs() < 1e-12
        );
        let two = layout(&[("y", 2), ("z", 2)]);
        let (two, _) = found(&two, &residuals, &line(4), Estimator::Sandwich, &[]);
        let (within, between) = (0.9, 0.1);
        let solved = |a: f64, b: f64| (within * a - between * b) / (within * within - between * between);
        let (first, second) = (solved(0.05, 0.1), solved(0.1, 0.05));
        for (got, expected) in two.variances.iter().zip([first, first, second, second]) {
            assert!((got - expected).abs() < 1e-14, "{:?}", two.variances);
        }
    }

    #[test]
    fn recordings_share_a_variance_when_weights_are_equal() {
        let residuals = [0.1, -0.1, 0.2, -0.2, 3.0, -3.0];
        let mut layout = layout(&[("y", 2), ("y", 2), ("y", 2)]);
        layout.outputs[2].weights = vec![10.0; 2].into();
        let none = DMatrix::zeros(6, 0);
        let variances =
            |layout: &ResidualLayout| found(layout, &residuals, &none, Estimator::Sandwich, &[]).0.variances;
        for (got, expected) in variances(&layout).iter().zip([0.025, 0.025, 0.025, 0.025, 9.0, 9.0]) {
            assert!((got - expected).abs() < 1e-14);
        }
        // One exact output among others has the variance of rounding errors.
        layout.outputs[2].measured = vec![1e14; 2].into();
        let exact = variances(&layout);
        assert!((exact[0] - 0.025).abs() < 1e-14 && (exact[4] / 1e10 - 1.0).abs() < 1e-12, "{exact:?}");
        // If all residuals are rounding, there is one variance.
        layout.outputs.iter_mut().for_each(|output| output.measured = vec![1e14; 2].into());
        let pooled = variances(&layout);
        assert!(pooled.iter().all(|variance| (variance - 18.1 / 6.0).abs() < 1e-14), "{pooled:?}");
    }

    #[test]
    fn rows_of_weight_zero_have_no_noise() {
        let mut layout = layout(&[("y", 6)]);
        layout.outputs[0].weights = vec![1.0, 1.0, 0.0, 0.0, 1.0, 1.0].into();
        let residuals = [0.1, -0.2, 0.0, 0.0, 0.3, -0.1];
        let (noise, _) = found(&layout, &residuals, &DMatrix::zeros(6, 0), Estimator::Sandwich, &[]);
        assert!(noise.degrees_of_freedom == 4.0 && (noise.variances[0] - 0.15 / 4.0).abs() < 1e-15);
        let of = groups(&layout, &residuals, Estimator::Sandwich, Criterion::default(), false);
        assert_eq!(of[0].series, [0..2, 4..6]);
    }

    #[test]
    fn degrees_of_freedom_follow_the_group_of_the_variance() {
        // The parameters are the means of two outputs of 3 and 50 rows.
        let jacobian = DMatrix::from_fn(53, 2, |i, k| f64::from(u8::from((i < 3) == (k == 0))));
        let mut state = 5;
        let residuals = left(&normal_numbers(53, &mut state), &jacobian);
        let two = layout(&[("y", 3), ("z", 50)]);
        let (noise, factors) = found(&two, &residuals, &jacobian, Estimator::Sandwich, &[]);
        let joint = JointMatrices::new(&factors, &noise, &noise.independent);
        assert!((joint.degrees_of_freedom(0) - 2.0).abs() < 1e-9);
        assert!((joint.degrees_of_freedom(1) - 49.0).abs() < 1e-9);
        // One mean of both has the degrees of freedom of Welch and Satterthwaite.
        let both = DMatrix::from_element(53, 1, 1.0);
        let residuals = left(&normal_numbers(53, &mut state), &both);
        let (noise, factors) = found(&two, &residuals, &both, Estimator::Pooled, &[]);
        let joint = JointMatrices::new(&factors, &noise, &noise.independent);
        assert!((joint.degrees_of_freedom(0) - 52.0).abs() < 1e-9);
    }

    #[test]
    fn prior_removes_only_the_measured_part_of_a_degree_of_freedom() {
        // A constant, measured ten times, with a prior: H = 1 / (10 + 1 / sd^2) over the rows.
        for sd in [1e-4, 0.3, 1e4_f64] {
            let of_prior = 1.0 / sd;
            let jacobian = DMatrix::from_fn(11, 1, |i, _| if i < 10 { 1.0 } else { of_prior });
            let mut state = 7;
            let residuals = left(&normal_numbers(11, &mut state), &jacobian);
            let (noise, factors) =
                found(&layout(&[("y", 10)]), &residuals, &jacobian, Estimator::Sandwich, &[]);
            let expected = 10.0 - 10.0 / (10.0 + of_prior * of_prior);
            assert!((noise.degrees_of_freedom - expected).abs() < 2e-6, "{sd}: {}", noise.degrees_of_freedom);
            let joint = JointMatrices::new(&factors, &noise, &noise.independent);
            let (degrees, variance) = (joint.degrees_of_freedom(0), noise.variances[0]);
            let of_both = (10.0 * variance + of_prior.powi(2)) / (10.0 + of_prior.powi(2)).powi(2);
            assert!((joint.covariance[(0, 0)] / of_both - 1.0).abs() < 1e-9);
            // A dominant prior leaves nothing unknown; a vague prior has no effect.
            assert!(if sd < 1.0 { degrees > 20.0 } else { (degrees - 9.0).abs() < 1e-3 }, "{sd}: {degrees}");
        }
    }

    #[test]
    fn distant_prior_causes_no_autocorrelation() {
        // The prior pulls the constant away from the measurements, so that the residuals have one
        // sign.
        let jacobian = DMatrix::from_fn(51, 1, |i, _| if i < 50 { 1.0 } else { 100.0 });
        let mut state = 11;
        let mut errors = normal_numbers(51, &mut state);
        errors[50] = 200.0;
        let residuals = left(&errors, &jacobian);
        let (noise, _) = found(&layout(&[("y", 50)]), &residuals, &jacobian, Estimator::Sandwich, &[]);
        assert!(residuals[..50].iter().sum::<f64>().abs() > 50.0 && noise.autocorrelated.is_none());
    }

    #[test]
    fn noise_estimate_detects_autocorrelation_but_not_chance() {
        let (mut state, line) = (1, line(400));
        let one = |errors: &[f64]| {
            found(&layout(&[("y", 400)]), &left(errors, &line), &line, Estimator::Sandwich, &[])
        };
        for rho in [0.5, 0.9] {
            let (noise, factors) = one(&autoregressive(rho, 400, &mut state));
            let model = noise.autocorrelated.as_ref().unwrap();
            let found = model.autocorrelations[0];
            assert!((found - rho).abs() < 0.08, "{found}");
            // Compare with U'S U of the Toeplitz matrix.
            let variance = model.variances[0];
            let s = DMatrix::from_fn(400, 400, |i, j| variance * found.powi((i as i32 - j as i32).abs()));
            let expected = factors.base.transpose() * s * &factors.base;
            assert!((&model.slopes[0] - &expected).amax() < 1e-9 * expected.amax());
            let joint = JointMatrices::new(&factors, &noise, model);
            assert!((3.0..200.0).contains(&joint.degrees_of_freedom(0)));
        }
        let significant =
            (0..200).filter(|_| one(&normal_numbers(400, &mut state)).0.autocorrelated.is_some()).count();
        assert!(significant <= 12, "{significant} of 200");
    }

    /// Weights of 1 / measured bring noise into the columns of the Jacobian, so that a constant remains in
    /// the residuals.
    #[test]
    fn weights_from_measured_values_cause_no_autocorrelation() {
        let (n, mut state, mut significant) = (30, 3, 0);
        for _ in 0..100 {
            let noise = normal_numbers(n, &mut state);
            let y: Vec<f64> = (0..n).map(|i| (3.0 + 0.1 * i as f64) * (1.0 + 0.02 * noise[i])).collect();
            let jacobian = DMatrix::from_fn(n, 2, |i, k| if k == 0 { 1.0 } else { i as f64 } / y[i]);
            let residuals = left(&vec![-1.0; n], &jacobian);
            let (noise, _) = found(&layout(&[("y", n)]), &residuals, &jacobian, Estimator::Sandwich, &[]);
            significant += usize::from(noise.autocorrelated.is_some());
        }
        assert!(significant <= 8, "{significant} of 100");
    }

    /// The noise is independent but its size varies.
    #[test]
    fn uneven_noise_causes_no_autocorrelation() {
        let (n, mut state, line, mut significant) = (60, 4, line(60), 0);
        for _ in 0..400 {
            let errors = normal_numbers(n, &mut state);
            let loud = errors.iter().enumerate().map(|(i, e)| e * (-0.1 * i as f64).exp());
            let residuals = left(&loud.collect::<Vec<_>>(), &line);
            let (noise, _) = found(&layout(&[("y", n)]), &residuals, &line, Estimator::Sandwich, &[]);
            significant += usize::from(noise.autocorrelated.is_some());
        }
        assert!(significant <= 24, "{significant} of 400");
    }

    /// A line through all rows: the noise of the second output leaves a smooth part in the residuals of the
    /// first.
    #[test]
    fn groups_have_separate_autocorrelations() {
        let (mut state, line) = (2, line(240));
        let two = layout(&[("y", 60), ("y", 60), ("z", 120)]);
        let (sets, mut by_chance, mut means) = (100, 0, [0.0; 3]);
        for _ in 0..sets {
            let lasting = autoregressive(0.8, 120, &mut state).into_iter().map(|e| 5.0 * e);
            let errors: Vec<f64> = normal_numbers(120, &mut state).into_iter().chain(lasting).collect();
            let (noise, _) = found(&two, &left(&errors, &line), &line, Estimator::Sandwich, &[]);
            let model = noise.autocorrelated.unwrap();
            by_chance += usize::from(model.autocorrelations[0] > 0.0);
            let of_set = [model.autocorrelations[1], model.variances[0], model.variances[1]];
            means.iter_mut().zip(of_set).for_each(|(mean, variance)| *mean += variance / f64::from(sets));
        }
        // One in forty is expected, whatever the size of the smooth part.
        assert!(by_chance <= 7, "{by_chance} of {sets}");
        let [rho, first, second] = means;
        assert!((rho - 0.8).abs() < 0.05, "{rho}");
        assert!((first - 1.0).abs() < 0.1 && (second / 25.0 - 1.0).abs() < 0.15, "{first} {second}");
    }

    /// A line from a measured start, `y = start + k t`, with a fitted k.
    #[test]
    fn measured_start_counts_as_noise_not_as_measurement() {
        let n = 4;
        let jacobian = DMatrix::from_fn(n, 1, |i, _| i as f64);
        let mut layout = layout(&[("y", n)]);
        layout.outputs[0].weights = vec![2.0; n].into();
        layout.outputs[0].starts_simulation = true;
        let change = DVector::from_fn(n, |i, _| if i == 0 { 0.0 } else { 2.0 });
        let start = MeasuredStart {
            experiment: 0,
            state: "y".to_owned(),
            output: 0,
            row: Some(0),
            value: 1.0,
            weight: 2.0,
            change,
        };
        let (mut state, mut variances, mut squares) = (9, 0.0, 0.0);
        let sets = 20_000;
        for _ in 0..sets {
            let e = normal_numbers(n, &mut state);
            // The residuals have weight 2, so the noise of the measurements is 1/2.
            let errors: Vec<f64> = (0..n).map(|i| e[0] - e[i]).collect();
            let residuals = left(&errors, &jacobian);
            let (noise, factors) =
                found(&layout, &residuals, &jacobian, Estimator::Sandwich, std::slice::from_ref(&start));
            assert!((noise.degrees_of_freedom - 2.0).abs() < 1e-12);
            variances += noise.variances[0] / f64::from(sets);
            squares += noise.variances[0].powi(2) / f64::from(sets);
            // Closed form: 1 / sum t^2 + (sum t / sum t^2)^2.
            let joint = JointMatrices::new(&factors, &noise, &noise.independent);
            let expected = noise.variances[0] * (1.0 / 14.0 + 36.0 / 196.0);
            assert!((joint.covariance[(0, 0)] / expected - 1.0).abs() < 1e-9);
            // The variance of the start is its own noise; the covariance is its effect on k.
            assert!((joint.covariance[(1, 1)] / (noise.variances[0] / 4.0) - 1.0).abs() < 1e-9);
            assert!((joint.covariance[(0, 1)] / (-noise.variances[0] * 6.0 / 14.0 / 2.0) - 1.0).abs() < 1e-9);
            let degrees = joint.degrees_of_freedom(0);
            assert!((degrees - 2.0).abs() < 1e-9, "{degrees}");
        }
        assert!((variances - 1.0).abs() < 0.05, "{variances}");
        // The degrees of freedom are twice the squared mean divided by the variance.
        let degrees = 2.0 / (squares - variances * variances);
        assert!((degrees - 2.0).abs() < 0.2, "{degrees}");
    }
}
