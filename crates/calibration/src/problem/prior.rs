//! Priors: knowledge of a parameter before the fit, added as one more residual.

use base::Number;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Knowledge of a parameter before the fit.
///
/// A prior adds one residual in units of its standard deviation. The sum of squares is then twice the
/// negative log posterior density, up to a constant (Tarantola, Inverse Problem Theory, 2005, section 3.2).
/// This requires that the residuals of the measurements are also in units of their standard deviations. Use
/// weights of 1/sigma, or let the fit estimate the noise ([`FitOptions::noise`](crate::FitOptions::noise)).
/// The bounds of a parameter are a uniform prior.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Prior {
    /// Normal distribution: the residual is `(p - mean) / sd`.
    Normal {
        /// The mean, in the unit of the parameter.
        mean: f64,
        /// The standard deviation, in the unit of the parameter.
        sd: f64,
    },
    /// Log-normal distribution: the residual is `(ln p - ln median) / sigma`.
    LogNormal {
        /// The median, in the unit of the parameter.
        median: f64,
        /// The standard deviation of the natural logarithm: 0.1 is about 10 %.
        sigma: f64,
    },
}

impl fmt::Display for Prior {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Normal { mean, sd } => write!(f, "prior {} +- {}", Number(mean), Number(sd)),
            Self::LogNormal { median, sigma } => {
                write!(f, "log-normal prior {}, sigma {}", Number(median), Number(sigma))
            }
        }
    }
}

impl Prior {
    /// Returns the residual at a value of the parameter. A log-normal prior returns NaN for a negative value.
    pub fn residual(&self, value: f64) -> f64 {
        match *self {
            Self::Normal { mean, sd } => (value - mean) / sd,
            Self::LogNormal { median, sigma } => (value / median).ln() / sigma,
        }
    }

    /// Returns the derivative of [`residual`](Self::residual).
    pub fn slope(&self, value: f64) -> f64 {
        match *self {
            Self::Normal { sd, .. } => 1.0 / sd,
            Self::LogNormal { sigma, .. } => 1.0 / (sigma * value),
        }
    }

    /// Returns a description of invalid numbers, or `None` if they are valid.
    pub(crate) fn problem(&self) -> Option<String> {
        let is_positive = |value: f64| value.is_finite() && value > 0.0;
        match *self {
            Self::Normal { mean, sd } if !mean.is_finite() || !is_positive(sd) => {
                let [mean, sd] = [mean, sd].map(Number);
                Some(format!(
                    "its normal prior has mean {mean} and sd {sd}. The mean must be finite, and sd must be positive"
                ))
            }
            Self::LogNormal { median, sigma } if !is_positive(median) || !is_positive(sigma) => {
                let [median, sigma] = [median, sigma].map(Number);
                Some(format!(
                    "its log-normal prior has median {median} and sigma {sigma}. Both must be positive"
                ))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prior_residuals_and_slopes_match_formulas() {
        let normal = Prior::Normal { mean: 2.0, sd: 0.5 };
        assert_eq!((normal.residual(3.0), normal.slope(3.0)), (2.0, 2.0));
        let relative = Prior::LogNormal { median: 2.0, sigma: 0.1 };
        assert!((relative.residual(2.0 * 0.2f64.exp()) - 2.0).abs() < 1e-12);
        assert_eq!(relative.slope(4.0), 2.5);
        assert!(relative.residual(-1.0).is_nan());
    }
}
