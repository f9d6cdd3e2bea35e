//! Moments of the residuals of a fit, their expectations and their covariance.

use crate::error::CalibrationError;
use crate::uncertainty::group::Group;
use crate::uncertainty::row_blocks::{go_on, inner_products};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Part of the mean square below which an unbiased variance is an artefact: the group is too small for a
/// separate variance.
const LEAST: f64 = 0.05;

/// Number of standard deviations above which an autocorrelation is significant. One in forty independent
/// series exceeds it.
const SIGNIFICANT: f64 = 1.96;

/// Number of bisections of the transform `artanh rho`, which is below 12 for any series that fits into
/// memory.
const BISECTIONS: usize = 24;

/// Step of the derivatives with respect to the transform.
const DIFFERENCE: f64 = 0.05;

/// Distance to an integer below which degrees of freedom are rounded to it.
const ROUNDING: f64 = 1e-6;

/// Two moments of the residuals `r = M e` of each group, with `M = I - U U'`: the sum of squares `r'P r`,
/// then the sum of products of neighbours `r'A r`. The covariance of e is `S = sum_g s_g^2 R_g + S_0`, see
/// [`Noise`](super::noise::Noise).
pub(crate) struct Moments<'a> {
    groups: &'a [Group],
    base: &'a DMatrix<f64>,
    /// U'S_0 U.
    of_priors: DMatrix<f64>,
    residuals: &'a [f64],
    /// Observed moments.
    found: Vec<f64>,
    /// U'P U and U'A U of each group.
    grams: Vec<DMatrix<f64>>,
    /// Number of rows minus the trace of the projection over these rows.
    pub(crate) degrees_of_freedom: f64,
}

/// Contribution of a group with variance one to the covariance.
struct Component {
    /// U'R U.
    inner: DMatrix<f64>,
    /// Contribution to the expectation of each moment.
    means: Vec<f64>,
}

/// Variances that explain the sums of squares, given these autocorrelations.
pub(crate) struct Variances {
    /// `artanh rho` of each group.
    pub(crate) transforms: Vec<f64>,
    components: Vec<Component>,
    pub(crate) values: Vec<f64>,
    /// True if the variances are the unbiased estimates of each group.
    is_unbiased: bool,
}

impl<'a> Moments<'a> {
    /// Computes the moments. The errors of the rows `priors` have variance one.
    pub(crate) fn new(
        groups: &'a [Group],
        base: &'a DMatrix<f64>,
        residuals: &'a [f64],
        priors: Range<usize>,
        context: &RunContext<'_>,
    ) -> Result<Self, CalibrationError> {
        let priors = base.rows_range(priors);
        let of_priors = priors.tr_mul(&priors);
        let (mut grams, mut found) = (Vec::new(), Vec::new());
        for group in groups {
            grams.extend(of_base(group, base, 0.0, context)?);
            found.push(group.series.iter().flat_map(|range| &residuals[range.clone()]).map(|r| r * r).sum());
            found.push(neighbours(group, residuals).sum());
        }
        let n_rows: usize = groups.iter().map(Group::n_rows).sum();
        let taken: f64 = grams.iter().step_by(2).map(DMatrix::trace).sum();
        let (degrees, whole) = (n_rows as f64 - taken, (n_rows as f64 - taken).round());
        let degrees_of_freedom = if (degrees - whole).abs() < ROUNDING { whole } else { degrees };
        Ok(Self { groups, base, of_priors, residuals, found, grams, degrees_of_freedom })
    }

    fn n_rows(&self) -> f64 {
        self.groups.iter().map(Group::n_rows).sum::<usize>() as f64
    }

    /// Raises the sum of squares of a group to `least` if it is smaller.
    pub(crate) fn raise_squares(&mut self, g: usize, least: f64) {
        self.found[2 * g] = self.found[2 * g].max(least);
    }

    fn component(
        &self,
        h: usize,
        transform: f64,
        context: &RunContext<'_>,
    ) -> Result<Component, CalibrationError> {
        let (group, rho) = (&self.groups[h], transform.tanh());
        let [inner, products] = of_base(group, self.base, rho, context)?;
        let mut means: Vec<f64> = self.grams.iter().map(|gram| gram.dot(&inner)).collect();
        means[2 * h] += group.n_rows() as f64 - 2.0 * inner.trace();
        means[2 * h + 1] += rho * group.n_pairs() as f64 - 2.0 * products.trace();
        Ok(Component { inner, means })
    }

    /// Returns the variances, given these transforms of the autocorrelations.
    pub(crate) fn variances(
        &self,
        transforms: Vec<f64>,
        context: &RunContext<'_>,
    ) -> Result<Variances, CalibrationError> {
        let of = |(g, z): (usize, &f64)| self.component(g, *z, context);
        let components = transforms.iter().enumerate().map(of).collect::<Result<_, _>>()?;
        let mut variances = Variances { transforms, components, values: Vec::new(), is_unbiased: true };
        self.solve(&mut variances);
        Ok(variances)
    }

    /// Equates the sums of squares to their expectations, with valid variances.
    fn solve(&self, of: &mut Variances) {
        let (n, n_rows) = (self.groups.len(), self.n_rows());
        let is_known = |g: usize| self.groups[g].is_known;
        let shares = DMatrix::from_fn(n, n, |g, h| match is_known(g) {
            true => f64::from(u8::from(g == h)),
            false => of.components[h].means[2 * g],
        });
        let left = DVector::from_fn(n, |g, _| match is_known(g) {
            true => 1.0,
            false => self.found[2 * g] - self.grams[2 * g].dot(&self.of_priors),
        });
        let plainly = |g: usize| match self.groups[g].n_rows() {
            _ if is_known(g) => 1.0,
            0 => 0.0,
            count => self.found[2 * g] / count as f64 * n_rows / self.degrees_of_freedom,
        };
        let is_sound = |(g, value): (usize, &f64)| {
            is_known(g) || *value > LEAST * plainly(g) || self.found[2 * g] == 0.0
        };
        let solved = shares.lu().solve(&left);
        let sound =
            solved.filter(|all| self.degrees_of_freedom > 0.0 && all.iter().enumerate().all(is_sound));
        of.is_unbiased = sound.is_some();
        of.values = match sound {
            Some(found) => found.iter().map(|value| value.max(0.0)).collect(),
            None => (0..n).map(plainly).collect(),
        };
    }

    /// Returns the transform of the autocorrelation of the only group. Returns `None` if its sum of products
    /// is not significantly larger than for independent residuals.
    pub(crate) fn autocorrelation(&self, context: &RunContext<'_>) -> Result<Option<f64>, CalibrationError> {
        let excess = |of: &Variances| self.found[1] - of.values[0] * of.components[0].means[1];
        let independent = self.variances(vec![0.0], context)?;
        let covariance = self.covariance(&independent, context)?;
        // The mean of the products follows from the observed squares.
        let part = independent.components[0].means[1] / independent.components[0].means[0];
        let of_equal =
            covariance[(1, 1)] - 2.0 * part * covariance[(0, 1)] + part * part * covariance[(0, 0)];
        let of_any: f64 = neighbours(&self.groups[0], self.residuals).map(|product| product * product).sum();
        let deviations = excess(&independent) / of_any.max(of_equal).sqrt();
        if deviations.is_nan() || deviations < SIGNIFICANT {
            return Ok(None);
        }
        let longest = self.groups[0].series.iter().map(Range::len).max().unwrap_or(0);
        let (mut low, mut high) = (0.0, (-1.0 / longest as f64).exp().atanh());
        let is_enough = |z: f64| self.variances(vec![z], context).map(|of| excess(&of) < 0.0);
        if is_enough(high)? {
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (low + high);
                if is_enough(middle)? { high = middle } else { low = middle }
            }
        }
        Ok(Some(high))
    }

    /// Returns the covariance of the logarithms of the variances, then of the nonzero transforms.
    pub(crate) fn uncertainty(
        &self,
        of: &Variances,
        context: &RunContext<'_>,
    ) -> Result<DMatrix<f64>, CalibrationError> {
        let n = self.groups.len();
        let lasting = || (0..n).filter(|g| of.transforms[*g] > 0.0);
        // The equations are the equations of the sums of squares, and of the products of
        // autocorrelated groups.
        let used: Vec<usize> = (0..n).map(|g| 2 * g).chain(lasting().map(|g| 2 * g + 1)).collect();
        let by = |means: &[f64], factor: f64| DVector::from_fn(used.len(), |a, _| means[used[a]] * factor);
        let parts = of.components.iter().zip(&of.values);
        let mut columns: Vec<DVector<f64>> = parts.map(|(part, value)| by(&part.means, *value)).collect();
        for g in lasting() {
            let at = |sign: f64| self.component(g, of.transforms[g] + sign * DIFFERENCE, context);
            let factor = of.values[g] / (2.0 * DIFFERENCE);
            columns.push(by(&at(1.0)?.means, factor) - by(&at(-1.0)?.means, factor));
        }
        let mut of_moments = self.covariance(of, context)?.select_rows(&used).select_columns(&used);
        // A known variance has the equation "variance = 1" instead, which is exact.
        for g in (0..n).filter(|g| self.groups[*g].is_known) {
            columns.iter_mut().enumerate().for_each(|(a, column)| column[g] = f64::from(u8::from(a == g)));
            of_moments.row_mut(g).fill(0.0);
            of_moments.column_mut(g).fill(0.0);
        }
        let exact = || {
            let inverse = DMatrix::from_columns(&columns).try_inverse()?;
            let found = &inverse * of_moments * inverse.transpose();
            found.iter().all(|value| value.is_finite()).then_some(found)
        };
        Ok(match exact() {
            Some(exact) if of.is_unbiased => exact,
            _ => DMatrix::from_diagonal(&DVector::from_fn(used.len(), |a, _| match self.groups.get(a) {
                Some(group) if group.is_known => 0.0,
                Some(group) => 2.0 * self.n_rows() / (group.n_rows() as f64 * self.degrees_of_freedom),
                None => 0.0,
            })),
        })
    }

    /// Returns the covariance `2 tr(B N C N)` of all moments `r'B r` and `r'C r`, with `N = M S M = S + W K
    /// W'`, `W = (U, F)`, `F = S U - U U'S U / 2` and `K = -((0, I), (I, 0))`.
    fn covariance(&self, of: &Variances, context: &RunContext<'_>) -> Result<DMatrix<f64>, CalibrationError> {
        let (q, n) = (self.base.ncols(), self.found.len());
        let parts = of.components.iter().zip(&of.values);
        let inner = parts.fold(self.of_priors.clone(), |sum, (part, value)| sum + &part.inner * *value);
        let mut k = DMatrix::zeros(2 * q, 2 * q);
        k.view_mut((0, q), (q, q)).fill_diagonal(-1.0);
        k.view_mut((q, 0), (q, q)).fill_diagonal(-1.0);
        // Below the diagonal: tr(B S C S) + 2 tr(K W'B S C W), for moments of one group.
        let mut within = DMatrix::<f64>::zeros(n, n);
        // K W'B W.
        let mut across = vec![DMatrix::zeros(2 * q, 2 * q); n];
        for (g, group) in self.groups.iter().enumerate() {
            let (value, rho) = (of.values[g], of.transforms[g].tanh());
            for range in &group.series {
                let rows = self.base.rows(range.start, range.len()).into_owned();
                let changed = spread(&rows, rho, context)? * value - &rows * &inner * 0.5;
                let mut w = rows.resize_horizontally(2 * q, 0.0);
                w.columns_mut(q, q).copy_from(&changed);
                let forms = [w.clone(), pairs(&w)];
                let traces = traces(range.len(), rho);
                for (a, form) in forms.iter().enumerate() {
                    across[2 * g + a] += &k * inner_products(w.as_view(), form.as_view(), context)?;
                    let moved = spread(form, rho, context)? * value;
                    for (b, other) in forms[..=a].iter().enumerate() {
                        let both = inner_products(other.as_view(), moved.as_view(), context)?;
                        within[(2 * g + a, 2 * g + b)] += value * value * traces[a + b] + 2.0 * k.dot(&both);
                    }
                }
            }
        }
        Ok(DMatrix::from_fn(n, n, |a, b| {
            2.0 * (within[(a.max(b), a.min(b))] + across[a].dot(&across[b].transpose()))
        }))
    }
}

impl Variances {
    /// Returns `U'dS U` for the derivatives of the covariance S with respect to the logarithms of the
    /// variances, then to the nonzero transforms.
    pub(crate) fn slopes(
        &self,
        groups: &[Group],
        base: &DMatrix<f64>,
        context: &RunContext<'_>,
    ) -> Result<Vec<DMatrix<f64>>, CalibrationError> {
        let of = |g: usize, z: f64| -> Result<DMatrix<f64>, CalibrationError> {
            let [inner, _] = of_base(&groups[g], base, z.tanh(), context)?;
            Ok(inner * self.values[g])
        };
        let transforms = || self.transforms.iter().enumerate();
        let by_variances = transforms().map(|(g, z)| of(g, *z));
        let by_transforms = transforms()
            .filter(|(_, z)| **z > 0.0)
            .map(|(g, z)| Ok((of(g, z + DIFFERENCE)? - of(g, z - DIFFERENCE)?) / (2.0 * DIFFERENCE)));
        by_variances.chain(by_transforms).collect()
    }
}

/// Returns the products of neighbouring residuals of a group.
fn neighbours<'a>(group: &'a Group, residuals: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
    let of = |range: &Range<usize>| residuals[range.clone()].windows(2);
    group.series.iter().flat_map(of).map(|pair| pair[0] * pair[1])
}

/// Returns `U'P R U` and `U'A R U` of a group with the correlation R.
fn of_base(
    group: &Group,
    base: &DMatrix<f64>,
    rho: f64,
    context: &RunContext<'_>,
) -> Result<[DMatrix<f64>; 2], CalibrationError> {
    let zero = || DMatrix::zeros(base.ncols(), base.ncols());
    let mut sums = [zero(), zero()];
    for range in &group.series {
        let rows = base.rows(range.start, range.len()).into_owned();
        let spread = spread(&rows, rho, context)?;
        sums[0] += inner_products(rows.as_view(), spread.as_view(), context)?;
        sums[1] += inner_products(pairs(&rows).as_view(), spread.as_view(), context)?;
    }
    Ok(sums)
}

/// Returns `tr(R R)`, `tr(A R R)` and `tr(A R A R)` of a series of n rows.
fn traces(n: usize, rho: f64) -> [f64; 3] {
    let mut sums = [n as f64, 0.0, 0.5 * n.saturating_sub(1) as f64 * (1.0 + rho * rho)];
    let mut power = 1.0;
    for lag in 1..n {
        sums[1] += 2.0 * rho * (n - lag) as f64 * power;
        power *= rho * rho;
        sums[0] += 2.0 * (n - lag) as f64 * power;
        sums[2] += 2.0 * (n - 1 - lag) as f64 * power;
        if power < f64::EPSILON {
            break;
        }
    }
    sums
}

/// Returns A times the rows of a series: the mean of both neighbours of each row, with zeros beyond the ends.
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

/// Returns R times the rows of a series, where R is the correlation of a first-order autoregression.
fn spread(rows: &DMatrix<f64>, rho: f64, context: &RunContext<'_>) -> Result<DMatrix<f64>, CalibrationError> {
    let (n, mut sums) = (rows.nrows(), rows.clone());
    if rho == 0.0 {
        return Ok(sums);
    }
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

    /// Compares the covariance of the moments with quadratic forms of full matrices.
    #[test]
    fn moments_match_covariance_of_quadratic_forms() {
        let (n, q, rho) = (9, 2, 0.6_f64);
        let context = RunContext::new();
        let base = DMatrix::from_fn(n + 1, q, |i, k| (i as f64 + 1.0).powi(k as i32)).qr().q();
        let groups =
            [Group { outputs: vec![0], series: vec![0..3, 4..n], starts: Vec::new(), is_known: false }];
        let residuals = vec![1.0; n + 1];
        let moments = Moments::new(&groups, &base, &residuals, n..n + 1, &context).unwrap();
        let variance = 2.5;
        let mut of = moments.variances(vec![rho.atanh()], &context).unwrap();
        of.values = vec![variance];
        let found = moments.covariance(&of, &context).unwrap();
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
        for (k, (b, found)) in [&p, &a].into_iter().zip(&moments.found).enumerate() {
            let mean = variance * of.components[0].means[k] + moments.grams[k].dot(&moments.of_priors);
            assert!((mean - (b * &s).trace()).abs() < 1e-9, "{mean}");
            assert_eq!(*found, [8.0, 6.0][k]);
        }
    }
}
