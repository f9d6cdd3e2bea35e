//! Residuals that follow first-order autoregressions: what they make of the covariance of the parameters, and
//! how well that is known.

use crate::error::CalibrationError;
use crate::uncertainty::row_blocks::{beside, go_on, inner_products};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::ops::Range;

/// Residuals that share a variance and an autocorrelation: series, each in the order of time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Group {
    pub(crate) series: Vec<Range<usize>>,
    /// Variance of each of them if they are independent.
    pub(crate) variance: f64,
    /// Factor of a variance, see [`Working`](crate::uncertainty::scores::Working).
    pub(crate) correction: f64,
    /// True if the residuals are rounding: they give no information.
    pub(crate) is_rounding: bool,
}

/// Twice the rise of the logarithm of the likelihood from which on an autocorrelation is no chance: of
/// independent residuals one in forty has a larger one, and a positive autocorrelation.
const SIGNIFICANT: f64 = 3.84;

/// The autocorrelation is searched by its Fisher transform `artanh rho`, up to rho = 0.9993, in these steps.
const STEP: f64 = 0.1;
const STEPS: usize = 40;

/// Steps of the differences that give the information on the logarithm of a variance and on a transform.
const DIFFERENCE: f64 = 0.05;

/// Fewer degrees of freedom are no approximation any more.
const FEWEST: f64 = 2.0;

/// Estimated autocorrelation of the residuals, where any of them are autocorrelated.
pub(crate) struct Dependence<'a> {
    base: &'a DMatrix<f64>,
    groups: &'a [Group],
    /// Of each group: logarithm of the variance, `artanh rho`.
    found: Vec<(f64, f64)>,
    /// Covariance of these: logarithms of the variances, then transforms of those groups that are
    /// autocorrelated.
    uncertainty: DMatrix<f64>,
    /// `U' S U` of what belongs to no group.
    rest: DMatrix<f64>,
    /// The chance of autocorrelations as large where there are none, by the ratio of the likelihoods.
    chance: f64,
}

/// The quadratic forms of a group: with `Z = [U r]`, Z'R^-1 Z is a polynomial of rho over `1 - rho^2`.
struct Form {
    whole: DMatrix<f64>,
    inner: DMatrix<f64>,
    neighbours: DMatrix<f64>,
    n: f64,
    n_series: f64,
}

impl Form {
    fn at(&self, z: f64) -> DMatrix<f64> {
        let rho = z.tanh();
        (&self.whole + &self.inner * (rho * rho) - &self.neighbours * rho) / (1.0 - rho * rho)
    }
}

/// The restricted likelihood of the groups (Patterson and Thompson, Biometrika 58, 1971).
struct Likelihood {
    forms: Vec<Form>,
    /// Z'S^-1 Z of what belongs to no group.
    rest: DMatrix<f64>,
    q: usize,
}

impl Likelihood {
    /// Z'R^-1 Z of each group.
    fn products(&self, at: &[(f64, f64)]) -> Vec<DMatrix<f64>> {
        self.forms.iter().zip(at).map(|(form, (_, z))| form.at(*z)).collect()
    }

    fn sum(&self, products: &[DMatrix<f64>], at: &[(f64, f64)]) -> DMatrix<f64> {
        products.iter().zip(at).fold(self.rest.clone(), |mut sum, (product, (ln, _))| {
            let factor = (-ln).exp();
            sum.zip_apply(product, |sum, own| *sum += own * factor);
            sum
        })
    }

    /// Its logarithm; minus infinity where the numbers allow none.
    fn logarithm(&self, at: &[(f64, f64)]) -> f64 {
        self.logarithm_with(&self.products(at), at)
    }

    fn logarithm_with(&self, products: &[DMatrix<f64>], at: &[(f64, f64)]) -> f64 {
        let (sum, q) = (self.sum(products, at), self.q);
        let Some(factor) = sum.view((0, 0), (q, q)).into_owned().cholesky() else { return f64::NEG_INFINITY };
        let right = sum.view((0, q), (q, 1)).into_owned();
        let squares = sum[(q, q)] - right.dot(&factor.solve(&right));
        let determinant: f64 = factor.l_dirty().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
        let of = |(form, (ln, z)): (&Form, &(f64, f64))| {
            form.n * ln + (form.n - form.n_series) * (1.0 - z.tanh().powi(2)).ln()
        };
        -0.5 * (self.forms.iter().zip(at).map(of).sum::<f64>() + determinant + squares)
    }

    /// The best variances with these autocorrelations, by the fixed point `s^2 = e'R^-1 e / (n - tr)`.
    fn set_variances(&self, products: &[DMatrix<f64>], at: &mut [(f64, f64)]) {
        let q = self.q;
        let rounds = if self.forms.len() == 1 { 2 } else { 4 };
        for _ in 0..rounds {
            let sum = self.sum(products, at);
            let Some(factor) = sum.view((0, 0), (q, q)).into_owned().cholesky() else { return };
            let mut error = sum.view((0, q), (q, 1)).into_owned();
            factor.solve_mut(&mut error);
            let error = error.resize_vertically(q + 1, -1.0);
            for ((form, own), (ln, _)) in self.forms.iter().zip(products).zip(at.iter_mut()) {
                let mut used = own.view((0, 0), (q, q)).into_owned();
                factor.solve_mut(&mut used);
                let used = used.trace() * (-*ln).exp();
                let variance = error.dot(&(own * &error)) / (form.n - used).max(0.5);
                if variance > 0.0 && variance.is_finite() {
                    *ln = variance.ln();
                }
            }
        }
    }

    /// The likelihood with the autocorrelation of one group there, and all variances.
    fn with(&self, at: &[(f64, f64)], g: usize, z: f64) -> (f64, Vec<(f64, f64)>) {
        let mut at = at.to_vec();
        at[g].1 = z;
        let products = self.products(&at);
        self.set_variances(&products, &mut at);
        (self.logarithm_with(&products, &at), at)
    }

    /// The best autocorrelation of one group that is not negative.
    fn best(
        &self,
        at: &[(f64, f64)],
        g: usize,
        context: &RunContext<'_>,
    ) -> Result<(f64, Vec<(f64, f64)>), CalibrationError> {
        let value = |z: f64| go_on(context).map(|()| self.with(at, g, z).0);
        let values: Vec<f64> = (0..=STEPS).map(|k| value(STEP * k as f64)).collect::<Result<_, _>>()?;
        let k = (0..values.len()).fold(0, |best, k| if values[k] > values[best] { k } else { best });
        let (mut low, mut high) = (STEP * (k as f64 - 1.0).max(0.0), STEP * (k + 1).min(STEPS) as f64);
        let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
        for _ in 0..20 {
            let (a, b) = (high - golden * (high - low), low + golden * (high - low));
            if value(a)? > value(b)? { high = b } else { low = a }
        }
        Ok(self.with(at, g, 0.5 * (low + high)))
    }
}

impl<'a> Dependence<'a> {
    /// Variance and autocorrelation of each group by restricted maximum likelihood, from residuals r and an
    /// orthonormal base U of the changes that the parameters make of them: unlike the autocorrelation of the
    /// residuals, which the fit has made smaller, they are nearly free of bias. `None` where no group has an
    /// autocorrelation that is no chance (by the ratio of the likelihoods). Residuals of no group are
    /// independent with their variances.
    pub(crate) fn find(
        base: &'a DMatrix<f64>,
        residuals: &[f64],
        groups: &'a [Group],
        variances: &[f64],
        context: &RunContext<'_>,
    ) -> Result<Option<Self>, CalibrationError> {
        let q = base.ncols();
        let z = beside(base, residuals, context)?;
        let form = |group: &Group| -> Result<Form, CalibrationError> {
            let zero = || DMatrix::zeros(q + 1, q + 1);
            let (mut form, mut n) = ((zero(), zero(), zero()), 0);
            for range in &group.series {
                let products = |a: usize, b: usize, len: usize| {
                    let rows = |from: usize| z.rows(range.start + from, len);
                    inner_products(rows(a).as_view(), rows(b).as_view(), context)
                };
                let len = range.len();
                n += len;
                form.0 += products(0, 0, len)?;
                if len > 2 {
                    form.1 += products(1, 1, len - 2)?;
                }
                if len > 1 {
                    let product = products(1, 0, len - 1)?;
                    form.2 += &product + product.transpose();
                }
            }
            let (whole, inner, neighbours) = form;
            let n_series = group.series.iter().filter(|range| !range.is_empty()).count() as f64;
            Ok(Form { whole, inner, neighbours, n: n as f64, n_series })
        };
        let is_of_group = |i: usize| groups.iter().any(|g| g.series.iter().any(|range| range.contains(&i)));
        // Priors: few, behind all measurements.
        let end = groups.iter().flat_map(|g| g.series.iter().map(|range| range.end)).max().unwrap_or(0);
        let alone: Vec<usize> = (end..residuals.len()).filter(|i| !is_of_group(*i)).collect();
        let (mut rest, mut of_rest) = (DMatrix::zeros(q + 1, q + 1), DMatrix::zeros(q, q));
        for &i in alone.iter().filter(|i| variances[**i] > 0.0) {
            let row = z.row(i);
            rest += row.tr_mul(&row) / variances[i];
            of_rest += base.row(i).tr_mul(&base.row(i)) * variances[i];
        }
        let is_usable = |g: &Group| !g.is_rounding && g.variance > 0.0 && g.variance.is_finite();
        if q == 0 || !groups.iter().all(|g| g.variance > 0.0 && g.variance.is_finite()) {
            return Ok(None);
        }
        let forms = groups.iter().map(form).collect::<Result<_, _>>()?;
        let likelihood = Likelihood { forms, rest, q };
        let mut at: Vec<(f64, f64)> =
            groups.iter().map(|g| ((g.variance / g.correction).ln(), 0.0)).collect();
        likelihood.set_variances(&likelihood.products(&at), &mut at);
        let candidates: Vec<usize> = (0..groups.len())
            .filter(|g| is_usable(&groups[*g]) && likelihood.forms[*g].n > (q + 2) as f64)
            .collect();
        let (mut last, mut largest) = (likelihood.logarithm(&at), 0.0_f64);
        let rounds = if candidates.len() == 1 { 1 } else { 8 };
        for _ in 0..rounds {
            largest = 0.0;
            for &g in &candidates {
                let (with, best) = likelihood.best(&at, g, context)?;
                let (without, independent) = likelihood.with(&at, g, 0.0);
                largest = largest.max(2.0 * (with - without));
                at = if 2.0 * (with - without) > SIGNIFICANT { best } else { independent };
            }
            let now = likelihood.logarithm(&at);
            if (now - last).abs() < 1e-6 {
                break;
            }
            last = now;
        }
        if at.iter().all(|(_, z)| *z == 0.0) {
            return Ok(None);
        }
        let uncertainty = uncertainty(&likelihood, &at, context)?;
        // Half of the cases have none at the bound zero, the others chi squared (Self and Liang, JASA 82, 1987).
        let chance = 0.5 * ChiSquared::new(1.0).map_or(1.0, |of| of.sf(largest)) * candidates.len() as f64;
        Ok(Some(Self { base, groups, found: at, uncertainty, rest: of_rest, chance }))
    }

    /// The chance of autocorrelations as large where there are none.
    pub(crate) fn chance(&self) -> f64 {
        self.chance
    }

    /// The autocorrelation of a group at lag one; zero where it is none.
    pub(crate) fn autocorrelation(&self, g: usize) -> f64 {
        self.found[g].1.tanh()
    }

    /// U'S U of a group with an autocorrelation, S its covariance for the variance that was found.
    fn middle(&self, g: usize, z: f64, context: &RunContext<'_>) -> Result<DMatrix<f64>, CalibrationError> {
        let (q, rho) = (self.base.ncols(), z.tanh());
        let mut middle = DMatrix::zeros(q, q);
        for range in &self.groups[g].series {
            let rows = self.base.rows(range.start, range.len());
            let mut sums = rows.clone_owned();
            for (values, mut sums) in rows.column_iter().zip(sums.column_iter_mut()) {
                go_on(context)?;
                let n = values.len();
                add_neighbours(rho, &values, &mut sums, 0..n);
                add_neighbours(rho, &values, &mut sums, (0..n).rev());
            }
            middle += inner_products(rows.as_view(), sums.as_view(), context)?;
        }
        Ok(middle * (self.found[g].0.exp() * self.groups[g].correction))
    }

    /// The covariance `G U'S U G'` of least squares with such residuals (Seber and Wild, Nonlinear
    /// Regression, 1989, chapter 6), and the degrees of freedom of each of its variances v: `2 / var(ln v)`
    /// with the uncertainty of what was found, at most `most` (Satterthwaite, Biometrics Bulletin 2, 1946;
    /// Kenward and Roger, Biometrics 53, 1997).
    pub(crate) fn covariance(
        &self,
        inverse: &DMatrix<f64>,
        most: f64,
        context: &RunContext<'_>,
    ) -> Result<(DMatrix<f64>, Vec<f64>), CalibrationError> {
        let n = self.found.len();
        let middles = (0..n).map(|g| self.middle(g, self.found[g].1, context));
        let middles: Vec<DMatrix<f64>> = middles.collect::<Result<_, _>>()?;
        let mut derivatives = middles.clone();
        for g in (0..n).filter(|g| self.found[*g].1 > 0.0) {
            let at = |sign: f64| self.middle(g, self.found[g].1 + sign * DIFFERENCE, context);
            derivatives.push((at(1.0)? - at(-1.0)?) / (2.0 * DIFFERENCE));
        }
        let middle = middles.iter().fold(self.rest.clone(), |sum, own| sum + own);
        let of_row = |i: usize| {
            let c = inverse.row(i).transpose();
            let form = |matrix: &DMatrix<f64>| c.dot(&(matrix * &c));
            let variance = form(&middle);
            let slopes =
                DVector::from_iterator(derivatives.len(), derivatives.iter().map(|d| form(d) / variance));
            let of_logarithm = slopes.dot(&(&self.uncertainty * &slopes));
            let found = 2.0 / of_logarithm;
            if found.is_finite() { found.clamp(FEWEST.min(most), most) } else { most }
        };
        let degrees = (0..inverse.nrows()).map(of_row).collect();
        Ok((inverse * middle * inverse.transpose(), degrees))
    }
}

/// The inverse of the observed information; of what has none in a direction, that of a unit step.
fn uncertainty(
    likelihood: &Likelihood,
    at: &[(f64, f64)],
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    let n = at.len();
    let correlated: Vec<usize> = (0..n).filter(|g| at[*g].1 > 0.0).collect();
    let moved = |steps: &[(usize, f64)]| {
        let mut at = at.to_vec();
        for &(k, by) in steps {
            if k < n { at[k].0 += by } else { at[correlated[k - n]].1 += by }
        }
        likelihood.logarithm(&at)
    };
    let (h, m) = (DIFFERENCE, n + correlated.len());
    let mut information = DMatrix::zeros(m, m);
    for a in 0..m {
        go_on(context)?;
        for b in 0..=a {
            let at = |i: f64, j: f64| moved(&[(a, i * h), (b, j * h)]);
            let second = (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / (4.0 * h * h);
            (information[(a, b)], information[(b, a)]) = (-second, -second);
        }
    }
    let mut axes = information.symmetric_eigen();
    axes.eigenvalues.iter_mut().for_each(|value| *value = value.max(1.0).recip());
    Ok(axes.recompose())
}

/// Adds to each sum the values that come before it in this order, each with the power of rho that its
/// distance is.
fn add_neighbours(
    rho: f64,
    values: &nalgebra::DVectorView<'_, f64>,
    sums: &mut nalgebra::DVectorViewMut<'_, f64>,
    order: impl Iterator<Item = usize>,
) {
    let mut before = 0.0;
    for i in order {
        sums[i] += rho * before;
        before = values[i] + rho * before;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Normally distributed numbers, nearly: sums of twelve uniform ones.
    fn normal(n: usize) -> Vec<f64> {
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..n).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
    }

    fn autoregressive(rho: f64, n: usize) -> Vec<f64> {
        let series = normal(n).into_iter().scan(0.0, |last, e| {
            *last = rho * *last + (1.0 - rho * rho).sqrt() * e;
            Some(*last)
        });
        series.collect()
    }

    /// A constant and a line, orthonormal, and what they leave of the errors.
    fn left(errors: &[f64]) -> (DMatrix<f64>, Vec<f64>) {
        let n = errors.len();
        let base = DMatrix::from_fn(n, 2, |i, k| if k == 0 { 1.0 } else { i as f64 }).qr().q();
        let errors = DVector::from_column_slice(errors);
        let residuals = &errors - &base * base.tr_mul(&errors);
        (base, residuals.as_slice().to_vec())
    }

    fn group(series: &[Range<usize>]) -> Group {
        Group { series: series.to_vec(), variance: 1.0, correction: 1.0, is_rounding: false }
    }

    #[test]
    fn an_autocorrelation_is_found_and_chance_is_none() {
        for rho in [0.5, 0.9] {
            let (base, residuals) = left(&autoregressive(rho, 400));
            let groups = [group(std::slice::from_ref(&(0..400)))];
            let found = Dependence::find(&base, &residuals, &groups, &[1.0; 400], &RunContext::new())
                .unwrap()
                .unwrap();
            assert!((found.autocorrelation(0) - rho).abs() < 0.06, "{}", found.autocorrelation(0));
            // U'S U of the Toeplitz matrix.
            let (rho, variance) = (found.autocorrelation(0), found.found[0].0.exp());
            let s = DMatrix::from_fn(400, 400, |i, j| variance * rho.powi((i as i32 - j as i32).abs()));
            let expected = base.transpose() * s * &base;
            let (covariance, degrees) =
                found.covariance(&DMatrix::identity(2, 2), 398.0, &RunContext::new()).unwrap();
            assert!((&covariance - &expected).amax() < 1e-9 * expected.amax());
            assert!(degrees.iter().all(|d| (3.0..200.0).contains(d)), "{degrees:?}");
        }
        let (base, residuals) = left(&normal(400));
        assert!(
            Dependence::find(
                &base,
                &residuals,
                &[group(std::slice::from_ref(&(0..400)))],
                &[1.0; 400],
                &RunContext::new()
            )
            .unwrap()
            .is_none()
        );
        // Nothing is read from rounding.
        let (base, residuals) = left(&autoregressive(0.9, 400));
        let rounding = Group { is_rounding: true, ..group(std::slice::from_ref(&(0..400))) };
        assert!(
            Dependence::find(&base, &residuals, &[rounding], &[1.0; 400], &RunContext::new())
                .unwrap()
                .is_none()
        );
    }

    #[test]
    fn groups_have_autocorrelations_of_their_own() {
        let errors: Vec<f64> =
            normal(300).into_iter().chain(autoregressive(0.8, 300).iter().map(|e| 5.0 * e)).collect();
        let (base, residuals) = left(&errors);
        let groups = [group(&[0..150, 150..300]), group(std::slice::from_ref(&(300..600)))];
        let found =
            Dependence::find(&base, &residuals, &groups, &[1.0; 600], &RunContext::new()).unwrap().unwrap();
        assert_eq!(found.autocorrelation(0), 0.0);
        assert!((found.autocorrelation(1) - 0.8).abs() < 0.08, "{}", found.autocorrelation(1));
        let variances: Vec<f64> = found.found.iter().map(|(ln, _)| ln.exp()).collect();
        assert!(
            (variances[0] - 1.0).abs() < 0.25 && (variances[1] / 25.0 - 1.0).abs() < 0.5,
            "{variances:?}"
        );
    }
}
