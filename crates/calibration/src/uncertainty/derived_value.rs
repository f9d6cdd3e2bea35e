//! Value of a derived parameter at the result of a fit, with the standard error that follows from the errors
//! of the parameters.

use super::result::{Uncertainty, check_level};
use crate::loaded::calibration::Calibration;
use serde::{Deserialize, Serialize};

/// [Derived](crate::Parameter::derived) or [tied](crate::Parameter::tied) parameter of a fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct DerivedValue {
    /// Name. If the value differs between experiments, the experiment follows: `b[run1]`.
    pub name: String,
    /// Name in reports and figures.
    pub shown_name: String,
    /// Formula over the parameters.
    pub expression: String,
    /// Name of the parameter that it is tied to; `None` for a formula of the user.
    pub tied_to: Option<String>,
    /// Value at the result.
    pub value: f64,
    /// Value at the start.
    pub start: f64,
    /// Partial derivatives at the result with respect to the entries of `x`.
    pub slopes: Vec<f64>,
    /// Lower and upper bound.
    pub bounds: (f64, f64),
    /// Unit, if it is known.
    pub unit: Option<String>,
}

impl DerivedValue {
    /// Returns the standard error `sqrt(g' C g)` with the partial derivatives g and the covariance C of the
    /// parameters (propagation of errors: Bard, Nonlinear Parameter Estimation, 1974, section 7.5). It is
    /// zero if all parameters of the formula are fixed or at a bound, infinite if one of them is not
    /// determined, and NaN if one of their errors is undefined.
    pub fn standard_error(&self, uncertainty: &Uncertainty) -> f64 {
        self.error(&uncertainty.standard_errors, &uncertainty.covariance)
    }

    /// Returns the standard error under the assumption of independent residuals, if the residuals are
    /// autocorrelated.
    pub fn uncorrected_error(&self, uncertainty: &Uncertainty) -> Option<f64> {
        let covariance = uncertainty.uncorrected_covariance.as_ref()?;
        Some(self.error(&uncertainty.uncorrected_errors()?, covariance))
    }

    fn error(&self, errors: &[f64], covariance: &[f64]) -> f64 {
        let n = self.slopes.len();
        let used: Vec<usize> = (0..n).filter(|&i| self.slopes[i] != 0.0 && errors[i] != 0.0).collect();
        match used[..] {
            [] => 0.0,
            _ if used.iter().any(|&i| errors[i].is_infinite()) => f64::INFINITY,
            [one] => self.slopes[one].abs() * errors[one],
            _ => {
                let of = |&i: &usize| {
                    let row = used.iter().map(|&j| covariance[i * n + j] * self.slopes[j]);
                    self.slopes[i] * row.sum::<f64>()
                };
                // The sum of a singular covariance may be slightly negative because of rounding. NaN stays NaN.
                let variance = used.iter().map(of).sum::<f64>();
                if variance < 0.0 { 0.0 } else { variance.sqrt() }
            }
        }
    }

    /// Returns the confidence interval, symmetric about the value. Student's t has the smallest number of
    /// degrees of freedom among the parameters of the formula. Returns `None` for an invalid level.
    pub fn confidence_interval(&self, uncertainty: &Uncertainty, level: f64) -> Option<(f64, f64)> {
        let error = self.standard_error(uncertainty);
        let degrees = self.slopes.iter().zip(&uncertainty.effective_degrees_of_freedom);
        let degrees = degrees.filter(|(slope, _)| **slope != 0.0).map(|(_, degrees)| *degrees);
        let quantile = check_level(level, degrees.fold(f64::INFINITY, f64::min)).ok()?;
        let half = if error == 0.0 { 0.0 } else { quantile * error };
        Some((self.value - half, self.value + half))
    }
}

impl Calibration {
    /// Returns the derived parameters at the result `x` of a fit from `start`.
    pub(crate) fn derived_at(&self, x: &[f64], start: &[f64]) -> Vec<DerivedValue> {
        let evaluator = self.evaluator();
        let at_start = evaluator.derived_values(start);
        let one = |((reported, value), (_, start))| {
            let reported: &crate::problem::derived::Reported = reported;
            let parameter = &self.problem().parameters[reported.parameter];
            let derivation = evaluator.simulations[reported.experiment].derivation();
            let slopes = derivation.entry_of(reported.parameter).map(|entry| derivation.slopes(entry, x));
            DerivedValue {
                name: reported.name.clone(),
                shown_name: reported.shown_name.clone(),
                expression: parameter.derivation().map(String::from).unwrap_or_default(),
                tied_to: parameter.tie().map(|tie| tie.to.to_owned()),
                value,
                start,
                slopes: slopes.unwrap_or_else(|| vec![0.0; x.len()]),
                bounds: parameter.given_bounds(),
                unit: parameter.unit(self.fmu().description()).map(str::to_owned),
            }
        };
        evaluator.derived_values(x).zip(at_start).map(one).collect()
    }
}
