//! Goodness of fit: chi-square, information criteria, and the comparison of two fits.

use crate::findings::display_text::digits;
use crate::fit::one_stage::{Fit, FitNoise, ModelledNoise};
use crate::fit::output_fit::OutputFit;
use crate::problem::objective::{CostKind, NamedCost};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor};
use std::collections::BTreeSet;
use std::fmt;

/// Statistics of the residuals of a fit, with the names and definitions of lmfit 1.3 (documentation,
/// "Performing Fits and Analyzing Outputs", section "Goodness-of-Fit Statistics").
///
/// They use the residuals of the measurements, with the weights of the calibration and without a
/// loss. The criteria assume independent normal errors with one variance: minus twice the logarithm of the
/// likelihood is `N ln(chisqr / N)` up to a constant. With an error model
/// ([`Sigma::Model`](crate::Sigma::Model)), the residuals have the weights of the fit, and it is `chisqr + 2
/// sum ln sigma`. Estimated coefficients then count as parameters of the criteria. The criteria are NaN if
/// the noise of other outputs is not known. With the [likelihood](crate::NamedCost::Likelihood), each of m
/// variables has a variance, it is `sum N_o ln(chisqr_o / N_o)`, and m - 1 variances count as parameters.
/// One output then has the criteria of the sum of squares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Goodness {
    /// Number of measurements N that count.
    pub ndata: usize,
    /// Number of fitted parameters k, including parameters at a bound, minus the number of equalities between
    /// them.
    pub nvarys: usize,
    /// Degrees of freedom: `ndata - nvarys`.
    pub nfree: usize,
    /// Sum of the squared residuals.
    pub chisqr: f64,
    /// Reduced chi-square: `chisqr / max(1, nfree)`.
    pub redchi: f64,
    /// Akaike's criterion: `N ln(chisqr / N) + 2 k` (IEEE Trans. Automatic Control 19, 1974).
    pub aic: f64,
    /// Akaike's criterion for few measurements: `aic + 2 k (k + 1) / (N - k - 1)` (Hurvich and Tsai,
    /// Biometrika 76, 1989). Infinite if `N <= k + 1`.
    pub aicc: f64,
    /// Bayesian criterion: `N ln(chisqr / N) + k ln N` (Schwarz, Annals of Statistics 6, 1978).
    pub bic: f64,
    /// Probability of a larger `chisqr` by chance, from the chi-square distribution with `nfree` degrees of
    /// freedom. `None` if the noise is not known or there are no degrees of freedom.
    pub p_value: Option<f64>,
}

impl Goodness {
    /// Computes the statistics of N residuals with this sum of squares.
    /// `with_models` replaces `N ln(chisqr / N)` and is the number of estimated coefficients.
    fn new(
        chisqr: f64,
        ndata: usize,
        nvarys: usize,
        is_noise_known: bool,
        with_models: Option<(f64, usize)>,
    ) -> Self {
        let (n, nfree) = (ndata as f64, ndata.saturating_sub(nvarys));
        let (likelihood, n_coefficients) = with_models.unwrap_or((n * (chisqr / n).ln(), 0));
        let k = (nvarys + n_coefficients) as f64;
        let aic = likelihood + 2.0 * k;
        let capacity = n - k - 1.0;
        let of = ChiSquared::new(nfree as f64).ok().filter(|_| is_noise_known);
        Self {
            ndata,
            nvarys,
            nfree,
            chisqr,
            redchi: chisqr / nfree.max(1) as f64,
            aic,
            aicc: if capacity > 0.0 { aic + 2.0 * k * (k + 1.0) / capacity } else { f64::INFINITY },
            bic: likelihood + k * n.ln(),
            p_value: of.map(|of| of.sf(chisqr)),
        }
    }
}

/// Comparison of two fits to the same measurements, see [`Fit::compare`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Comparison {
    /// Statistics of the two fits.
    pub fits: [Goodness; 2],
    /// True if the fits have different weights, or if only one of them minimised the likelihood or has known
    /// noise. The criteria are then those of the likelihood of the measurements themselves, and unknown
    /// variances count as parameters. `chisqr` and `redchi` have the weights of each fit.
    #[serde(default)]
    pub is_of_measurements: bool,
    /// F statistic of the decrease of `chisqr` by the additional parameters of the larger model. `None` if
    /// both fits have the same number of parameters, error models or different weights, if a fit minimised
    /// the likelihood, or if the larger model leaves no degree of freedom.
    pub f: Option<f64>,
    /// Probability of a larger F if the smaller model is right. It requires that the models are nested: the
    /// smaller one is the larger one with fixed or derived parameters.
    pub p_value: Option<f64>,
}

impl Fit {
    /// Returns statistics of the residuals: chi-square and information criteria.
    pub fn goodness(&self) -> Goodness {
        let is_at_bound = |i: &usize| self.at_bound.iter().any(|(k, _)| k == i);
        let is_held = |i: &usize| {
            let held = self.uncertainty.as_ref().map_or(&[][..], |uncertainty| &uncertainty.held);
            self.bounds[*i].0 == self.bounds[*i].1 || (held.contains(i) && !is_at_bound(i))
        };
        let nvarys = (0..self.x.len()).filter(|i| !is_held(i)).count().saturating_sub(self.n_equalities);
        let chisqr = self.rms * self.rms * self.n_measurements as f64;
        let is_noise_known = self.noise.as_ref().is_some_and(FitNoise::is_known);
        let models = self.models();
        let with_models = (!models.is_empty()).then(|| {
            let logarithms =
                models.iter().flat_map(|noise| &noise.series).map(|series| series.sum_of_logarithms);
            let n_modelled: usize = models.iter().map(|noise| noise.series.len()).sum();
            let is_all = is_noise_known || n_modelled == self.outputs.len();
            let likelihood = if is_all { chisqr + 2.0 * logarithms.sum::<f64>() } else { f64::NAN };
            (likelihood, models.iter().map(|noise| noise.coefficients().count()).sum())
        });
        let with_noise = with_models.or_else(|| self.likelihood_of_outputs());
        Goodness::new(chisqr, self.n_measurements, nvarys, is_noise_known, with_noise)
    }

    /// Returns minus twice the logarithm of the likelihood with a variance for each variable, up to the
    /// constant of [`Goodness`], and the number of variances after the first. `None` for other costs.
    fn likelihood_of_outputs(&self) -> Option<(f64, usize)> {
        if self.objective != CostKind::Named(NamedCost::Likelihood).name() {
            return None;
        }
        let priors: f64 = self.priors.iter().map(|(k, prior)| prior.residual(self.x[*k]).powi(2)).sum();
        let variables: BTreeSet<&str> = self.outputs.iter().map(|output| &*output.variable).collect();
        Some((2.0 * self.cost - priors, variables.len().saturating_sub(1)))
    }

    fn models(&self) -> &[ModelledNoise] {
        self.noise.as_ref().map_or(&[], FitNoise::models)
    }

    /// Returns the statistics with the criteria of the likelihood of the measurements instead of the weighted
    /// residuals, up to the constant `N (1 + ln 2 pi)`. The weights 1/sigma of an output add `2 sum ln
    /// sigma`, so fits with different weights can be compared. Returns `None` if the weights are unknown.
    fn goodness_of_measurements(&self) -> Option<Goodness> {
        let log_weights: f64 = self.outputs.iter().map(|output| output.log_weights).sum::<Option<f64>>()?;
        let of = self.goodness();
        let n = of.ndata as f64;
        let is_noise_known = self.noise.as_ref().is_some_and(FitNoise::is_known);
        let (likelihood, n_variances) = match self.likelihood_of_outputs() {
            Some((likelihood, more)) => (likelihood, more + 1),
            None if is_noise_known => (of.chisqr - n, 0),
            None => (n * (of.chisqr / n).ln(), 1),
        };
        let criteria = Some((likelihood - 2.0 * log_weights, n_variances));
        Some(Goodness::new(of.chisqr, of.ndata, of.nvarys, is_noise_known, criteria))
    }

    /// True if the criteria of the weighted residuals of two fits do not have the same constant.
    fn differs_in_weights(&self, other: &Self) -> bool {
        let pairs = self.outputs.iter().zip(&other.outputs);
        let is_other = |(a, b): (&OutputFit, &OutputFit)| match (a.log_weights, b.log_weights) {
            // The sums of equal weights differ by rounding only.
            (Some(a), Some(b)) => (a - b).abs() > 1e-9 * (1.0 + a.abs()),
            _ => false,
        };
        let is_likelihood = |fit: &Self| fit.likelihood_of_outputs().is_some();
        let is_known = |fit: &Self| fit.noise.as_ref().is_some_and(FitNoise::is_known);
        let is_one_likelihood = is_likelihood(self) != is_likelihood(other);
        pairs.into_iter().any(is_other) || (is_one_likelihood && is_known(self) != is_known(other))
    }

    /// Compares this fit with another fit to the same measurements. With different weights, the criteria are
    /// those of the likelihood of the measurements ([`Comparison::is_of_measurements`]). The F statistic of
    /// models with k1 and k2 > k1 parameters is `(chisqr1 - chisqr2) / (k2 - k1) / redchi2` (Seber and Wild,
    /// Nonlinear Regression, 1989, section 5.3). Fits with an error model have different weights, so only
    /// their information criteria are compared.
    ///
    /// # Errors
    /// Returns a message if the fits have different outputs or numbers of measurements, or if only one of
    /// them has an error model.
    pub fn compare(&self, other: &Self) -> Result<Comparison, String> {
        let compared = |fit: &Self| -> Vec<(String, String, usize, bool)> {
            fit.outputs.iter().map(|o| (o.variable.clone(), o.column.clone(), o.n, o.is_log)).collect()
        };
        if self.n_measurements != other.n_measurements || compared(self) != compared(other) {
            return Err(format!(
                "the fits cannot be compared because they have different measurements ({} and {}). Fit the same data",
                self.n_measurements, other.n_measurements
            ));
        }
        let modelled =
            |fit: &Self| -> Vec<String> { fit.models().iter().map(|noise| noise.variable.clone()).collect() };
        if modelled(self) != modelled(other) {
            return Err("the fits cannot be compared because an output has an error model (sigma) in only one of them. \
                        Use an error model in both, such as 'a + b*abs(y)' and 'b*abs(y)'"
                .to_owned());
        }
        let of_weighted = || [self.goodness(), other.goodness()];
        let of_measurements = || Some([self.goodness_of_measurements()?, other.goodness_of_measurements()?]);
        let is_other = self.models().is_empty() && self.differs_in_weights(other);
        let (fits, is_of_measurements) = match is_other.then(of_measurements).flatten() {
            Some(fits) => (fits, true),
            None => (of_weighted(), false),
        };
        let (small, large) = if fits[0].nvarys <= fits[1].nvarys { (0, 1) } else { (1, 0) };
        let (small, large) = (fits[small], fits[large]);
        let (added, nfree) = ((large.nvarys - small.nvarys) as f64, large.nfree as f64);
        let has_variances = self.likelihood_of_outputs().or(other.likelihood_of_outputs()).is_some();
        let of = FisherSnedecor::new(added, nfree)
            .ok()
            .filter(|_| self.models().is_empty() && !has_variances && !is_of_measurements);
        let f = of.map(|_| (small.chisqr - large.chisqr) / added / large.redchi);
        // A model that is not nested may have a larger sum of squares.
        let p_value = of.zip(f).map(|(of, f)| of.sf(f.max(0.0)));
        Ok(Comparison { fits, is_of_measurements, f, p_value })
    }
}

/// Prints a table with one row for each fit, then the F test.
impl fmt::Display for Comparison {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "fit  parameters       chisqr       redchi          aic         aicc          bic")?;
        for (k, of) in self.fits.iter().enumerate() {
            write!(out, "{:<3}  {:>10}", k + 1, of.nvarys)?;
            for value in [of.chisqr, of.redchi, of.aic, of.aicc, of.bic] {
                write!(out, " {:>12}", digits(value).to_string())?;
            }
            writeln!(out)?;
        }
        if self.is_of_measurements {
            writeln!(
                out,
                "the fits differ in weights or in knowledge of the noise: aic, aicc and bic are those of the likelihood of the measurements, \
                 with unknown variances as parameters; chisqr and redchi cannot be compared"
            )?;
        }
        match (self.f, self.p_value) {
            (Some(f), Some(p)) => {
                write!(
                    out,
                    "F test of the larger model, if the models are nested: F = {}, p = {}",
                    digits(f),
                    digits(p)
                )
            }
            _ => write!(
                out,
                "no F test: the fits have an error model or different weights, or minimised the likelihood, have the same number of parameters, or no degrees of freedom"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of lmfit's definitions for 12 residuals with the sum of squares 3 and 2 parameters.
    #[test]
    fn goodness_follows_the_definitions_of_lmfit() {
        let of = Goodness::new(3.0, 12, 2, true, None);
        let likelihood = 12.0 * (0.25_f64).ln();
        assert_eq!((of.ndata, of.nvarys, of.nfree, of.redchi), (12, 2, 10, 0.3));
        assert!((of.aic - (likelihood + 4.0)).abs() < 1e-12);
        assert!((of.bic - (likelihood + 2.0 * (12.0_f64).ln())).abs() < 1e-12);
        assert!((of.aicc - (of.aic + 12.0 / 9.0)).abs() < 1e-12);
        // scipy.stats.chi2.sf(3, 10)
        assert!((of.p_value.unwrap() - 0.981_424_063_777_859_3).abs() < 1e-12);
        assert_eq!(Goodness::new(3.0, 12, 2, false, None).p_value, None);
        assert!(Goodness::new(3.0, 3, 2, false, None).aicc.is_infinite());
    }
}
