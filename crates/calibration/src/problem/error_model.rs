//! Error model of an output: a standard deviation that depends on the simulated value.

use crate::expression::{Expression, Factor};
use base::Number;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Standard deviation `a + b*abs(y)` of the noise of an output, where `y` is the simulated value (combined
/// error model: Davidian and Giltinan, Nonlinear Models for Repeated Measurement Data, 1995, section 2.2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ErrorModel {
    /// The term `a`, in the unit of the column.
    pub constant: Coefficient,
    /// The factor `b` of `abs(y)`.
    pub proportional: Coefficient,
}

/// Coefficient of an [`ErrorModel`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Coefficient {
    /// A known value of at least 0.
    Stated(f64),
    /// A value that a fit estimates, with its name.
    Fitted(String),
}

/// Coefficients before the first fit, relative to the mean size of the measurements.
const AT_START: f64 = 0.1;

impl Coefficient {
    fn of(factor: Factor<'_>) -> Option<Self> {
        match factor {
            Factor::Number(value) => (value >= 0.0).then_some(Self::Stated(value)),
            Factor::Name(name) => {
                let is_word = name.chars().all(|c| c.is_alphanumeric() || c == '_');
                is_word.then(|| Self::Fitted(name.to_owned()))
            }
            Factor::Magnitude(_) => None,
        }
    }

    /// Returns the stated value.
    pub fn stated(&self) -> Option<f64> {
        match self {
            Self::Stated(value) => Some(*value),
            Self::Fitted(_) => None,
        }
    }

    /// Returns the name of a fitted value.
    pub fn name(&self) -> Option<&str> {
        match self {
            Self::Stated(_) => None,
            Self::Fitted(name) => Some(name),
        }
    }
}

impl fmt::Display for Coefficient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stated(value) => write!(f, "{}", Number(*value)),
            Self::Fitted(name) => f.write_str(name),
        }
    }
}

impl ErrorModel {
    /// True if the text is an error model, or is meant to be one. All other strings are names of columns.
    pub fn is_meant(text: &str) -> bool {
        text.contains("abs(") || text.parse::<Self>().is_ok()
    }

    /// True if the text may be the name of an estimated coefficient.
    pub fn is_coefficient(text: &str) -> bool {
        matches!(Coefficient::of(Factor::Name(text)), Some(Coefficient::Fitted(_)))
            && !text.starts_with(|c: char| c.is_ascii_digit())
    }

    /// True if a coefficient is estimated by the fit.
    pub fn is_fitted(&self) -> bool {
        self.names().next().is_some()
    }

    /// Returns the names of the estimated coefficients.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        [&self.constant, &self.proportional].into_iter().filter_map(Coefficient::name)
    }

    /// Returns the coefficients before the first fit.
    pub(crate) fn at_start(&self, measured: &[f64]) -> [f64; 2] {
        let size = mean_size(measured);
        let of = |coefficient: &Coefficient, start| coefficient.stated().unwrap_or(start);
        [of(&self.constant, AT_START * size), of(&self.proportional, AT_START)]
    }

    /// Returns the standard deviations at measured values, which replace the simulated values before the
    /// first fit. If one is zero, the mean size of the measurements is used there.
    pub(crate) fn of_measured(&self, [a, b]: [f64; 2], measured: &[f64]) -> Vec<f64> {
        let size = mean_size(measured);
        let of = |y: &f64| match a + b * y.abs() {
            0.0 => b * size,
            sigma => sigma,
        };
        measured.iter().map(of).collect()
    }

    /// Estimates the coefficients from weighted residuals at fixed parameters.
    ///
    /// The estimate maximises `sum -(1 - h) ln sigma - d^2 / (2 sigma^2)` over `a, b >= 0`. Here d is a
    /// difference between simulation and measurement, and h is its leverage. Without leverages it is the
    /// likelihood of normal errors. With them, a constant sigma has the value `sqrt(sum d^2 / (N - sum h))`,
    /// as with restricted maximum likelihood (Davidian and Carroll, J. Am. Stat. Assoc. 82, 1987, section 3).
    pub(crate) fn estimate(&self, rows: &[FittedRow]) -> Option<[f64; 2]> {
        let n = rows.len() as f64;
        let size = rows.iter().map(|row| row.simulated.abs()).sum::<f64>() / n;
        let rms = (rows.iter().map(|row| row.difference.powi(2)).sum::<f64>() / n).sqrt();
        let free: f64 = rows.iter().map(|row| 1.0 - row.leverage).sum();
        // Negative logarithm of the likelihood.
        let cost = |[a, b]: [f64; 2]| -> f64 {
            let of = |row: &FittedRow| {
                let sigma = a + b * row.simulated.abs();
                (1.0 - row.leverage) * sigma.ln() + 0.5 * (row.difference / sigma).powi(2)
            };
            rows.iter().map(of).sum()
        };
        // The best multiple of a pair of coefficients has a closed form.
        let scaled = |[a, b]: [f64; 2]| {
            let of = |row: &FittedRow| (row.difference / (a + b * row.simulated.abs())).powi(2);
            let factor = (rows.iter().map(of).sum::<f64>() / free).sqrt();
            [factor * a, factor * b]
        };
        let found = match (self.constant.stated(), self.proportional.stated()) {
            (Some(a), Some(b)) => [a, b],
            (None, Some(0.0)) => scaled([1.0, 0.0]),
            (Some(0.0), None) => scaled([0.0, 1.0]),
            (None, None) => {
                let part = |t: f64| scaled([(1.0 - t) * size, t]);
                part(minimum(|t| cost(part(t))))
            }
            (a, b) => {
                // One coefficient is positive and stated. The other ranges from zero to infinity.
                let ratio = |t: f64| rms * t / (1.0 - t);
                let pair = |t: f64| [a.unwrap_or(ratio(t)), b.unwrap_or(ratio(t) / size)];
                pair(minimum(|t| cost(pair(t))))
            }
        };
        found.iter().all(|value| value.is_finite()).then_some(found)
    }
}

/// Measurement of a fit, for the estimate of an error model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FittedRow {
    pub(crate) simulated: f64,
    /// Simulated minus measured.
    pub(crate) difference: f64,
    pub(crate) leverage: f64,
}

fn mean_size(values: &[f64]) -> f64 {
    let sizes = || values.iter().filter(|value| !value.is_nan()).map(|value| value.abs());
    sizes().sum::<f64>() / sizes().count() as f64
}

/// Returns the position of the smallest value in `[0, 1)`: the best of a grid, then golden sections around
/// it. Values that are not finite are never the smallest.
fn minimum(f: impl Fn(f64) -> f64) -> f64 {
    const N: usize = 64;
    let f = |t: f64| Some(f(t)).filter(|value| value.is_finite()).unwrap_or(f64::INFINITY);
    let last = 1.0 - f64::EPSILON;
    let at = |k: usize| (k as f64 / N as f64).min(last);
    let best = (0..=N).min_by(|i, j| f(at(*i)).total_cmp(&f(at(*j)))).unwrap_or(0);
    let (mut low, mut high) = (at(best.saturating_sub(1)), at((best + 1).min(N)));
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..60 {
        let (left, right) = (high - golden * (high - low), low + golden * (high - low));
        if f(left) <= f(right) { high = right } else { low = left }
    }
    let ends = [at(best), 0.5 * (low + high)];
    ends.into_iter().min_by(|a, b| f(*a).total_cmp(&f(*b))).unwrap_or(0.0)
}

impl fmt::Display for ErrorModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.constant.stated(), self.proportional.stated()) {
            (_, Some(0.0)) => write!(f, "{}", self.constant),
            (Some(0.0), _) => write!(f, "{}*abs(y)", self.proportional),
            _ => write!(f, "{} + {}*abs(y)", self.constant, self.proportional),
        }
    }
}

impl FromStr for ErrorModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let invalid = || {
            format!(
                "'{text}' is not an error model. Write 'a + b*abs(y)' with a non-negative number or a name for each of a and b"
            )
        };
        let expression: Expression = text.parse().map_err(|_| invalid())?;
        let (mut constant, mut proportional) = (None, None);
        for term in expression.terms().ok_or_else(invalid)? {
            let is_y = |factor: &Factor<'_>| matches!(factor, Factor::Name("y") | Factor::Magnitude("y"));
            let (of_y, others): (Vec<Factor<'_>>, Vec<_>) = term.into_iter().partition(is_y);
            let place = if of_y.is_empty() { &mut constant } else { &mut proportional };
            let [coefficient] = others[..] else { return Err(invalid()) };
            let coefficient = Coefficient::of(coefficient).filter(|_| place.is_none() && of_y.len() < 2);
            *place = Some(coefficient.ok_or_else(invalid)?);
        }
        let zero = || Coefficient::Stated(0.0);
        let found = Self {
            constant: constant.unwrap_or_else(zero),
            proportional: proportional.clone().unwrap_or_else(zero),
        };
        let is_zero = [&found.constant, &found.proportional].iter().all(|term| term.stated() == Some(0.0));
        let has_same_names = found.constant.name().is_some_and(|a| found.proportional.name() == Some(a));
        // A name alone is a column.
        let is_column = proportional.is_none() && found.constant.stated().is_none();
        if is_zero || has_same_names || is_column { Err(invalid()) } else { Ok(found) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(text: &str) -> ErrorModel {
        text.parse().unwrap()
    }

    #[test]
    fn texts_of_error_models_are_read_and_written() {
        for (text, expected) in [
            ("0.1 + 0.05*abs(y)", "0.1 + 0.05*abs(y)"),
            ("0.05 * abs( y ) + 1e+2", "100 + 0.05*abs(y)"),
            ("1e-3+y*0.2", "0.001 + 0.2*abs(y)"),
            ("b*abs(y)", "b*abs(y)"),
            ("a+b_2*y", "a + b_2*abs(y)"),
            ("0.3", "0.3"),
        ] {
            assert_eq!(model(text).to_string(), expected);
            assert_eq!(model(expected), model(text));
        }
        assert_eq!(model("a + 0.1*y").names().collect::<Vec<_>>(), ["a"]);
        for text in [
            "a",
            "y",
            "T+U",
            "0",
            "0.1 - 0.2*abs(y)",
            "a + a*y",
            "1 + 2 + y*3",
            "abs(y)",
            "0.1 + b*abs(x)",
            "-1",
            "1+",
            "a*y*y",
            "a*b*y",
            "e*y",
            "a.b*y",
        ] {
            assert!(text.parse::<ErrorModel>().unwrap_err().contains("is not an error model"), "{text}");
        }
        assert!(ErrorModel::is_meant("a + abs(y)") && !ErrorModel::is_meant("sd_T"));
    }

    fn rows(noise: impl Fn(f64) -> f64) -> Vec<FittedRow> {
        let of = |k: u32| {
            let simulated = 10.0 * (-0.1 * f64::from(k)).exp();
            // Quantiles of the normal distribution, in an order without relation to the simulated values.
            let quantile = (f64::from(k * 37 % 101) + 0.5) / 101.0;
            let deviate = statrs::distribution::ContinuousCDF::inverse_cdf(
                &statrs::distribution::Normal::standard(),
                quantile,
            );
            FittedRow { simulated, difference: noise(simulated) * deviate, leverage: 0.0 }
        };
        (0..101).map(of).collect()
    }

    #[test]
    fn estimate_with_one_coefficient_has_its_closed_form() {
        let mut rows = rows(|y| 0.1 * y);
        for row in &mut rows {
            row.leverage = 0.02;
        }
        let free = 0.98 * 101.0;
        let relative: f64 = rows.iter().map(|row| (row.difference / row.simulated).powi(2)).sum();
        let [a, b] = model("b*abs(y)").estimate(&rows).unwrap();
        assert!(a == 0.0 && (b / (relative / free).sqrt() - 1.0).abs() < 1e-12, "{b}");
    }

    #[test]
    fn estimate_is_the_maximum_of_the_likelihood_and_near_the_true_values() {
        let rows = rows(|y| 0.2 + 0.1 * y);
        let cost = |[a, b]: [f64; 2]| -> f64 {
            let of = |row: &FittedRow| {
                let sigma = a + b * row.simulated;
                sigma.ln() + 0.5 * (row.difference / sigma).powi(2)
            };
            rows.iter().map(of).sum()
        };
        let found = model("a + b*abs(y)").estimate(&rows).unwrap();
        assert!((found[0] / 0.2).ln().abs() < 0.3 && (found[1] / 0.1).ln().abs() < 0.3, "{found:?}");
        for [a, b] in [[1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]] {
            assert!(cost([found[0] * (1.0 + a), found[1] * (1.0 + b)]) > cost(found));
        }
        let [a, b] = model("0.2 + b*abs(y)").estimate(&rows).unwrap();
        assert!(a == 0.2 && cost([a, b]) < cost([a, b * 1.001]) && cost([a, b]) < cost([a, b * 0.999]));
        let [a, b] = model("a + 0.1*abs(y)").estimate(&rows).unwrap();
        assert!(b == 0.1 && cost([a, b]) < cost([a * 1.001, b]) && cost([a, b]) < cost([a * 0.999, b]));
    }
}
