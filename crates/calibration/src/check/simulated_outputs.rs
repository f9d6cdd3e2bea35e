//! Measured and simulated outputs of a calibration at given values of the parameters.

use super::experiment_subject::ExperimentSubject;
use crate::cost::residual::PointResiduals;
use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::OutputResiduals;
use base::RunContext;
use ode::Stats;
use std::fmt;

/// Number and cost of the evaluations.
pub(super) struct Evaluations<'a> {
    pub(super) context: RunContext<'a>,
    pub(super) n: usize,
    pub(super) stats: Stats,
}

/// Point at which the problem is checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Place {
    Start,
    Fitted,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "at the start values",
            Self::Fitted => "at the fitted values",
        })
    }
}

/// Output with its measured and simulated values.
pub(super) struct Series<'a> {
    pub(super) of: &'a OutputResiduals,
    pub(super) simulated: Vec<f64>,
}

/// Outputs of all experiments at the start, and at the result of a fit if there is one.
pub(super) struct Outputs<'a> {
    pub(super) at_start: Vec<Series<'a>>,
    pub(super) fitted: Option<Vec<Series<'a>>>,
    x: (&'a [f64], Option<&'a [f64]>),
}

impl<'a> Outputs<'a> {
    pub(super) fn new(
        calibration: &'a Calibration,
        at_start: &'a PointResiduals,
        fitted: Option<&'a PointResiduals>,
    ) -> Self {
        let series = |of: &PointResiduals| all_series(calibration, &of.residuals);
        let x = (at_start.x.as_slice(), fitted.map(|fitted| fitted.x.as_slice()));
        Self { at_start: series(at_start), fitted: fitted.map(series), x }
    }

    /// Returns the outputs at the result if there is one, otherwise at the start.
    pub(super) fn last(&self) -> &[Series<'a>] {
        self.fitted.as_ref().unwrap_or(&self.at_start)
    }

    pub(super) fn place(&self) -> Place {
        if self.fitted.is_some() { Place::Fitted } else { Place::Start }
    }

    /// True if there is no fit, or if the fit moved a parameter far enough to compensate for a factor in the
    /// data. The parameter must have changed sign, left or reached zero, or changed by at least half of the
    /// factor on a logarithmic scale.
    pub(super) fn may_have_taken(&self, factor: f64) -> bool {
        let (start, Some(x)) = self.x else { return true };
        let has = |(from, to): (&f64, &f64)| {
            from != to && (from * to <= 0.0 || (to / from).ln().abs() >= 0.5 * factor.ln().abs())
        };
        start.iter().zip(x).any(has)
    }
}

pub(super) fn all_series<'a>(calibration: &'a Calibration, residuals: &[f64]) -> Vec<Series<'a>> {
    // The checks compare values, not logarithms.
    let outputs = calibration.residual_layout().outputs.iter().filter(|of| !of.is_log);
    outputs.map(|of| Series { of, simulated: of.simulated_values(residuals) }).collect()
}

impl Series<'_> {
    pub(super) fn name(&self, subject: &ExperimentSubject<'_>) -> String {
        format!("{}output '{}' (column '{}')", subject.prefix, self.of.variable, self.of.column)
    }
}

pub(super) fn range(values: &[f64]) -> f64 {
    let (low, high) =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    high - low
}

/// Returns the root of the mean square.
pub(super) fn size(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

pub(super) fn size_of_difference(measured: &[f64], simulated: impl Iterator<Item = f64>) -> f64 {
    let differences: Vec<f64> = measured.iter().zip(simulated).map(|(m, s)| m - s).collect();
    size(differences.into_iter())
}

/// Rounds a number to three digits.
pub(super) fn rounded(value: f64) -> f64 {
    with_digits(3, value)
}

/// Rounds a time to the number of digits needed to distinguish rows.
pub(super) fn rounded_time(value: f64) -> f64 {
    with_digits(9, value)
}

fn with_digits(digits: i32, value: f64) -> f64 {
    if value == 0.0 {
        return value;
    }
    let exponent = digits - 1 - value.abs().log10().floor() as i32;
    // A power of ten with a negative exponent is not exact.
    let ten = 10f64.powi(exponent.abs());
    let rounded = if exponent >= 0 { (value * ten).round() / ten } else { (value / ten).round() * ten };
    if rounded.is_finite() { rounded } else { value }
}
