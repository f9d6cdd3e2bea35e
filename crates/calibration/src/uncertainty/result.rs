//! The numbers of the uncertainty of a fit, confidence intervals, and how they are printed.

use crate::error::CalibrationError;
use crate::findings::finding::{Finding, table};
use crate::findings::shown_text::{digits, visible_line};
use crate::uncertainty::diagnostics::prior_check::PriorConflict;
use crate::uncertainty::diagnostics::residual_check::ResidualCheck;
use crate::uncertainty::differences::ResidualBend;
use crate::uncertainty::joint_errors::JointErrors;
use crate::uncertainty::scores::Criterion;
use base::Number;
use dfo::RobustLoss;
use nalgebra::DVector;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};
use std::fmt;

/// Estimator of the covariance of the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// `(J'J)^-1 J'SJ (J'J)^-1` with one residual variance per output of the model, over all of its
    /// recordings with the same weight (a weight states the noise: recordings with different ones have
    /// variances of their own), estimated without bias. As [`Pooled`](Self::Pooled) where all residuals are
    /// rounding.
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

/// Options of [`Calibration::uncertainty`](crate::Calibration::uncertainty).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct UncertaintyOptions {
    /// Estimator of the covariance.
    pub estimator: Estimator,
    /// Simulations that run at once; default: all cores, in a fit: as many as its evaluations. The result
    /// does not depend on it.
    pub workers: Option<usize>,
    /// Parameters that are taken as known, by number, besides those that are fixed or lie at a bound: the
    /// standard errors of the others are conditional then. In a fit: those that it
    /// [holds](crate::FitOptions::held), too.
    pub held: Vec<usize>,
    /// Loss function: the contribution of a residual to the cost; in a fit: as there. With a robust loss the
    /// covariance is that of an M-estimator, `mean psi^2 / (mean psi')^2 (J'J)^-1` for each output (Huber,
    /// Robust Statistics, 1981, section 7.6).
    pub loss: RobustLoss,
    /// True if the cost is the [likelihood](crate::NamedCost::Likelihood), whose information weighs each
    /// output by the inverse of its variance; in a fit: as there.
    pub is_likelihood: bool,
}

impl UncertaintyOptions {
    pub(crate) fn criterion(&self) -> Criterion {
        if self.is_likelihood { Criterion::Likelihood } else { Criterion::Loss(self.loss) }
    }
}

/// Uncertainty of a fit, with checks of its residuals.
///
/// From central differences over steps of about one standard error (see the source of `differences`); never
/// from second derivatives. Residuals of priors count, with the variance 1.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Uncertainty {
    /// Estimator of the covariance.
    pub estimator: Estimator,
    /// Names of the parameters.
    pub names: Vec<String>,
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// True for each parameter that is searched by its logarithm: its
    /// [confidence interval](Self::confidence_intervals) is symmetric there.
    pub is_log: Vec<bool>,
    /// Sizes that standard errors are compared with to say how well a parameter is known: the value, of one
    /// whose bounds have zero between them the size that the search takes for it where that is larger. Empty:
    /// the values.
    #[serde(default)]
    pub sizes: Vec<f64>,
    /// Of each parameter: zero is one of its usual values, and a standard error says nothing relative to it.
    /// Empty: of none.
    #[serde(default)]
    pub is_about_zero: Vec<bool>,
    /// Covariance of the parameters, n x n, row by row, in the user's units, with the residuals of outputs
    /// that are autocorrelated taken for a first-order autoregression (see
    /// [`autocorrelations`](Self::autocorrelations)), and the noise of
    /// [measured](crate::InitialState::Measured) initial states. Zero for parameters that are
    /// [held](Self::held); infinite on the diagonal, NaN beside it, for those that the data do not
    /// [determine](Self::undetermined).
    pub covariance: Vec<f64>,
    /// Standard errors: the roots of its diagonal.
    pub standard_errors: Vec<f64>,
    /// Correlation of the parameters, n x n, row by row; NaN where a standard error is zero or infinite.
    pub correlation: Vec<f64>,
    /// The covariance that supposes independent residuals; `None` where no output has autocorrelated ones,
    /// and it is the same. See [`uncorrected`](Self::uncorrected).
    pub uncorrected_covariance: Option<Vec<f64>>,
    /// The autocorrelation rho at lag one that the covariance supposes of the residuals of each output of
    /// each experiment, `s^2 rho^|i - j|`, in the order of the residual vector: that of the residuals, but
    /// for the part that the fit has taken from it; zero where it is no more than chance.
    pub autocorrelations: Vec<f64>,
    /// Degrees of freedom of the quantile of Student's t for each parameter: twice the square of its variance
    /// over the variance of that estimate (Satterthwaite, Biometrics Bulletin 2, 1946). With one variance for
    /// all residuals these are the [`degrees_of_freedom`](Self::degrees_of_freedom). They are fewer where the
    /// variance is mostly that of an output with few measurements, or where residuals are autocorrelated, and
    /// more where it is mostly that of a prior.
    pub effective_degrees_of_freedom: Vec<f64>,
    /// The residuals of each output of each experiment, in the order of the residual vector.
    pub residual_checks: Vec<ResidualCheck>,
    /// Number of measurements less the number of parameters that they determine: the trace of the projection
    /// onto the changes by the parameters, over the residuals of the measurements. Without priors it is the
    /// number of parameters that are not held; a prior as good as the measurements counts one half of them.
    /// Measurements of weight zero do not count, nor those from which a simulation starts.
    pub degrees_of_freedom: f64,
    /// Parameters that are fixed, held, lie at a bound, or are no continuous numbers, by number: taken as
    /// known.
    pub held: Vec<usize>,
    /// Parameters that the data do not determine, by number.
    pub undetermined: Vec<usize>,
    /// Those of them that change no residual by more than the noise of the simulations.
    pub without_effect: Vec<usize>,
    /// Pairs of parameters that move the outputs the same way, with their correlation: 0.9 or more.
    pub confounded: Vec<(usize, usize, f64)>,
    /// The parameters of the combination that the data determine worst, where there are three or more in it.
    pub weakest: Vec<usize>,
    /// Parameters that this data can tell, by number: the longest beginning of the order in which the columns
    /// of the scaled Jacobian are most independent (QR with column pivoting; Burth, Verghese and Velez-Reyes,
    /// IEEE Trans. Power Systems 14, 1999) that has relative standard errors below 50 % and no correlation of
    /// 0.9 or more, the others held.
    pub identifiable: Vec<usize>,
    /// Changes of the residuals below this part of them are errors of the simulations.
    #[serde(default)]
    pub simulation_noise: f64,
    /// The residuals bend as no smooth model lets them: standard errors do not hold.
    #[serde(default)]
    pub roughness: Option<ResidualBend>,
    /// Findings about the uncertainty, the residuals and the cost.
    pub findings: Vec<Finding>,
    /// The cost, as the fit has it.
    pub cost: f64,
    /// The cost with a tenth of the relative tolerance, or with half the step; `None` where that
    /// simulation failed.
    pub accurate_cost: Option<f64>,
    /// By how many of its standard errors that accuracy moves the parameter that it moves most.
    #[serde(default)]
    pub shift_by_accuracy: f64,
    /// The method has a fixed step: the accurate cost is that with half of it.
    #[serde(default)]
    pub is_step_halved: bool,
    /// The step of the simulations in s, where they have one.
    #[serde(default)]
    pub step_size: Option<f64>,
    /// True if the residuals are within ten relative tolerances of the measurements: the data hold no noise,
    /// and the accuracy of the cost does not matter.
    pub is_exact: bool,
    /// The part of the cost that one more step of least squares takes away, as simulated: 0 at a minimum. 0
    /// too where that step is within the standard errors, and where the measurements are reproduced
    /// [exactly](Self::is_exact).
    #[serde(default)]
    pub left_to_gain: f64,
    /// No part of that step can be simulated: what would be gained is predicted.
    #[serde(default)]
    pub is_at_failures: bool,
    /// Priors that the measurements contradict.
    #[serde(default)]
    pub prior_conflicts: Vec<PriorConflict>,
    /// The cost has a robust loss.
    #[serde(default)]
    pub has_loss: bool,
    /// Derivatives of the residuals by the parameters, m x n, row by row, in the user's units; zero for those
    /// that are held.
    pub jacobian: Vec<f64>,
    /// The residuals, m, before a loss.
    pub residuals: Vec<f64>,
    /// Covariance of the parameters and of measured initial states together, from which predictions are made.
    #[serde(default)]
    pub(crate) joint: JointErrors,
    /// The same for independent residuals.
    #[serde(default)]
    pub(crate) uncorrected_joint: Option<JointErrors>,
    /// Points that were simulated to find out.
    pub n_simulations: usize,
}

impl Uncertainty {
    /// Confidence intervals of the parameters, lower and upper end, by Student's t with the [degrees of
    /// freedom](Self::effective_degrees_of_freedom) of each: `x -+ t s`, of a parameter that is searched by
    /// its logarithm `x exp(-+ t s / x)`. Those of held parameters are points, those of undetermined ones
    /// have no ends. `level`: 0.95, for example.
    ///
    /// # Errors
    /// A level that does not lie between 0 and 1.
    pub fn confidence_intervals(&self, level: f64) -> Result<Vec<(f64, f64)>, CalibrationError> {
        let interval = |i: usize| {
            let (x, quantile) = (self.x[i], check_level(level, self.effective_degrees_of_freedom[i])?);
            Ok(match (self.standard_errors[i], self.is_log[i]) {
                (0.0, _) => (x, x),
                (error, true) if error.is_infinite() => (0.0, f64::INFINITY),
                (error, true) => (x * (-quantile * error / x).exp(), x * (quantile * error / x).exp()),
                (error, false) => (x - quantile * error, x + quantile * error),
            })
        };
        (0..self.x.len()).map(interval).collect()
    }

    /// The same with covariance, standard errors, correlation and degrees of freedom that suppose independent
    /// residuals.
    pub fn uncorrected(&self) -> Self {
        let mut own = self.clone();
        if let Some(covariance) = own.uncorrected_covariance.take() {
            (own.standard_errors, own.correlation) = errors_and_correlation(&covariance, own.x.len());
            own.covariance = covariance;
            if let Some(joint) = own.uncorrected_joint.take() {
                // A parameter that is held, or that the data do not determine, has none of its own.
                let all = own.degrees_of_freedom;
                let degrees = |i: usize| {
                    Some(joint.degrees_of_freedom(&joint.of(i))).filter(|own| !own.is_nan()).unwrap_or(all)
                };
                own.effective_degrees_of_freedom = (0..own.x.len()).map(degrees).collect();
                own.joint = joint;
            }
            own.autocorrelations.fill(0.0);
        }
        own
    }

    /// Standard errors that suppose independent residuals; `None` where no output has autocorrelated ones.
    pub fn uncorrected_errors(&self) -> Option<Vec<f64>> {
        self.uncorrected_covariance
            .as_deref()
            .map(|covariance| errors_and_correlation(covariance, self.x.len()).0)
    }

    /// The standard errors in the coordinates of the search.
    pub(crate) fn errors_of_search(&self) -> impl Iterator<Item = f64> + '_ {
        let own = self.standard_errors.iter().zip(&self.x).zip(&self.is_log);
        own.map(|((error, x), is_log)| if *is_log { error / x } else { *error })
    }

    /// Notes by how much another accuracy of the simulations moves the parameters: steps of these in the
    /// coordinates of the search.
    pub(crate) fn note_shift(&mut self, free: &[usize], steps: &DVector<f64>) {
        let errors: Vec<f64> = self.errors_of_search().collect();
        let shifts = free.iter().zip(steps).map(|(i, step)| (step / errors[*i]).abs());
        self.shift_by_accuracy = shifts.filter(|shift| shift.is_finite()).fold(0.0, f64::max);
    }

    /// True if the data determine a parameter, and there are no residuals left that would tell its error.
    pub(crate) fn has_unknown_error(&self, i: usize) -> bool {
        self.standard_errors[i].is_infinite() && !self.undetermined.contains(&i)
    }

    /// Findings about the covariance in words: parameters that are not determined, or taken as known; empty
    /// if there are none.
    pub fn message(&self) -> String {
        let mut said: Vec<String> = self.undetermined_findings().iter().map(Finding::advice).collect();
        if !self.held.is_empty() {
            let names: Vec<&str> = self.held.iter().map(|i| self.names[*i].as_str()).collect();
            said.push(format!("at a bound or fixed, taken as known: {}", names.join(", ")));
        }
        said.join("; ")
    }

    /// All findings in sentences; empty if there are none.
    pub fn verdict(&self) -> Vec<String> {
        self.findings.iter().map(Finding::advice).collect()
    }

    /// The [findings](Self::findings) with other names of the parameters.
    pub(crate) fn findings_with(&self, names: &[String]) -> Vec<Finding> {
        if names == self.names {
            return self.findings.clone();
        }
        // No sentence that names a parameter depends on the tolerance.
        let named = self.all_findings(0.0);
        let renamed = Self { names: names.to_vec(), ..self.clone() }.all_findings(0.0);
        let shown = |finding: &Finding| {
            let place = named.iter().position(|other| other == finding);
            place.and_then(|place| renamed.get(place)).unwrap_or(finding).clone()
        };
        self.findings.iter().map(shown).collect()
    }
}

/// A line per parameter with its standard error, then the verdict.
impl fmt::Display for Uncertainty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let uncorrected = self.uncorrected_errors();
        let corrected = if uncorrected.is_some() { ", corrected for autocorrelated residuals" } else { "" };
        let (estimator, degrees) = (self.estimator, digits(self.degrees_of_freedom));
        writeln!(f, "standard errors: {estimator}{corrected}, {degrees} degrees of freedom")?;
        let names: Vec<_> = self.names.iter().map(|name| visible_line(name)).collect();
        let width = names.iter().map(|name| name.len()).max().unwrap_or(0);
        for (i, name) in names.iter().enumerate() {
            let (x, error) = (self.x[i], self.standard_errors[i]);
            write!(f, "{name:>width$}: {}", Number(x))?;
            if self.held.contains(&i) {
                f.write_str(", taken as known (fixed, held or at a bound)")?;
            } else if error.is_infinite() {
                f.write_str(if self.has_unknown_error(i) { ", error unknown" } else { ", not determined" })?;
            } else {
                write!(f, " +- {}", digits(error))?;
                if x != 0.0 {
                    write!(f, " ({} %)", digits(100.0 * error / x.abs()))?;
                }
                if let Some(uncorrected) = &uncorrected {
                    write!(f, ", +- {} if the residuals were independent", digits(uncorrected[i]))?;
                }
            }
            f.write_str("\n")?;
        }
        write!(f, "{}", table(&self.findings).trim_start())
    }
}

/// The roots of the diagonal of an n x n covariance, and the correlation: NaN where a root is zero or
/// infinite.
pub(crate) fn errors_and_correlation(covariance: &[f64], n: usize) -> (Vec<f64>, Vec<f64>) {
    let errors: Vec<f64> = (0..n).map(|i| covariance[i * n + i].max(0.0).sqrt()).collect();
    let correlation = |k: usize| {
        let scale = errors[k / n] * errors[k % n];
        match scale > 0.0 && scale.is_finite() {
            true if k / n == k % n => 1.0,
            true => (covariance[k] / scale).clamp(-1.0, 1.0),
            false => f64::NAN,
        }
    };
    let correlation = (0..n * n).map(correlation).collect();
    (errors, correlation)
}

/// The quantile of Student's t for a two-sided interval; infinite without degrees of freedom.
///
/// # Errors
/// A level that does not lie between 0 and 1.
pub(crate) fn check_level(level: f64, degrees_of_freedom: f64) -> Result<f64, CalibrationError> {
    if !(level > 0.0 && level < 1.0) {
        let level = Number(level);
        return Err(CalibrationError::Setup(format!(
            "the level of a confidence interval lies between 0 and 1, for example 0.95, not {level}"
        )));
    }
    Ok(student_quantile(0.5 + 0.5 * level, degrees_of_freedom))
}

/// From so many degrees of freedom on the expansion is accurate to rounding; far beyond, an inversion of the
/// distribution loses its digits.
const MANY: f64 = 1000.0;

/// The quantile of Student's t: by inversion of the distribution; for many degrees of freedom by the
/// Cornish-Fisher expansion about that of the normal distribution (Abramowitz and Stegun, Handbook of
/// Mathematical Functions, 1964, 26.7.5).
fn student_quantile(probability: f64, degrees_of_freedom: f64) -> f64 {
    let nu = degrees_of_freedom;
    if nu < MANY {
        return StudentsT::new(0.0, 1.0, nu).map_or(f64::INFINITY, |t| t.inverse_cdf(probability));
    }
    let x = Normal::standard().inverse_cdf(probability);
    let x2 = x * x;
    let terms = [
        (x2 + 1.0) / 4.0,
        ((5.0 * x2 + 16.0) * x2 + 3.0) / 96.0,
        (((3.0 * x2 + 19.0) * x2 + 17.0) * x2 - 15.0) / 384.0,
        ((((79.0 * x2 + 776.0) * x2 + 1482.0) * x2 - 1920.0) * x2 - 945.0) / 92_160.0,
    ];
    x * (1.0 + terms.iter().rev().fold(0.0, |sum, term| (sum + term) / nu))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_student_are_those_of_the_tables() {
        for (nu, expected) in [
            (1.0, 12.706_204_736),
            (2.0, 4.302_652_730),
            (5.0, 2.570_581_836),
            (10.0, 2.228_138_852),
            (30.0, 2.042_272_456),
            (100.0, 1.983_971_519),
            (1000.0, 1.962_339_081),
            (1e9, 1.959_963_987),
            (1e300, 1.959_963_985),
        ] {
            let got = check_level(0.95, nu).unwrap();
            assert!((got - expected).abs() < 2e-9, "{nu}: {got} instead of {expected}");
        }
        assert!(check_level(0.95, 0.0).unwrap().is_infinite());
        for level in [0.5, 0.95, 0.999_999] {
            let steps = (0..=9000).map(|k| 10f64.powf(f64::from(k) / 1000.0));
            let quantiles: Vec<f64> = steps.map(|nu| check_level(level, nu).unwrap()).collect();
            assert!(quantiles.is_sorted_by(|a, b| a >= b), "{level}");
        }
        assert!(check_level(1.0, 5.0).is_err() && check_level(f64::NAN, 5.0).is_err());
    }
}
