//! The noise of the residuals: one variance and one autocorrelation for each group of outputs, from the
//! moments of the residuals of a fit, and how well they are known.

use crate::error::CalibrationError;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::covariance::measured_start::MeasuredStart;
use crate::uncertainty::diagnostics::residual_check::{is_rounding, square_of_rounding};
use crate::uncertainty::group::Group;
use crate::uncertainty::p_values::OfIndependent;
use crate::uncertainty::result::Estimator;
use crate::uncertainty::row_blocks::{ThinSvd, along, go_on, inner_products, thin_svd, weighted_products};
use crate::uncertainty::scores::{Criterion, Working};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, Normal};
use std::collections::BTreeMap;
use std::ops::Range;

/// An unbiased variance below this part of the mean square is an accident: the group is too small for a
/// variance of its own.
const LEAST: f64 = 0.05;

/// Standard deviations from which on an autocorrelation is no chance: one in forty independent series has a
/// larger one.
const SIGNIFICANT: f64 = 1.96;

/// Bisections of the transform `artanh rho`, which is below 12 for any series that fits into memory.
const BISECTIONS: usize = 24;

/// Rounds over the groups that are autocorrelated: the variances couple their equations weakly.
const ROUNDS: usize = 3;

/// Step of the derivatives with respect to the transform.
const DIFFERENCE: f64 = 0.05;

/// Degrees of freedom that are so near to a whole number are that number.
const ROUNDING: f64 = 1e-6;

/// A direction of the base that the measurements determine less than this is that of the priors alone.
const OF_PRIORS: f64 = 1e-10;

/// The groups of the outputs: those of a variable of the model, over all of its recordings with the same
/// weight ([`Estimator::Sandwich`]) or with any (the likelihood); one group of all with
/// [`Estimator::Pooled`], and where all residuals are rounding.
pub(crate) fn groups(
    layout: &ResidualLayout,
    residuals: &[f64],
    estimator: Estimator,
    criterion: Criterion,
    starts: &[MeasuredStart],
) -> Vec<Group> {
    let is_all_rounding =
        layout.outputs.iter().all(|output| is_rounding(output, &residuals[output.range.clone()]));
    let mut groups: BTreeMap<(&str, Option<u64>), Group> = BTreeMap::new();
    for (k, output) in layout.outputs.iter().enumerate() {
        let key = match (estimator, criterion) {
            (_, Criterion::Likelihood) => (output.variable.as_str(), None),
            (Estimator::Sandwich, _) if !is_all_rounding => key(output),
            _ => ("", None),
        };
        let group = groups.entry(key).or_default();
        group.outputs.push(k);
        let first = output.range.start;
        let rows: Vec<usize> = output.range.clone().filter(|i| output.weights[i - first] != 0.0).collect();
        let is_start = |i: &usize| starts.iter().any(|start| start.row == Some(*i));
        group.starts.extend(rows.iter().copied().filter(is_start));
        let runs = rows.chunk_by(|a, b| a + 1 == *b);
        group.series.extend(runs.map(|run| run[0]..run[run.len() - 1] + 1));
    }
    groups.into_values().collect()
}

/// Recordings that share a variance: those of a variable with the same constant weight, which states how
/// large the noise is, and those whose samples have weights of their own.
fn key(output: &OutputResiduals) -> (&str, Option<u64>) {
    let first = output.weights.first();
    let constant = first.filter(|first| output.weights.iter().all(|weight| weight == *first));
    (&output.variable, constant.map(|weight| weight.to_bits()))
}

/// The noise of the working residuals: `S = sum_g s_g^2 (R_g + D_g D_g') + S_0`.
///
/// R_g is the correlation of a first-order autoregression over each series of a group. D_g has the changes of
/// all residuals by one standard deviation of the measurements of the group that simulations start from. S_0
/// is the identity for priors, which are residuals in units of their standard deviations.
///
/// For the estimate of the noise a measured initial state is one more parameter, and the row of its
/// measurement a residual like others: S is then diagonal but for the autocorrelation.
pub(crate) struct Noise {
    /// Variance of each residual if they are independent.
    pub(crate) variances: Vec<f64>,
    /// Rows with noise of their own, less the trace of the projection onto the changes by the parameters over
    /// these rows (Hastie and Tibshirani, Generalized Additive Models, 1990, section 3.5): a prior takes away
    /// no degree of freedom, and the measurements lose one only for what they determine themselves.
    pub(crate) degrees_of_freedom: f64,
    /// With independent residuals.
    pub(crate) independent: NoiseModel,
    /// With autocorrelated residuals, where any of them are.
    pub(crate) autocorrelated: Option<NoiseModel>,
    /// Probability of autocorrelations as large in independent residuals.
    pub(crate) chance: f64,
    /// U'S_0 U.
    pub(crate) of_priors: DMatrix<f64>,
    /// The noise of measured initial states.
    pub(crate) starts: Vec<StartNoise>,
}

/// The noise of a measured initial state.
pub(crate) struct StartNoise {
    /// Group of its measurement.
    pub(crate) group: usize,
    /// Row of its measurement; `None`: it is not compared.
    row: Option<usize>,
    /// Standard deviation of the state over that of a working residual of the group.
    pub(crate) scale: f64,
    /// Change of the working residuals by that standard deviation of a working residual.
    pub(crate) change: DVector<f64>,
    /// U' times the change.
    pub(crate) along: DVector<f64>,
}

/// Estimates of the variances and autocorrelations. The parameters of the noise are the logarithms of the
/// variances, then `artanh rho` of each group that is autocorrelated.
pub(crate) struct NoiseModel {
    /// Variance of each group.
    pub(crate) variances: Vec<f64>,
    /// Autocorrelation at lag one of each group.
    pub(crate) autocorrelations: Vec<f64>,
    /// `U' dS U` for the derivative of S with respect to each parameter.
    pub(crate) slopes: Vec<DMatrix<f64>>,
    /// Covariance of the parameters.
    pub(crate) uncertainty: DMatrix<f64>,
}

/// Expectations of the sums of squares and of products of neighbours of the residuals of each group, for a
/// group with the variance one.
struct Component {
    /// U'S U.
    inner: DMatrix<f64>,
    squares: Vec<f64>,
    products: Vec<f64>,
}

/// The moments of residuals `r = M e` with `M = I - U U'`.
struct Moments<'a> {
    groups: &'a [Group],
    base: &'a DMatrix<f64>,
    of_priors: DMatrix<f64>,
    residuals: Vec<f64>,
    /// `sum r_i^2` of each group.
    squares: Vec<f64>,
    /// `sum r_i r_(i+1)` of each group.
    products: Vec<f64>,
    /// U'P U and U'A U of each group: with `r'P r` the sum of squares, with `r'A r` that of products.
    grams: Vec<DMatrix<f64>>,
    neighbours: Vec<DMatrix<f64>>,
}

impl NoiseModel {
    /// With the changes by the parameters, and by measured initial states of which the noise is independent
    /// of that of the other measurements.
    fn new(
        transforms: &[f64],
        variances: Vec<f64>,
        uncertainty: DMatrix<f64>,
        (groups, base, starts): (&[Group], &DMatrix<f64>, &[StartNoise]),
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let mut slopes = Vec::new();
        for (g, group) in groups.iter().enumerate() {
            let mut inner = inner_of(group, base, transforms[g].tanh(), context)?;
            let own = starts.iter().filter(|start| start.group == g);
            own.for_each(|start| inner += &start.along * start.along.transpose());
            slopes.push(inner * variances[g]);
        }
        for g in (0..groups.len()).filter(|g| transforms[*g] > 0.0) {
            let at =
                |sign: f64| inner_of(&groups[g], base, (transforms[g] + sign * DIFFERENCE).tanh(), context);
            slopes.push((at(1.0)? - at(-1.0)?) * (variances[g] / (2.0 * DIFFERENCE)));
        }
        let autocorrelations = transforms.iter().map(|z| z.tanh()).collect();
        Ok(Self { variances, autocorrelations, slopes, uncertainty })
    }
}

/// `U'R U` of a group, R its correlation.
fn inner_of(
    group: &Group,
    base: &DMatrix<f64>,
    rho: f64,
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    let mut inner = DMatrix::zeros(base.ncols(), base.ncols());
    for range in &group.series {
        let rows = base.rows(range.start, range.len()).into_owned();
        inner += inner_products(rows.as_view(), spread(&rows, rho, context)?.as_view(), context)?;
    }
    Ok(inner)
}

/// Variances that explain the sums of squares.
struct Variances {
    values: Vec<f64>,
    /// True if they are the unbiased ones of each group.
    is_unbiased: bool,
}

impl Noise {
    /// The moments of the residuals of a fit equal their expectations: of `r'B r` this is `tr(B M S M)`
    /// (Searle, Casella and McCulloch, Variance Components, 1992, section 5.2), with B the sum of squares of
    /// a group for its variance and the sum of products of neighbours for its autocorrelation. So an
    /// autocorrelation is that of the residuals, but for the part that the fit has taken from it. Unlike the
    /// restricted likelihood this does not suppose that the columns of the Jacobian are free of noise, which
    /// they are not where weights are computed from measurements.
    ///
    /// A group has an autocorrelation where its sum of products is larger than that of independent residuals
    /// by 1.96 standard deviations: those of residuals of one variance, and those of residuals of any,
    /// `sum r_i^2 r_(i+1)^2` (Lo and MacKinlay, Rev. Financial Studies 1, 1988). At most it is that of noise
    /// that lasts as long as the series, `exp(-1 / n)`: longer noise is an offset. The autocorrelation is
    /// taken from what the measurements alone leave, for a prior that pulls the parameters away leaves a
    /// constant in all residuals.
    ///
    /// The covariance of the estimates is that of quadratic forms of normal errors,
    /// `cov(r'B r, r'C r) = 2 tr(B M S M C M S M)`.
    ///
    /// Where the unbiased equations leave no variance to one of several groups, all have the variance
    /// `r'r / n_g` times N over the degrees of freedom.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`].
    pub(crate) fn estimate(
        layout: &ResidualLayout,
        plain: &[f64],
        working: &Working,
        groups: &[Group],
        starts: &[MeasuredStart],
        base: &DMatrix<f64>,
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let residuals = &working.residuals;
        let is_rounded = |k: &usize| {
            let output = &layout.outputs[*k];
            is_rounding(output, &plain[output.range.clone()])
        };
        let is_rounding: Vec<bool> = groups.iter().map(|g| g.outputs.iter().all(is_rounded)).collect();
        let is_all_rounding = is_rounding.iter().all(|is| *is);
        let correction = |group: &Group| group.rows().next().map_or(1.0, |i| working.corrections[i]);
        let least = |group: &Group| {
            // An exact output beside others: less than rounding would be a variance that rounding of the derivatives outweighs.
            let of = |k: &usize| {
                let output = &layout.outputs[*k];
                let root = working.roots[output.range.start];
                if is_all_rounding { 0.0 } else { root * root * square_of_rounding(output) }
            };
            group.outputs.iter().map(of).sum::<f64>()
        };
        let starts = StartNoise::all(layout, plain, working, groups, starts, base, context)?;
        let n_measurements = layout.n_measurements();
        let whole = Whole::new(base, residuals, groups, &starts, context)?;
        let priors = n_measurements..residuals.len();
        let mut of_fit = Moments::new(&whole.groups, &whole.base, whole.residuals, priors.clone(), context)?;
        for (g, group) in groups.iter().enumerate() {
            of_fit.squares[g] = of_fit.squares[g].max(least(group)) * correction(group);
        }
        let degrees_of_freedom = of_fit.degrees_of_freedom();
        let none = vec![0.0; groups.len()];
        let model = |transforms: &[f64]| -> Result<NoiseModel, CalibrationError> {
            let (found, components) = of_fit.estimate(transforms, degrees_of_freedom, context)?;
            let uncertainty =
                of_fit.uncertainty(transforms, &found, &components, degrees_of_freedom, context)?;
            NoiseModel::new(transforms, found.values, uncertainty, (groups, base, &starts), context)
        };
        let independent = model(&none)?;
        let may_last: Vec<bool> = groups
            .iter()
            .zip(&is_rounding)
            .map(|(group, is_rounding)| {
                !is_rounding && group.n_rows() > base.ncols() + 2 && group.n_pairs() > 0
            })
            .collect();
        let (mut autocorrelated, mut chance) = (None, 1.0);
        if degrees_of_freedom > 0.0 && base.ncols() > 0 && may_last.contains(&true) {
            let (transforms, by_chance) = match priors.is_empty() {
                true => of_fit.autocorrelations(&may_last, degrees_of_freedom, context)?,
                false => {
                    let (base, left) =
                        left_by_measurements(&whole.base, &of_fit.residuals, &priors, context)?;
                    let alone = Moments::new(&whole.groups, &base, left, priors.clone(), context)?;
                    alone.autocorrelations(&may_last, alone.degrees_of_freedom(), context)?
                }
            };
            if transforms.iter().any(|z| *z > 0.0) {
                (autocorrelated, chance) = (Some(model(&transforms)?), by_chance);
            }
        }
        let priors = base.rows_range(priors);
        let of_priors = priors.tr_mul(&priors);
        let mut variances = working.corrections.clone();
        for (group, variance) in groups.iter().zip(&independent.variances) {
            let ranges = group.outputs.iter().map(|k| layout.outputs[*k].range.clone());
            ranges.for_each(|range| variances[range].fill(*variance));
        }
        Ok(Self { variances, degrees_of_freedom, independent, autocorrelated, chance, of_priors, starts })
    }

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

    /// Changes of the working residuals by one standard deviation of each measured initial state.
    pub(crate) fn changes_by_starts(&self) -> Vec<DVector<f64>> {
        let of = |start: &StartNoise| &start.change * self.independent.variances[start.group].sqrt();
        self.starts.iter().map(of).collect()
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
            // The start has the noise of a measurement, whatever a loss makes of the residuals.
            let scale = plain_over_working[start.output].sqrt() / start.weight;
            let change = working.weighed(&start.change) * scale;
            let along = along(base, change.as_slice(), context)?;
            Ok(Self { group: group.unwrap_or(0), row: start.row, scale, change, along })
        };
        starts.iter().map(of).collect()
    }
}

/// The residuals with the rows of all measured initial states, which are parameters here.
struct Whole {
    groups: Vec<Group>,
    base: DMatrix<f64>,
    residuals: Vec<f64>,
}

impl Whole {
    fn new(
        base: &DMatrix<f64>,
        residuals: &[f64],
        groups: &[Group],
        starts: &[StartNoise],
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let (mut groups, m, q) = (groups.to_vec(), residuals.len(), base.ncols());
        if starts.is_empty() {
            return Ok(Self { groups, base: base.clone(), residuals: residuals.to_vec() });
        }
        // Behind all others: measurements of starts that are not compared.
        let n = starts.iter().filter(|start| start.row.is_none()).count();
        let mut columns = base.clone().resize(m + n, q + starts.len(), 0.0);
        let mut next = m;
        for (s, start) in starts.iter().enumerate() {
            columns.view_mut((0, q + s), (m, 1)).copy_from(&start.change);
            let row = start.row.unwrap_or(next);
            if start.row.is_none() {
                groups[start.group].series.push(next..next + 1);
                next += 1;
            }
            columns[(row, q + s)] = -1.0;
        }
        let mut left = DVector::from_column_slice(residuals).resize_vertically(m + n, 0.0);
        let base = match thin_svd(&columns, context)? {
            None => DMatrix::zeros(m + n, 0),
            Some(ThinSvd { u, values, .. }) => {
                let least = f64::EPSILON * (m + n) as f64 * values.iter().copied().fold(0.0, f64::max);
                let kept: Vec<usize> = (0..values.len()).filter(|k| values[*k] > least).collect();
                u.select_columns(&kept)
            }
        };
        let along = along(&base, left.as_slice(), context)?;
        left -= &base * along;
        Ok(Self { groups, base, residuals: left.as_slice().to_vec() })
    }
}

/// An orthonormal base of the changes that the parameters make of the measurements alone, and what these
/// leave without the priors; the rows of the priors are zero.
fn left_by_measurements(
    base: &DMatrix<f64>,
    residuals: &[f64],
    priors: &Range<usize>,
    context: &RunContext<'_>,
) -> Result<(DMatrix<f64>, Vec<f64>), CalibrationError> {
    let mut left = DVector::from_column_slice(residuals);
    left.rows_range_mut(priors.clone()).fill(0.0);
    let mut measured = base.clone();
    measured.rows_range_mut(priors.clone()).fill(0.0);
    let Some(ThinSvd { u, values, .. }) = thin_svd(&measured, context)? else {
        return Ok((DMatrix::zeros(residuals.len(), 0), left.as_slice().to_vec()));
    };
    let kept: Vec<usize> = (0..values.len()).filter(|k| values[*k] > OF_PRIORS).collect();
    let own = u.select_columns(&kept);
    let along = along(&own, left.as_slice(), context)?;
    left -= &own * along;
    Ok((own, left.as_slice().to_vec()))
}

impl<'a> Moments<'a> {
    fn new(
        groups: &'a [Group],
        base: &'a DMatrix<f64>,
        residuals: Vec<f64>,
        priors: Range<usize>,
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let q = base.ncols();
        let priors = base.rows_range(priors);
        let of_priors = priors.tr_mul(&priors);
        let (mut grams, mut neighbours) = (Vec::new(), Vec::new());
        for group in groups {
            let (mut gram, mut pairs) = (DMatrix::zeros(q, q), DMatrix::zeros(q, q));
            for range in &group.series {
                let rows = |from: usize, len: usize| base.rows(range.start + from, len);
                gram +=
                    inner_products(rows(0, range.len()).as_view(), rows(0, range.len()).as_view(), context)?;
                let n = range.len() - 1;
                let pair = inner_products(rows(0, n).as_view(), rows(1, n).as_view(), context)?;
                pairs += (&pair + pair.transpose()) * 0.5;
            }
            grams.push(gram);
            neighbours.push(pairs);
        }
        let of_pairs = |range: &Range<usize>| {
            residuals[range.clone()].windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>()
        };
        let of_rows = |range: &Range<usize>| residuals[range.clone()].iter().map(|r| r * r).sum::<f64>();
        let squares = groups.iter().map(|group| group.series.iter().map(of_rows).sum()).collect();
        let products = groups.iter().map(|group| group.series.iter().map(of_pairs).sum()).collect();
        Ok(Self { squares, products, groups, base, of_priors, residuals, grams, neighbours })
    }

    fn n_rows(&self) -> usize {
        self.groups.iter().map(Group::n_rows).sum()
    }

    fn degrees_of_freedom(&self) -> f64 {
        let degrees = self.n_rows() as f64 - self.grams.iter().map(DMatrix::trace).sum::<f64>();
        let whole = degrees.round();
        if (degrees - whole).abs() < ROUNDING { whole } else { degrees }
    }

    /// The expectations for the variance one of a group, with this autocorrelation.
    fn component(&self, h: usize, rho: f64, context: &RunContext<'_>) -> Result<Component, CalibrationError> {
        let group = &self.groups[h];
        let (mut inner, mut of_pairs) = (self.grams[h].clone(), self.neighbours[h].trace());
        if rho != 0.0 {
            (inner, of_pairs) = (inner_of(group, self.base, rho, context)?, 0.0);
            for range in &group.series {
                let rows = self.base.rows(range.start, range.len()).into_owned();
                let spread = spread(&rows, rho, context)?;
                of_pairs += pairs(&rows).dot(&spread);
            }
        }
        let of_rows = inner.trace();
        let of = |g: usize, sum: &DMatrix<f64>, own: f64| sum.dot(&inner) + if g == h { own } else { 0.0 };
        let (of_square, of_product) =
            (group.n_rows() as f64 - 2.0 * of_rows, rho * group.n_pairs() as f64 - 2.0 * of_pairs);
        let squares = self.grams.iter().enumerate().map(|(g, gram)| of(g, gram, of_square)).collect();
        let products =
            self.neighbours.iter().enumerate().map(|(g, pairs)| of(g, pairs, of_product)).collect();
        Ok(Component { inner, squares, products })
    }

    fn components(
        &self,
        transforms: &[f64],
        context: &RunContext<'_>,
    ) -> Result<Vec<Component>, CalibrationError> {
        (0..self.groups.len()).map(|g| self.component(g, transforms[g].tanh(), context)).collect()
    }

    fn variances(&self, components: &[Component], degrees_of_freedom: f64) -> Variances {
        let (n, n_rows) = (self.groups.len(), self.n_rows());
        let shares = DMatrix::from_fn(n, n, |g, h| components[h].squares[g]);
        let left = DVector::from_fn(n, |g, _| self.squares[g] - self.grams[g].dot(&self.of_priors));
        let plainly = |g: usize| match self.groups[g].n_rows() {
            0 => 0.0,
            count => self.squares[g] / count as f64 * n_rows as f64 / degrees_of_freedom,
        };
        let found = shares.lu().solve(&left).filter(|found| {
            degrees_of_freedom > 0.0
                && (0..n).all(|g| found[g] > LEAST * plainly(g) || self.squares[g] == 0.0)
        });
        match found {
            Some(found) => {
                Variances { values: found.iter().map(|v| v.max(0.0)).collect(), is_unbiased: true }
            }
            None => Variances { values: (0..n).map(plainly).collect(), is_unbiased: false },
        }
    }

    /// The mean of the sum of products of a group less the sum that was found.
    fn excess(&self, g: usize, components: &[Component], degrees_of_freedom: f64) -> f64 {
        let Variances { values, .. } = self.variances(components, degrees_of_freedom);
        let known = self.neighbours[g].dot(&self.of_priors);
        let expected = values.iter().zip(components).map(|(v, own)| v * own.products[g]).sum::<f64>() + known;
        expected - self.products[g]
    }

    /// Transforms `artanh rho` of the autocorrelations of the groups, zero where there is none, and the
    /// probability of the largest one in independent residuals.
    fn autocorrelations(
        &self,
        may_last: &[bool],
        degrees_of_freedom: f64,
        context: &RunContext<'_>,
    ) -> Result<(Vec<f64>, f64), CalibrationError> {
        let mut transforms = vec![0.0; self.groups.len()];
        let (mut largest, mut lasting) = (0.0_f64, Vec::new());
        let mut open: Vec<usize> = (0..self.groups.len()).filter(|g| may_last[*g]).collect();
        let n_candidates = open.len() as f64;
        // One after the other: noise that lasts in one group leaves some of it in the residuals of others.
        while let Some((deviations, g)) =
            self.most_significant(&transforms, &open, degrees_of_freedom, context)?
        {
            largest = largest.max(deviations);
            open.retain(|other| *other != g);
            lasting.push(g);
            let rounds = if lasting.len() == 1 { 1 } else { ROUNDS };
            for _ in 0..rounds {
                for &g in &lasting {
                    transforms[g] = self.transform(g, &transforms, degrees_of_freedom, context)?;
                }
            }
        }
        Ok((transforms, (Normal::standard().sf(largest) * n_candidates).min(1.0)))
    }

    /// The group of which the sum of products is larger than that of independent residuals by most standard
    /// deviations, if these are significant.
    fn most_significant(
        &self,
        transforms: &[f64],
        open: &[usize],
        degrees_of_freedom: f64,
        context: &RunContext<'_>,
    ) -> Result<Option<(f64, usize)>, CalibrationError> {
        let n = self.groups.len();
        let (found, components) = self.estimate(transforms, degrees_of_freedom, context)?;
        let rhos: Vec<f64> = transforms.iter().map(|z| z.tanh()).collect();
        let of_equal = self.covariance_of_moments(&found.values, &rhos, open, &components, context)?;
        let deviations = open.iter().enumerate().map(|(k, &g)| {
            let of_pairs = |range: &Range<usize>| {
                self.residuals[range.clone()].windows(2).map(|pair| (pair[0] * pair[1]).powi(2)).sum::<f64>()
            };
            let of_any = self.groups[g].series.iter().map(of_pairs).sum::<f64>();
            let part = components[g].products[g] / components[g].squares[g];
            let of_equal =
                of_equal[(n + k, n + k)] - 2.0 * part * of_equal[(g, n + k)] + part * part * of_equal[(g, g)];
            let deviation = of_any.max(of_equal).sqrt();
            (-self.excess(g, &components, degrees_of_freedom) / deviation, g)
        });
        Ok(deviations.filter(|(own, _)| *own > SIGNIFICANT).max_by(|a, b| a.0.total_cmp(&b.0)))
    }

    /// The transform of the autocorrelation of a group, beside those of the others.
    fn transform(
        &self,
        g: usize,
        transforms: &[f64],
        degrees_of_freedom: f64,
        context: &RunContext<'_>,
    ) -> Result<f64, CalibrationError> {
        let most = (-1.0 / self.groups[g].longest() as f64).exp().atanh();
        let mut components = self.components(transforms, context)?;
        let (mut low, mut high) = (0.0, most);
        components[g] = self.component(g, most.tanh(), context)?;
        if self.excess(g, &components, degrees_of_freedom) > 0.0 {
            for _ in 0..BISECTIONS {
                go_on(context)?;
                let middle = 0.5 * (low + high);
                components[g] = self.component(g, middle.tanh(), context)?;
                let is_above = self.excess(g, &components, degrees_of_freedom) > 0.0;
                if is_above { high = middle } else { low = middle }
            }
        }
        Ok(high)
    }

    /// The variances with these transforms of the autocorrelations, and what they were found with.
    fn estimate(
        &self,
        transforms: &[f64],
        degrees_of_freedom: f64,
        context: &RunContext<'_>,
    ) -> Result<(Variances, Vec<Component>), CalibrationError> {
        let components = self.components(transforms, context)?;
        Ok((self.variances(&components, degrees_of_freedom), components))
    }

    /// Covariance of the logarithms of the variances, then of the transforms that are not zero.
    fn uncertainty(
        &self,
        transforms: &[f64],
        found: &Variances,
        components: &[Component],
        degrees_of_freedom: f64,
        context: &RunContext<'_>,
    ) -> Result<DMatrix<f64>, CalibrationError> {
        let n = self.groups.len();
        let lasting: Vec<usize> = (0..n).filter(|g| transforms[*g] > 0.0).collect();
        // Derivatives of the mean moments: sums of squares of all groups, then products of those that last.
        let moments = |component: &Component| -> DVector<f64> {
            let products = lasting.iter().map(|g| component.products[*g]);
            DVector::from_iterator(n + lasting.len(), component.squares.iter().copied().chain(products))
        };
        let scaled = components.iter().zip(&found.values);
        let mut columns: Vec<DVector<f64>> = scaled.map(|(own, variance)| moments(own) * *variance).collect();
        for &g in &lasting {
            let at = |sign: f64| self.component(g, (transforms[g] + sign * DIFFERENCE).tanh(), context);
            let by = found.values[g] / (2.0 * DIFFERENCE);
            columns.push((moments(&at(1.0)?) - moments(&at(-1.0)?)) * by);
        }
        let rhos: Vec<f64> = transforms.iter().map(|z| z.tanh()).collect();
        let of_moments = self.covariance_of_moments(&found.values, &rhos, &lasting, components, context)?;
        let exact = || {
            let inverse = DMatrix::from_columns(&columns).try_inverse()?;
            let found = &inverse * of_moments * inverse.transpose();
            found.iter().all(|value| value.is_finite()).then_some(found)
        };
        let n_rows = self.n_rows() as f64;
        Ok(match exact() {
            Some(exact) if found.is_unbiased => exact,
            _ => DMatrix::from_diagonal(&DVector::from_fn(columns.len(), |a, _| match self.groups.get(a) {
                Some(group) => 2.0 * n_rows / (group.n_rows() as f64 * degrees_of_freedom),
                None => 0.0,
            })),
        })
    }

    /// Covariance of the sums of squares, then of the sums of products of those that last: with
    /// `M S M = S - U F' - F U'` and `F = S U - U U'S U / 2`.
    fn covariance_of_moments(
        &self,
        variances: &[f64],
        rhos: &[f64],
        lasting: &[usize],
        components: &[Component],
        context: &RunContext<'_>,
    ) -> Result<DMatrix<f64>, CalibrationError> {
        let (q, n) = (self.base.ncols(), self.groups.len());
        let parts = components.iter().zip(variances);
        let inner = parts.fold(self.of_priors.clone(), |sum, (own, variance)| sum + &own.inner * *variance);
        let mut small = DMatrix::zeros(2 * q, 2 * q);
        for a in 0..q {
            (small[(a, q + a)], small[(q + a, a)]) = (-1.0, -1.0);
        }
        let n_all = n + lasting.len();
        let (mut own, mut crossed) = (DMatrix::<f64>::zeros(n_all, n_all), Vec::new());
        let mut of_products = Vec::new();
        for (g, group) in self.groups.iter().enumerate() {
            let pair = lasting.iter().position(|l| *l == g).map(|k| n + k);
            let zero = || DMatrix::zeros(2 * q, 2 * q);
            let (mut of_squares, mut of_pairs) = (zero(), zero());
            let variance = variances[g];
            for range in &group.series {
                let rows = self.base.rows(range.start, range.len()).into_owned();
                let along = spread(&rows, rhos[g], context)? * variance - &rows * &inner * 0.5;
                let mut all = rows.resize_horizontally(2 * q, 0.0);
                all.columns_mut(q, q).copy_from(&along);
                let moved = spread(&all, rhos[g], context)? * variance;
                of_squares += inner_products(all.as_view(), all.as_view(), context)?;
                let both = inner_products(all.as_view(), moved.as_view(), context)?;
                let traces = Traces::of(range.len(), rhos[g]);
                own[(g, g)] += variance * variance * traces.squares + 2.0 * small.dot(&both);
                let Some(pair) = pair else { continue };
                let neighbours = pairs(&all);
                of_pairs += inner_products(all.as_view(), neighbours.as_view(), context)?;
                let mixed = inner_products(neighbours.as_view(), moved.as_view(), context)?;
                let moved = spread(&neighbours, rhos[g], context)? * variance;
                let both = inner_products(neighbours.as_view(), moved.as_view(), context)?;
                let mixed = variance * variance * traces.mixed + 2.0 * small.dot(&mixed);
                own[(g, pair)] += mixed;
                own[(pair, g)] += mixed;
                own[(pair, pair)] += variance * variance * traces.products + 2.0 * small.dot(&both);
            }
            crossed.push(&small * of_squares);
            if pair.is_some() {
                of_products.push(&small * of_pairs);
            }
        }
        crossed.append(&mut of_products);
        let of = |a: usize, b: usize| 2.0 * (own[(a, b)] + crossed[a].dot(&crossed[b].transpose()));
        Ok(DMatrix::from_fn(n_all, n_all, of))
    }
}

/// Traces of the products of the correlation R of a first-order autoregression of n rows with itself and with
/// A, of which `r'A r` is the sum of products of neighbours.
struct Traces {
    /// `tr(R R)`.
    squares: f64,
    /// `tr(A R R)`.
    mixed: f64,
    /// `tr(A R A R)`.
    products: f64,
}

impl Traces {
    fn of(n: usize, rho: f64) -> Self {
        let mut own = Self { squares: n as f64, mixed: 0.0, products: 0.0 };
        if n > 1 {
            own.products = 0.5 * (n - 1) as f64 * (1.0 + rho * rho);
        }
        let mut power = 1.0;
        for lag in 1..n {
            own.mixed += 2.0 * rho * (n - lag) as f64 * power;
            power *= rho * rho;
            own.squares += 2.0 * (n - lag) as f64 * power;
            own.products += 2.0 * (n - 1 - lag) as f64 * power;
            if power < f64::EPSILON {
                break;
            }
        }
        own
    }
}

/// The mean of both neighbours of each row, with zeros beyond the ends.
fn pairs(rows: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, mut means) = (rows.nrows(), DMatrix::zeros(rows.nrows(), rows.ncols()));
    for (values, mut means) in rows.column_iter().zip(means.column_iter_mut()) {
        for i in 1..n {
            means[i] += 0.5 * values[i - 1];
            means[i - 1] += 0.5 * values[i];
        }
    }
    means
}

/// The rows times the correlation of a first-order autoregression.
fn spread(rows: &DMatrix<f64>, rho: f64, context: &RunContext<'_>) -> Result<DMatrix<f64>, CalibrationError> {
    let mut sums = rows.clone();
    if rho == 0.0 {
        return Ok(sums);
    }
    let n = rows.nrows();
    for (values, mut sums) in rows.column_iter().zip(sums.column_iter_mut()) {
        go_on(context)?;
        let mut add = |order: &mut dyn Iterator<Item = usize>| {
            let mut before = 0.0;
            for i in order {
                sums[i] += rho * before;
                before = values[i] + rho * before;
            }
        };
        add(&mut (0..n));
        add(&mut (0..n).rev());
    }
    Ok(sums)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uncertainty::covariance::joint::JointMatrices;
    use crate::uncertainty::covariance::matrix::Factors;
    use crate::uncertainty::differences::Differences;
    use crate::uncertainty::p_values::normal_numbers;

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

    /// The noise of residuals by this estimator, and the factors of the columns of a Jacobian.
    fn found(
        layout: &ResidualLayout,
        residuals: &[f64],
        jacobian: &DMatrix<f64>,
        estimator: Estimator,
        starts: &[MeasuredStart],
    ) -> (Noise, Factors) {
        let (context, criterion) = (RunContext::new(), Criterion::default());
        let groups = groups(layout, residuals, estimator, criterion, starts);
        let working = Working::new(criterion, residuals, &groups, jacobian.ncols());
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

    /// What a fit of these columns leaves of errors.
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
        // The squares of the entries of M = I - X (X'X)^-1 X' in the blocks (0, 0), (0, 1) and (1, 1), by symmetry: those of
        // [[3, -4, -1, 2], [-4, 7, -2, -1], [-1, -2, 7, -4], [2, -1, -4, 3]] / 10.
        let residuals = [0.1, -0.2, 0.3, -0.1];
        let (pooled, _) = found(&layout(&[("y", 4)]), &residuals, &line(4), Estimator::Pooled, &[]);
        assert!(
            (pooled.variances[0] - 0.075).abs() < 1e-15 && (pooled.degrees_of_freedom - 2.0).abs() < 1e-12
        );
        let two = layout(&[("y", 2), ("z", 2)]);
        let (two, _) = found(&two, &residuals, &line(4), Estimator::Sandwich, &[]);
        let (own, other) = (0.9, 0.1);
        let solved = |a: f64, b: f64| (own * a - other * b) / (own * own - other * other);
        let (first, second) = (solved(0.05, 0.1), solved(0.1, 0.05));
        for (got, expected) in two.variances.iter().zip([first, first, second, second]) {
            assert!((got - expected).abs() < 1e-14, "{:?}", two.variances);
        }
    }

    #[test]
    fn recordings_share_a_variance_where_their_weights_are_equal() {
        let residuals = [0.1, -0.1, 0.2, -0.2, 3.0, -3.0];
        let mut layout = layout(&[("y", 2), ("y", 2), ("y", 2)]);
        layout.outputs[2].weights = vec![10.0; 2].into();
        let none = DMatrix::zeros(6, 0);
        let variances =
            |layout: &ResidualLayout| found(layout, &residuals, &none, Estimator::Sandwich, &[]).0.variances;
        for (got, expected) in variances(&layout).iter().zip([0.025, 0.025, 0.025, 0.025, 9.0, 9.0]) {
            assert!((got - expected).abs() < 1e-14);
        }
        // One exact output beside others has that of rounding.
        layout.outputs[2].measured = vec![1e14; 2].into();
        let exact = variances(&layout);
        assert!((exact[0] - 0.025).abs() < 1e-14 && (exact[4] / 1e10 - 1.0).abs() < 1e-12, "{exact:?}");
        // Rounding has no variances of its own.
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
        let of = groups(&layout, &residuals, Estimator::Sandwich, Criterion::default(), &[]);
        assert_eq!(of[0].series, [0..2, 4..6]);
    }

    #[test]
    fn degrees_of_freedom_are_those_of_the_group_that_a_variance_is_of() {
        // The means of two outputs of 3 and 50 rows.
        let jacobian = DMatrix::from_fn(53, 2, |i, k| f64::from(u8::from((i < 3) == (k == 0))));
        let mut state = 5;
        let residuals = left(&normal_numbers(53, &mut state), &jacobian);
        let two = layout(&[("y", 3), ("z", 50)]);
        let (noise, factors) = found(&two, &residuals, &jacobian, Estimator::Sandwich, &[]);
        let joint = JointMatrices::new(&factors, &noise, &noise.independent);
        assert!((joint.degrees_of_freedom(0) - 2.0).abs() < 1e-9);
        assert!((joint.degrees_of_freedom(1) - 49.0).abs() < 1e-9);
        // A mean of both: the degrees of freedom of Welch and Satterthwaite.
        let both = DMatrix::from_element(53, 1, 1.0);
        let residuals = left(&normal_numbers(53, &mut state), &both);
        let (noise, factors) = found(&two, &residuals, &both, Estimator::Pooled, &[]);
        let joint = JointMatrices::new(&factors, &noise, &noise.independent);
        assert!((joint.degrees_of_freedom(0) - 52.0).abs() < 1e-9);
    }

    #[test]
    fn a_prior_takes_away_the_part_of_a_degree_of_freedom_that_the_measurements_determine() {
        // A constant, measured ten times, with a prior: H = 1 / (10 + 1 / sd^2) over the rows.
        for sd in [1e-4, 0.3, 1e4_f64] {
            let of_prior = 1.0 / sd;
            let jacobian = DMatrix::from_fn(11, 1, |i, _| if i < 10 { 1.0 } else { of_prior });
            let mut state = 7;
            let residuals = left(&normal_numbers(11, &mut state), &jacobian);
            let (noise, factors) =
                found(&layout(&[("y", 10)]), &residuals, &jacobian, Estimator::Sandwich, &[]);
            let expected = 10.0 - 10.0 / (10.0 + of_prior * of_prior);
            assert!(
                (noise.degrees_of_freedom - expected).abs() < 2.0 * ROUNDING,
                "{sd}: {}",
                noise.degrees_of_freedom
            );
            let joint = JointMatrices::new(&factors, &noise, &noise.independent);
            let (degrees, variance) = (joint.degrees_of_freedom(0), noise.variances[0]);
            let of_both = (10.0 * variance + of_prior.powi(2)) / (10.0 + of_prior.powi(2)).powi(2);
            assert!((joint.covariance[(0, 0)] / of_both - 1.0).abs() < 1e-9);
            // A prior that decides leaves nothing unknown, a vague one is none.
            assert!(if sd < 1.0 { degrees > 20.0 } else { (degrees - 9.0).abs() < 1e-3 }, "{sd}: {degrees}");
        }
    }

    #[test]
    fn a_prior_far_off_is_no_autocorrelation() {
        // The prior pulls the constant away from the measurements: residuals of one sign.
        let jacobian = DMatrix::from_fn(51, 1, |i, _| if i < 50 { 1.0 } else { 100.0 });
        let mut state = 11;
        let mut errors = normal_numbers(51, &mut state);
        errors[50] = 200.0;
        let residuals = left(&errors, &jacobian);
        let (noise, _) = found(&layout(&[("y", 50)]), &residuals, &jacobian, Estimator::Sandwich, &[]);
        assert!(residuals[..50].iter().sum::<f64>().abs() > 50.0 && noise.autocorrelated.is_none());
    }

    #[test]
    fn an_autocorrelation_is_found_and_chance_is_none() {
        let (mut state, line) = (1, line(400));
        let one = |errors: &[f64]| {
            found(&layout(&[("y", 400)]), &left(errors, &line), &line, Estimator::Sandwich, &[])
        };
        for rho in [0.5, 0.9] {
            let (noise, factors) = one(&autoregressive(rho, 400, &mut state));
            let model = noise.autocorrelated.as_ref().unwrap();
            let found = model.autocorrelations[0];
            assert!((found - rho).abs() < 0.08, "{found}");
            // U'S U of the Toeplitz matrix.
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

    /// Weights of 1 / measured make columns of the Jacobian of the noise: with them a constant is left.
    #[test]
    fn weights_of_measured_values_are_no_autocorrelation() {
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

    /// Independent noise of unlike size.
    #[test]
    fn loud_rows_are_no_autocorrelation() {
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

    #[test]
    fn groups_have_autocorrelations_of_their_own() {
        let (mut state, line) = (2, line(600));
        let lasting = autoregressive(0.8, 300, &mut state).into_iter().map(|e| 5.0 * e);
        let errors: Vec<f64> = normal_numbers(300, &mut state).into_iter().chain(lasting).collect();
        let two = layout(&[("y", 150), ("y", 150), ("z", 300)]);
        let (noise, _) = found(&two, &left(&errors, &line), &line, Estimator::Sandwich, &[]);
        let model = noise.autocorrelated.unwrap();
        assert!(model.autocorrelations[0] == 0.0 && (model.autocorrelations[1] - 0.8).abs() < 0.08);
        let [first, second] = model.variances[..] else { panic!() };
        assert!((first - 1.0).abs() < 0.25 && (second / 25.0 - 1.0).abs() < 0.5, "{first} {second}");
    }

    /// A line from a measured start: `y = start + k t`, of which k is fitted.
    #[test]
    fn a_measured_start_counts_as_noise_and_not_as_a_measurement() {
        let n = 4;
        let jacobian = DMatrix::from_fn(n, 1, |i, _| i as f64);
        let mut layout = layout(&[("y", n)]);
        layout.outputs[0].weights = vec![2.0; n].into();
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
            // Residuals of weight 2: the noise of the measurements is 1/2.
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
            // Of the start itself: its own noise, and what it makes of k.
            assert!((joint.covariance[(1, 1)] / (noise.variances[0] / 4.0) - 1.0).abs() < 1e-9);
            assert!((joint.covariance[(0, 1)] / (-noise.variances[0] * 6.0 / 14.0 / 2.0) - 1.0).abs() < 1e-9);
            let degrees = joint.degrees_of_freedom(0);
            assert!((degrees - 2.0).abs() < 1e-9, "{degrees}");
        }
        assert!((variances - 1.0).abs() < 0.05, "{variances}");
        // Twice the squared mean over the variance are the degrees of freedom.
        let degrees = 2.0 / (squares - variances * variances);
        assert!((degrees - 2.0).abs() < 0.2, "{degrees}");
    }

    /// The covariance of the moments is that of quadratic forms with whole matrices.
    #[test]
    fn moments_have_the_covariance_of_quadratic_forms() {
        let (n, q, rho) = (9, 2, 0.6_f64);
        let context = RunContext::new();
        let base = DMatrix::from_fn(n + 1, q, |i, k| (i as f64 + 1.0).powi(k as i32)).qr().q();
        let groups = [Group { outputs: vec![0], series: vec![0..3, 4..n], starts: Vec::new() }];
        let moments = Moments::new(&groups, &base, vec![1.0; n + 1], n..n + 1, &context).unwrap();
        let of_priors = moments.of_priors.clone();
        let component = moments.component(0, rho, &context).unwrap();
        let variance = 2.5;
        let found = moments
            .covariance_of_moments(&[variance], &[rho], &[0], std::slice::from_ref(&component), &context)
            .unwrap();
        let is_in = |i: usize, j: usize| groups[0].series.iter().any(|r| r.contains(&i) && r.contains(&j));
        let s = DMatrix::from_fn(n + 1, n + 1, |i, j| match is_in(i, j) {
            true => variance * rho.powi((i as i32 - j as i32).abs()),
            false => f64::from(u8::from(i == n && j == n)),
        });
        let m = DMatrix::identity(n + 1, n + 1) - &base * base.transpose();
        let s = &m * s * &m;
        let p = DMatrix::from_fn(n + 1, n + 1, |i, j| f64::from(u8::from(i == j && is_in(i, j))));
        let a = DMatrix::from_fn(n + 1, n + 1, |i, j| match i.abs_diff(j) == 1 && is_in(i, j) {
            true => 0.5,
            false => 0.0,
        });
        for (i, b) in [&p, &a].into_iter().enumerate() {
            for (j, c) in [&p, &a].into_iter().enumerate() {
                let expected = 2.0 * (b * &s * c * &s).trace();
                assert!((found[(i, j)] - expected).abs() < 1e-9 * expected.abs(), "{found} {expected}");
            }
        }
        let expected = [(&p * &s).trace(), (&a * &s).trace()];
        let known = [moments.grams[0].dot(&of_priors), moments.neighbours[0].dot(&of_priors)];
        let of = [component.squares[0] * variance + known[0], component.products[0] * variance + known[1]];
        assert!(of.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 1e-9), "{of:?}");
    }
}
