//! Results of an uncertainty estimate, confidence intervals, and their printed form.

use crate::error::CalibrationError;
use crate::findings::display_text::{digits, visible_line};
use crate::findings::finding::{Finding, table};
use crate::uncertainty::diagnostics::lack_of_fit::LackOfFit;
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
    /// `(J'J)^-1 J'SJ (J'J)^-1` with one residual variance per output of the model, estimated without bias.
    /// The variance is shared by all recordings of the output with the same weight. Recordings with different
    /// weights have separate variances, because a weight declares the noise. If all residuals are rounding
    /// errors, it is the same as [`Pooled`](Self::Pooled).
    #[default]
    Sandwich,
    /// `s^2 (J'J)^-1` with one variance for all residuals: `r'r / (N - p)`.
    Pooled,
}

impl Estimator {
    /// Returns "sandwich" or "pooled".
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

/// Description of standard errors for known noise.
pub(crate) const KNOWN_NOISE: &str = "absolute, from the known noise (sigma)";

/// Options of [`Calibration::uncertainty`](crate::Calibration::uncertainty).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct UncertaintyOptions {
    /// Estimator of the covariance.
    pub estimator: Estimator,
    /// Number of parallel simulations. Default: all cores or, in a fit, the workers of the fit. The result
    /// does not depend on it.
    pub workers: Option<usize>,
    /// Indices of parameters to treat as known, in addition to fixed parameters and parameters at a bound.
    /// The standard errors of the other parameters are then conditional. In a fit, the parameters that it
    /// [holds](crate::FitOptions::held) are added.
    pub held: Vec<usize>,
    /// Loss function, which maps a residual to its contribution to the cost. A fit replaces it by its own
    /// loss. With a robust loss, the covariance belongs to an M-estimator: `mean psi^2 / (mean psi')^2
    /// (J'J)^-1` for each output (Huber, Robust Statistics, 1981, section 7.6).
    pub loss: RobustLoss,
    /// True if the cost is the [likelihood](crate::NamedCost::Likelihood), whose information weights each
    /// output by the inverse of its variance. In a fit, it follows from the cost of the fit.
    pub is_likelihood: bool,
    /// True if all weights are 1 over the known standard deviation of the noise, so that the covariance is
    /// `(J'J)^-1`. In a fit, it follows from [`NoiseRule::Stated`](crate::NoiseRule::Stated). Outputs with
    /// [`Weight::Sigma`](crate::Weight::Sigma) always have known noise. A robust loss and the likelihood
    /// estimate the noise in all cases.
    pub is_noise_known: bool,
}

impl UncertaintyOptions {
    pub(crate) fn criterion(&self) -> Criterion {
        if self.is_likelihood { Criterion::Likelihood } else { Criterion::Loss(self.loss) }
    }
}

/// Uncertainty of a fit, with checks of its residuals.
///
/// It is computed from central differences over steps of about one standard error (see the source of
/// `differences`). Second derivatives are never used. Residuals of priors count with variance 1.
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
    /// True for each parameter with a logarithmic scale. Its [confidence
    /// interval](Self::confidence_intervals) is symmetric in the logarithm.
    pub is_log: Vec<bool>,
    /// Sizes for relative standard errors. The size is the absolute value of the parameter. If zero is
    /// between the bounds, it is at least the size used by the search. An empty vector selects the absolute
    /// values.
    #[serde(default)]
    pub sizes: Vec<f64>,
    /// True for each parameter for which zero is a usual value. A relative standard error is then
    /// meaningless. An empty vector means that no parameter has this property.
    #[serde(default)]
    pub is_about_zero: Vec<bool>,
    /// Covariance of the parameters, n x n, row by row, in the user's units. Autocorrelated residuals are
    /// modelled as a first-order autoregression (see [`autocorrelations`](Self::autocorrelations)). The noise
    /// of [measured](crate::InitialState::Measured) initial states is included. Entries are zero for
    /// [held](Self::held) parameters. For [undetermined](Self::undetermined) parameters, the diagonal is
    /// infinite and the other entries are NaN.
    pub covariance: Vec<f64>,
    /// Standard errors: the square roots of the diagonal of the covariance.
    pub standard_errors: Vec<f64>,
    /// Correlation of the parameters, n x n, row by row. It is NaN if a standard error is zero or infinite.
    pub correlation: Vec<f64>,
    /// Constraints that hold with equality at the point, as written. The covariance is conditional on them:
    /// moves across them are excluded, like moves across bounds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub active_constraints: Vec<String>,
    /// Covariance under the assumption of independent residuals; see [`uncorrected`](Self::uncorrected).
    /// `None` if no output has autocorrelated residuals, because the two covariances are then equal.
    pub uncorrected_covariance: Option<Vec<f64>>,
    /// Autocorrelation rho at lag one that the covariance assumes for the residuals of each output of each
    /// experiment, `s^2 rho^|i - j|`. The order is the order of the residual vector. It is the
    /// autocorrelation of the residuals, corrected for the part that the fit has removed. It is zero if it is
    /// not significant.
    pub autocorrelations: Vec<f64>,
    /// Degrees of freedom of the quantile of Student's t for each parameter. They are twice the squared
    /// variance of the parameter, divided by the variance of that estimate (Satterthwaite, Biometrics
    /// Bulletin 2, 1946). With one variance for all residuals, they are the
    /// [`degrees_of_freedom`](Self::degrees_of_freedom). They are fewer if the variance is mostly from an
    /// output with few measurements, or if residuals are autocorrelated. They are more if the variance is
    /// mostly from a prior.
    pub effective_degrees_of_freedom: Vec<f64>,
    /// Checks of the residuals of each output of each experiment, in the order of the residual vector.
    pub residual_checks: Vec<ResidualCheck>,
    /// Test against the pure error of replicates; `None` without replicates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lack_of_fit: Option<LackOfFit>,
    /// Number of measurements minus the number of parameters that they determine. The latter is the trace of
    /// the projection onto the changes due to the parameters, over the residuals of the measurements. Without
    /// priors, it is the number of parameters that are not held. A parameter whose prior is as precise as the
    /// measurements counts one half. Measurements of weight zero and measurements that a simulation starts
    /// from are not counted. Infinite if the noise of all outputs is known.
    pub degrees_of_freedom: f64,
    /// Indices of parameters treated as known: fixed, held, at a bound, or not continuous.
    pub held: Vec<usize>,
    /// Indices of parameters that the data do not determine.
    pub undetermined: Vec<usize>,
    /// Indices of undetermined parameters that change no residual by more than the noise of the simulations.
    pub without_effect: Vec<usize>,
    /// Pairs of parameters with similar effects on the outputs, and their correlation (at least 0.9 in
    /// absolute value).
    pub confounded: Vec<(usize, usize, f64)>,
    /// Parameters of the combination that the data determine worst, if it contains three or more parameters.
    pub weakest: Vec<usize>,
    /// Indices of parameters that the data can determine while the others are held fixed. They are the
    /// longest prefix of the pivot order with relative standard errors below 50 % and no correlation of 0.9
    /// or more. In the pivot order, the columns of the scaled Jacobian are as independent as possible (QR
    /// with column pivoting; Burth, Verghese and Velez-Reyes, IEEE Trans. Power Systems 14, 1999).
    pub identifiable: Vec<usize>,
    /// Relative size of residual changes below which changes are simulation errors.
    #[serde(default)]
    pub simulation_noise: f64,
    /// Bends of the residuals that no smooth model can have. If present, the standard errors are invalid.
    #[serde(default)]
    pub roughness: Option<ResidualBend>,
    /// Findings about the uncertainty, the residuals and the cost.
    pub findings: Vec<Finding>,
    /// Cost, as defined in the fit.
    pub cost: f64,
    /// Cost with a tenth of the relative tolerance, or with half the step; `None` if that simulation failed
    /// or was skipped.
    pub accurate_cost: Option<f64>,
    /// Largest change of a parameter due to the higher accuracy, in its standard errors.
    #[serde(default)]
    pub shift_by_accuracy: f64,
    /// True if the method uses a fixed step. The accurate cost is then the cost with half the step.
    #[serde(default)]
    pub is_step_halved: bool,
    /// Step of the simulations in s, if they have one.
    #[serde(default)]
    pub step_size: Option<f64>,
    /// True if the residuals are within ten relative tolerances of the measurements. The data then contain no
    /// noise, and the accuracy of the cost does not matter.
    pub is_exact: bool,
    /// Relative decrease of the cost by one more least-squares step, as simulated. It is 0 at a minimum. It
    /// is also 0 if that step is within the standard errors, or if the measurements are reproduced
    /// [exactly](Self::is_exact).
    #[serde(default)]
    #[serde(rename = "left_to_gain")]
    pub achievable_decrease: f64,
    /// True if the simulations along that step failed. The decrease is then a prediction.
    #[serde(default)]
    pub is_at_failures: bool,
    /// Priors that the measurements contradict.
    #[serde(default)]
    pub prior_conflicts: Vec<PriorConflict>,
    /// True if the cost has a robust loss.
    #[serde(default)]
    pub has_loss: bool,
    /// Derivatives of the residuals with respect to the parameters, m x n, row by row, in the user's units.
    /// Columns of fixed parameters are zero.
    pub jacobian: Vec<f64>,
    /// Residuals, m, before a loss is applied.
    pub residuals: Vec<f64>,
    /// Joint covariance of the parameters and measured initial states, used for predictions.
    #[serde(default)]
    pub(crate) joint: JointErrors,
    /// Joint covariance under the assumption of independent residuals.
    #[serde(default)]
    pub(crate) uncorrected_joint: Option<JointErrors>,
    /// Number of points simulated for the estimate.
    pub n_simulations: usize,
}

impl Uncertainty {
    /// Returns the lower and upper ends of the confidence intervals of the parameters at `level`, for example
    /// 0.95. They use Student's t with the [degrees of freedom](Self::effective_degrees_of_freedom) of each
    /// parameter: `x -+ t s`, or `x exp(-+ t s / x)` on a logarithmic scale. Intervals of fixed parameters
    /// are points. Intervals of undetermined parameters are unbounded.
    ///
    /// # Errors
    /// Returns an error if the level is not between 0 and 1.
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

    /// Returns the uncertainty with covariance, standard errors, correlation and degrees of freedom under the
    /// assumption of independent residuals.
    pub fn uncorrected(&self) -> Self {
        let mut uncorrected = self.clone();
        if let Some(covariance) = uncorrected.uncorrected_covariance.take() {
            (uncorrected.standard_errors, uncorrected.correlation) =
                errors_and_correlation(&covariance, uncorrected.x.len());
            uncorrected.covariance = covariance;
            if let Some(joint) = uncorrected.uncorrected_joint.take() {
                // A fixed or undetermined parameter has no separate degrees of freedom.
                let all = uncorrected.degrees_of_freedom;
                let degrees = |i: usize| {
                    Some(joint.degrees_of_freedom(&joint.of(i)))
                        .filter(|degrees_of_parameter| !degrees_of_parameter.is_nan())
                        .unwrap_or(all)
                };
                uncorrected.effective_degrees_of_freedom = (0..uncorrected.x.len()).map(degrees).collect();
                uncorrected.joint = joint;
            }
            uncorrected.autocorrelations.fill(0.0);
        }
        uncorrected
    }

    /// Returns the standard errors under the assumption of independent residuals. Returns `None` if no
    /// output has autocorrelated residuals.
    pub fn uncorrected_errors(&self) -> Option<Vec<f64>> {
        self.uncorrected_covariance
            .as_deref()
            .map(|covariance| errors_and_correlation(covariance, self.x.len()).0)
    }

    /// True if the noise of all outputs is known, so that the standard errors do not depend on the residuals.
    pub fn is_noise_known(&self) -> bool {
        self.degrees_of_freedom.is_infinite()
    }

    /// Returns the standard errors in the coordinates of the search.
    pub(crate) fn errors_of_search(&self) -> impl Iterator<Item = f64> + '_ {
        let errors = self.standard_errors.iter().zip(&self.x).zip(&self.is_log);
        errors.map(|((error, x), is_log)| if *is_log { error / x } else { *error })
    }

    /// Stores the largest change of a parameter due to a different accuracy of the simulations. The `steps`
    /// are the changes in the coordinates of the search.
    pub(crate) fn note_shift(&mut self, free: &[usize], steps: &DVector<f64>) {
        let errors: Vec<f64> = self.errors_of_search().collect();
        let shifts = free.iter().zip(steps).map(|(i, step)| (step / errors[*i]).abs());
        self.shift_by_accuracy = shifts.filter(|shift| shift.is_finite()).fold(0.0, f64::max);
    }

    /// True if the data determine a parameter but too few residuals are left to estimate its error.
    pub(crate) fn has_unknown_error(&self, i: usize) -> bool {
        self.standard_errors[i].is_infinite() && !self.undetermined.contains(&i)
    }

    /// Returns findings about the covariance as text: parameters that are undetermined or treated as known.
    /// The text is empty if there are none.
    pub fn message(&self) -> String {
        let mut reported: Vec<String> = self.undetermined_findings().iter().map(Finding::advice).collect();
        if !self.active_constraints.is_empty() {
            let texts = self.active_constraints.join("', '");
            reported.push(format!("conditional on the active constraints: '{texts}'"));
        }
        if !self.held.is_empty() {
            let names: Vec<&str> = self.held.iter().map(|i| self.names[*i].as_str()).collect();
            reported.push(format!("at a bound or fixed, treated as known: {}", names.join(", ")));
        }
        reported.join(". ")
    }

    /// Returns all findings as sentences; empty if there are none.
    pub fn verdict(&self) -> Vec<String> {
        self.findings.iter().map(Finding::advice).collect()
    }

    /// Returns the [findings](Self::findings) with other names of the parameters.
    pub(crate) fn findings_with(&self, names: &[String]) -> Vec<Finding> {
        if names == self.names {
            return self.findings.clone();
        }
        // Sentences that name a parameter do not depend on the tolerance.
        let named = self.all_findings(0.0);
        let renamed = Self { names: names.to_vec(), ..self.clone() }.all_findings(0.0);
        let shown = |finding: &Finding| {
            let place = named.iter().position(|other| other == finding);
            place.and_then(|place| renamed.get(place)).unwrap_or(finding).clone()
        };
        self.findings.iter().map(shown).collect()
    }
}

/// Prints a line with the standard error of each parameter, then the findings.
impl fmt::Display for Uncertainty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let uncorrected = self.uncorrected_errors();
        let corrected = if uncorrected.is_some() { ", corrected for autocorrelated residuals" } else { "" };
        match self.is_noise_known() {
            true => writeln!(f, "standard errors: {KNOWN_NOISE}")?,
            false => {
                let (estimator, degrees) = (self.estimator, digits(self.degrees_of_freedom));
                writeln!(f, "standard errors: {estimator}{corrected}, {degrees} degrees of freedom")?;
            }
        }
        let names: Vec<_> = self.names.iter().map(|name| visible_line(name)).collect();
        let width = names.iter().map(|name| name.len()).max().unwrap_or(0);
        for (i, name) in names.iter().enumerate() {
            let (x, error) = (self.x[i], self.standard_errors[i]);
            write!(f, "{name:>width$}: {}", Number(x))?;
            if self.held.contains(&i) {
                f.write_str(", treated as known (fixed, held or at a bound)")?;
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

/// Returns the square roots of the diagonal of an n x n covariance, and the correlation. The correlation is
/// NaN if a root is zero or infinite.
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

/// Returns the quantile of Student's t for a two-sided interval; infinite for zero degrees of freedom.
///
/// # Errors
/// Returns an error if the level is not between 0 and 1.
pub(crate) fn check_level(level: f64, degrees_of_freedom: f64) -> Result<f64, CalibrationError> {
    if !(level > 0.0 && level < 1.0) {
        let level = Number(level);
        return Err(CalibrationError::Setup(format!(
            "level = {level} must be between 0 and 1, for example 0.95"
        )));
    }
    Ok(student_quantile(0.5 + 0.5 * level, degrees_of_freedom))
}

/// Number of degrees of freedom above which the expansion is accurate to rounding. Far above it, inverting
/// the distribution loses digits.
const MANY: f64 = 1000.0;

/// Returns the quantile of Student's t by inverting the distribution. For many degrees of freedom, it uses
/// the Cornish-Fisher expansion about the normal quantile (Abramowitz and Stegun, Handbook of Mathematical
/// Functions, 1964, 26.7.5).
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
    fn student_quantiles_match_tables() {
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
