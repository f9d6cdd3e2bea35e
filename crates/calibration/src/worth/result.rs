//! The numbers of what a fit is worth, confidence intervals, and how they are printed.

use super::digits::digits;
use super::residual_check::ResidualCheck;
use crate::error::CalibrationError;
use crate::finding::{Finding, table};
use dfo::RobustLoss;
use ode::Number;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::fmt;

/// How the covariance of the parameters is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// `(J'J)^-1 J'SJ (J'J)^-1` with one residual variance per output of the model, over all of its recordings with the same weight
    /// (a weight states the noise: recordings with different ones have variances of their own): `r'r / N_o N / (N - p)`. As
    /// [`Pooled`](Self::Pooled) where all residuals are rounding.
    #[default]
    Sandwich,
    /// `s^2 (J'J)^-1` with one variance for all residuals: `r'r / (N - p)`.
    Pooled,
}

impl Estimator {
    /// "sandwich" or "pooled".
    pub fn name(self) -> &'static str {
        match self {
            Self::Sandwich => "sandwich",
            Self::Pooled => "pooled",
        }
    }
}

impl fmt::Display for Estimator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sandwich => "sandwich (one residual variance per output)",
            Self::Pooled => "pooled (one variance for all residuals)",
        })
    }
}

/// How [`Calibration::worth`](crate::Calibration::worth) is found out.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct WorthOptions {
    /// How the covariance is estimated.
    pub estimator: Estimator,
    /// Simulations that run at once; default: all cores, in a fit: as many as its evaluations. The result does not depend on it.
    pub workers: Option<usize>,
    /// Parameters that are taken as known, by number, besides those that are fixed or lie at a bound: the standard errors of the others
    /// are conditional then. In a fit: those that it [holds](crate::FitOptions::held), too.
    pub held: Vec<usize>,
    /// What a residual counts; in a fit: as there. With a robust loss residuals and Jacobian are those of the residuals as they
    /// count.
    pub loss: RobustLoss,
}

/// What a fit is worth.
///
/// From central differences over steps of about one standard error (see the source of `differences`); never from second
/// derivatives. Residuals of priors count, with the variance 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Worth {
    /// How the covariance was estimated.
    pub estimator: Estimator,
    /// Names of the parameters.
    pub names: Vec<String>,
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// Whether a parameter is searched by its logarithm: its [confidence interval](Self::confidence_intervals) is symmetric there.
    pub is_log: Vec<bool>,
    /// Covariance of the parameters, n x n, row by row, in the user's units. Zero for parameters that are [held](Self::held); infinite on
    /// the diagonal, NaN beside it, for those that the data do not [determine](Self::undetermined).
    pub covariance: Vec<f64>,
    /// Standard errors: the roots of its diagonal.
    pub standard_errors: Vec<f64>,
    /// Correlation of the parameters, n x n, row by row; NaN where a standard error is zero or infinite.
    pub correlation: Vec<f64>,
    /// Standard errors with the residuals of each output taken for a first-order autoregression (covariance `s^2 rho^|i - j|`); `None`
    /// where no output has autocorrelated residuals.
    pub corrected_errors: Option<Vec<f64>>,
    /// The residuals of each output of each experiment, in the order of the residual vector.
    pub residual_checks: Vec<ResidualCheck>,
    /// Number of residuals less that of the parameters that are not held.
    pub degrees_of_freedom: usize,
    /// Parameters that are fixed, held, lie at a bound, or are no continuous numbers, by number: taken as known.
    pub held: Vec<usize>,
    /// Parameters that the data do not determine, by number.
    pub undetermined: Vec<usize>,
    /// Those of them that change no residual by more than the noise of the simulations.
    pub without_effect: Vec<usize>,
    /// Pairs of parameters that move the outputs the same way, with their correlation: 0.9 or more.
    pub confounded: Vec<(usize, usize, f64)>,
    /// The parameters of the combination that the data determine worst, where there are three or more in it.
    pub weakest: Vec<usize>,
    /// Parameters that this data can tell, by number: the longest beginning of the order in which the columns of the scaled Jacobian are
    /// most independent (QR with column pivoting; Burth, Verghese and Velez-Reyes, IEEE Trans. Power Systems 14, 1999) that has relative
    /// standard errors below 50 % and no correlation of 0.9 or more, the others held.
    pub identifiable: Vec<usize>,
    /// What is to be said of all this.
    pub findings: Vec<Finding>,
    /// The cost, as the fit has it.
    pub cost: f64,
    /// The cost with simulations a hundred times more accurate; `None` where they failed.
    pub accurate_cost: Option<f64>,
    /// Whether the residuals are within ten relative tolerances of the measurements: the data hold no noise, and how accurate the cost
    /// is does not matter.
    pub is_exact: bool,
    /// Derivatives of the residuals by the parameters, m x n, row by row, in the user's units; zero for those that are held.
    pub jacobian: Vec<f64>,
    /// The residuals, m.
    pub residuals: Vec<f64>,
    /// Points that were simulated to find out.
    pub n_simulations: usize,
}

impl Worth {
    /// Confidence intervals of the parameters, lower and upper end, by Student's t with the [degrees of
    /// freedom](Self::degrees_of_freedom): `x -+ t s`, of a parameter that is searched by its logarithm `x exp(-+ t s / x)`. Those of
    /// held parameters are points, those of undetermined ones have no ends. `level`: 0.95, for example.
    ///
    /// # Errors
    /// A level that does not lie between 0 and 1.
    pub fn confidence_intervals(&self, level: f64) -> Result<Vec<(f64, f64)>, CalibrationError> {
        self.intervals(level, &self.standard_errors)
    }

    /// The same with other standard errors: [`corrected_errors`](Self::corrected_errors), for example.
    ///
    /// # Errors
    /// As [`confidence_intervals`](Self::confidence_intervals).
    pub fn intervals(&self, level: f64, errors: &[f64]) -> Result<Vec<(f64, f64)>, CalibrationError> {
        let quantile = check_level(level, self.degrees_of_freedom)?;
        let interval = |((x, error), is_log): ((&f64, &f64), &bool)| match (*error, is_log) {
            (0.0, _) => (*x, *x),
            (error, true) if error.is_infinite() => (0.0, f64::INFINITY),
            (error, true) => (x * (-quantile * error / x).exp(), x * (quantile * error / x).exp()),
            (error, false) => (x - quantile * error, x + quantile * error),
        };
        Ok(self.x.iter().zip(errors).zip(&self.is_log).map(interval).collect())
    }

    /// What is to be said of the covariance: who is not determined, who is taken as known; empty if nothing is.
    pub fn message(&self) -> String {
        let mut said: Vec<String> = self.undetermined_findings().iter().map(Finding::advice).collect();
        if !self.held.is_empty() {
            let names: Vec<&str> = self.held.iter().map(|i| self.names[*i].as_str()).collect();
            said.push(format!("at a bound or fixed, taken as known: {}", names.join(", ")));
        }
        said.join("; ")
    }

    /// What is to be said of all this, in sentences; empty if nothing is.
    pub fn verdict(&self) -> Vec<String> {
        self.findings.iter().map(Finding::advice).collect()
    }

    /// The [findings](Self::findings) with other names of the parameters.
    pub(crate) fn findings_with(&self, names: &[String]) -> Vec<Finding> {
        if names == self.names {
            return self.findings.clone();
        }
        let experiments = self.residual_checks.iter().map(|check| &check.experiment);
        let are_several = self
            .residual_checks
            .first()
            .is_some_and(|first| experiments.clone().any(|e| *e != first.experiment));
        // No sentence that names a parameter depends on the tolerance.
        let named = self.all_findings(are_several, 0.0);
        let renamed = Self { names: names.to_vec(), ..self.clone() }.all_findings(are_several, 0.0);
        let shown = |finding: &Finding| {
            let place = named.iter().position(|other| other == finding);
            place.and_then(|place| renamed.get(place)).unwrap_or(finding).clone()
        };
        self.findings.iter().map(shown).collect()
    }
}

/// A line per parameter with its standard error, then the verdict.
impl fmt::Display for Worth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "standard errors: {}, {} degrees of freedom", self.estimator, self.degrees_of_freedom)?;
        let width = self.names.iter().map(String::len).max().unwrap_or(0);
        for (i, name) in self.names.iter().enumerate() {
            let (x, error) = (self.x[i], self.standard_errors[i]);
            write!(f, "{name:>width$}: {}", Number(x))?;
            if self.held.contains(&i) {
                f.write_str(", taken as known (fixed, held or at a bound)")?;
            } else if error.is_infinite() {
                f.write_str(", not determined")?;
            } else {
                write!(f, " +- {}", digits(error))?;
                if x != 0.0 {
                    write!(f, " ({} %)", digits(100.0 * error / x.abs()))?;
                }
                if let Some(corrected) = &self.corrected_errors {
                    write!(f, ", +- {} with autocorrelated residuals", digits(corrected[i]))?;
                }
            }
            f.write_str("\n")?;
        }
        write!(f, "{}", table(&self.findings).trim_start())
    }
}

/// The quantile of Student's t for a two-sided interval.
///
/// # Errors
/// A level that does not lie between 0 and 1.
pub(crate) fn check_level(level: f64, degrees_of_freedom: usize) -> Result<f64, CalibrationError> {
    if !(level > 0.0 && level < 1.0) {
        let level = Number(level);
        return Err(CalibrationError::Setup(format!(
            "the level of a confidence interval lies between 0 and 1, for example 0.95, not {level}"
        )));
    }
    let t = StudentsT::new(0.0, 1.0, degrees_of_freedom as f64);
    Ok(t.map_or(f64::INFINITY, |t| t.inverse_cdf(0.5 + 0.5 * level)))
}
