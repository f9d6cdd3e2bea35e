//! Checks of the residuals of each output: mean, autocorrelation, outliers.

use crate::error::CalibrationError;
use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, Origin, Severity};
use crate::findings::identifier::FindingId;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::robust::distances;
use crate::uncertainty::row_blocks::go_on;
use base::RunContext;
use serde::{Deserialize, Serialize};

/// Distance from the median in robust standard deviations above which a residual is an outlier. With normally
/// distributed residuals, 0.4 % of series of 20 contain outliers, and fewer of longer series. For shorter
/// series, the distances are unreliable.
const OUTLIER: f64 = 6.0;
const FEWEST_WITH_OUTLIERS: usize = 20;

/// Percentage of outliers below which they hardly change any parameter.
const MANY_OUTLIERS: f64 = 0.2;

/// Autocorrelation above which standard errors under the assumption of independent residuals are too small.
const CORRELATED: f64 = 0.3;

/// Distance of the mean from zero, in standard deviations, above which it is significant.
const DEVIATIONS: f64 = 4.0;

/// Size relative to the measurements below which residuals are rounding errors.
const ROUNDING: f64 = 1e-10;

/// Weighted residuals of one output of one experiment. Recordings of an output with different weights are
/// checked separately and have separate variances: see [`Estimator`](crate::Estimator).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct ResidualCheck {
    /// Name of the experiment.
    pub experiment: String,
    /// Variable of the model.
    pub variable: String,
    /// Number of residuals of the output.
    pub n: usize,
    /// Mean of the residuals.
    pub mean: f64,
    /// Error of the mean caused by the noise of measured initial states.
    #[serde(default)]
    pub mean_by_starts: f64,
    /// Standard deviation around the mean.
    pub deviation: f64,
    /// Autocorrelation at lag one; NaN for fewer than three residuals, and if all are equal.
    pub autocorrelation: f64,
    /// Number of residuals beyond six robust standard deviations (from the median absolute deviation) from
    /// the median; 0 for fewer than 20 residuals.
    pub n_outliers: usize,
    /// Number of groups of neighbouring outliers; equal to the number of outliers if all are isolated.
    #[serde(default)]
    pub n_outlier_groups: usize,
    /// True if the residuals are rounding errors, below 1e-10 of the size of the measurements. No findings
    /// are reported then.
    #[serde(default)]
    pub is_rounding: bool,
}

impl ResidualCheck {
    /// Checks the residuals of all outputs.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Cancelled`] if the context has ended.
    pub(crate) fn all(
        layout: &ResidualLayout,
        names: &[String],
        residuals: &[f64],
        context: &RunContext<'_>,
    ) -> Result<Vec<Self>, CalibrationError> {
        let check = |output: &OutputResiduals| {
            go_on(context)?;
            let r = &residuals[output.range.clone()];
            let (mean, deviation) = mean_and_deviation(r);
            let (n_outliers, n_outlier_groups) = outliers(r);
            Ok(Self {
                experiment: names[output.experiment].clone(),
                variable: output.variable.clone(),
                n: r.len(),
                mean,
                mean_by_starts: 0.0,
                deviation,
                autocorrelation: autocorrelation(r),
                n_outliers,
                n_outlier_groups,
                is_rounding: is_rounding(output, r),
            })
        };
        layout.outputs.iter().map(check).collect()
    }

    /// Returns findings about the residuals of all outputs, with the experiment if there are several. Set
    /// `has_loss` if the cost reduces the influence of outliers, and `has_errors` if standard errors are
    /// available.
    pub(crate) fn all_findings(checks: &[Self], has_loss: bool, has_errors: bool) -> Vec<Finding> {
        let are_several = checks.iter().any(|check| check.experiment != checks[0].experiment);
        let of = |check: &Self| {
            let name = match are_several {
                true => format!("{} of {}", check.variable, check.experiment),
                false => check.variable.clone(),
            };
            check.findings(&name, has_loss, has_errors)
        };
        checks.iter().flat_map(of).map(|finding| finding.of(Origin::Residuals)).collect()
    }

    fn findings(&self, name: &str, has_loss: bool, has_errors: bool) -> Vec<Finding> {
        let mut reported = Vec::new();
        if self.is_rounding {
            return reported;
        }
        let subject = format!("residuals of {name}");
        let mut warn = |id, sentence: String, remedy: &str| {
            reported.push(Finding::warning(id, subject.clone(), format!("the {subject} {sentence}"), remedy));
        };
        if self.is_autocorrelated() {
            let corrected = match has_errors {
                true => ". Standard errors are corrected for this, but the values of the parameters are not",
                false => "",
            };
            warn(
                FindingId::AutocorrelatedResiduals,
                format!(
                    "are autocorrelated ({:.2} at lag one): the model lacks an effect, or the noise is slow{corrected}",
                    self.autocorrelation
                ),
                "Plot the residuals. Check the initial states, and inputs that switch between rows; then try search=\"global\"",
            );
        }
        if self.has_offset() {
            let size = match self.deviation {
                0.0 => "are constant".to_owned(),
                deviation => format!("have a mean of {} standard deviations", digits(self.mean / deviation)),
            };
            warn(
                FindingId::ResidualOffset,
                format!(
                    "{size} (simulated minus measured). Parameters that compensate for such an offset \
                     are wrong"
                ),
                "Check the zero of the sensor, and fit its offset with a parameter that has offset_of",
            );
        }
        let share = 100.0 * self.n_outliers as f64 / self.n as f64;
        // Outliers of a systematic misfit are covered by the findings above.
        if share > MANY_OUTLIERS && !(self.are_outliers_together() && self.is_systematic()) {
            let (severity, what, remedy) = match (self.are_outliers_together(), has_loss) {
                (true, _) => (
                    Severity::Warning,
                    ", most of them next to each other. The model does not follow these measurements",
                    "Check what happens there, in the recording and in the model",
                ),
                (false, true) => {
                    (Severity::Note, ". The robust loss reduces the influence of these outliers", "")
                }
                (false, false) if self.is_autocorrelated() => {
                    (Severity::Warning, ". Such outliers affect the parameters", "Check these measurements")
                }
                (false, false) => (
                    Severity::Warning,
                    ". Such outliers affect the parameters",
                    "Check these measurements, or use a robust loss",
                ),
            };
            let sentence = format!(
                "{} of {} {subject} ({share:.1} %) lie beyond {OUTLIER} robust standard deviations{what}",
                self.n_outliers, self.n,
            );
            reported.push(Finding::new(severity, FindingId::Outliers, subject, sentence, remedy));
        }
        reported
    }

    /// True if most outliers are next to another one, which is rare for independent residuals.
    fn are_outliers_together(&self) -> bool {
        2 * self.n_outlier_groups <= self.n_outliers
    }

    fn has_offset(&self) -> bool {
        let of_mean = (self.deviation / (self.n as f64).sqrt()).hypot(self.mean_by_starts);
        self.mean.abs() > DEVIATIONS * of_mean && self.mean.abs() > 0.1 * self.deviation && self.n > 2
    }

    /// True if the residuals are systematic: autocorrelated or with an offset.
    fn is_systematic(&self) -> bool {
        !self.is_rounding && (self.is_autocorrelated() || self.has_offset())
    }

    /// True if the autocorrelation is large enough to matter and exceeds three standard deviations of
    /// independent residuals, `1 / sqrt(n)`. A fit removes some autocorrelation, so false alarms are rare.
    fn is_autocorrelated(&self) -> bool {
        let is_no_chance = self.autocorrelation > 3.0 / (self.n as f64).sqrt();
        !self.is_rounding && is_no_chance && self.autocorrelation > CORRELATED
    }
}

/// True if the residuals `r` of an output are rounding errors of its measurements.
pub(crate) fn is_rounding(output: &OutputResiduals, r: &[f64]) -> bool {
    r.iter().map(|r| r * r).sum::<f64>() <= square_of_rounding(output)
}

/// Returns the sum of squares below which the residuals of an output are rounding errors.
pub(crate) fn square_of_rounding(output: &OutputResiduals) -> f64 {
    let measured: f64 = output.measured.iter().zip(&output.weights).map(|(y, w)| (y * w) * (y * w)).sum();
    ROUNDING * ROUNDING * measured
}

fn mean_and_deviation(r: &[f64]) -> (f64, f64) {
    let n = r.len() as f64;
    let mean = r.iter().sum::<f64>() / n;
    let sum: f64 = r.iter().map(|r| (r - mean) * (r - mean)).sum();
    (mean, (sum / (n - 1.0).max(1.0)).sqrt())
}

/// Returns the autocorrelation at lag one: `sum (r_i - mean) (r_(i+1) - mean) / sum (r_i - mean)^2`.
pub(crate) fn autocorrelation(r: &[f64]) -> f64 {
    if r.len() < 3 {
        return f64::NAN;
    }
    let (mean, _) = mean_and_deviation(r);
    let products: f64 = r.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean)).sum();
    products / r.iter().map(|r| (r - mean) * (r - mean)).sum::<f64>()
}

/// Returns the number of outliers and the number of groups of neighbouring outliers.
fn outliers(r: &[f64]) -> (usize, usize) {
    let distances = distances(r);
    if r.len() < FEWEST_WITH_OUTLIERS || !distances.iter().all(|distance| distance.is_finite()) {
        return (0, 0);
    }
    let is_outlier = |distance: &f64| *distance > OUTLIER;
    let groups =
        distances.chunk_by(|a, b| is_outlier(a) == is_outlier(b)).filter(|group| is_outlier(&group[0]));
    groups.fold((0, 0), |(n, n_groups), group| (n + group.len(), n_groups + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uncertainty::robust::normal_numbers;

    #[test]
    fn autocorrelation_and_outliers_match_textbook_values() {
        assert!(autocorrelation(&[1.0, 2.0]).is_nan());
        assert!((autocorrelation(&[1.0, -1.0, 1.0, -1.0]) + 0.75).abs() < 1e-15);
        assert!((autocorrelation(&[-2.0, -1.0, 0.0, 1.0, 2.0]) - 0.4).abs() < 1e-15);
        let mut r: Vec<f64> = (0..99).map(|k| f64::from(k % 7) - 3.0).collect();
        assert_eq!(outliers(&r), (0, 0));
        r[5] = 100.0;
        assert_eq!((outliers(&r), outliers(&[1.0; 5])), ((1, 1), (0, 0)));
        r[20..24].fill(-100.0);
        assert_eq!(outliers(&r), (5, 2));
    }

    #[test]
    fn normal_residuals_rarely_have_outliers() {
        let mut state = 2;
        for n in [20, 25, 60, 100, 500] {
            let with = (0..4000).filter(|_| outliers(&normal_numbers(n, &mut state)).0 > 0).count();
            assert!(with < 40, "{n}: {with} of 4000");
        }
    }

    /// 400 residuals with mean 0.3 and deviation 1. The mean is 6 of its standard errors, but only 1.5
    /// standard errors of a simulation that starts from a measurement.
    #[test]
    fn noise_of_measured_start_is_not_reported_as_offset() {
        let r: Vec<f64> = (0..400).map(|k| 0.3 + f64::from(k % 2) * 2.0 - 1.0).collect();
        let output = OutputResiduals {
            experiment: 0,
            output: 0,
            variable: "x".to_owned(),
            column: "x".to_owned(),
            range: 0..400,
            times: (0..400).map(f64::from).collect(),
            measured: vec![1.0; 400].into(),
            weights: vec![1.0; 400].into(),
            starts_simulation: false,
            is_noise_known: false,
            is_log: false,
        };
        let layout = ResidualLayout { outputs: vec![output], ..ResidualLayout::default() };
        let checks = ResidualCheck::all(&layout, &["a".to_owned()], &r, &RunContext::new());
        let mut check = checks.unwrap().remove(0);
        assert!(check.has_offset());
        check.mean_by_starts = 0.2;
        assert!(!check.has_offset());
    }
}
