//! Checks of the residuals of each output: mean, autocorrelation, outliers, runs.

use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Origin, Severity};
use crate::findings::shown_text::digits;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::diagnostics::output_effect::OutputEffect;
use crate::uncertainty::p_values::{BY_CHANCE, OfIndependent, chance_of_outliers, distances};
use crate::uncertainty::row_blocks::go_on;
use base::RunContext;
use serde::{Deserialize, Serialize};

/// Residuals farther than this many robust standard deviations from their median are outliers, if that many
/// are no chance; else those beyond a larger number, of which a single one is none. Of fewer residuals
/// nothing is known of their distances.
const OUTLIER: f64 = 4.0;
const FEWEST_WITH_OUTLIERS: usize = 20;

/// Fewer outliers, in percent, change no parameter much.
const MANY_OUTLIERS: f64 = 0.2;

/// Autocorrelation above this makes standard errors too small that suppose independent residuals.
pub(crate) const CORRELATED: f64 = 0.3;

/// A mean, or a number of runs, that is farther off than this many standard deviations is no chance.
const DEVIATIONS: f64 = 4.0;

/// Residuals below this part of the size of the measurements are rounding.
const ROUNDING: f64 = 1e-10;

/// The residuals of one output of one experiment, times their weights. Recordings of an output whose weights
/// differ are looked at, and have their variances, apart: see [`Estimator`](crate::Estimator).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct ResidualCheck {
    /// The experiment.
    pub experiment: String,
    /// The variable of the model.
    pub variable: String,
    /// Number of residuals of the output.
    pub n: usize,
    /// Their mean.
    pub mean: f64,
    /// The error of the mean by the noise of measured initial states.
    #[serde(default)]
    pub mean_by_starts: f64,
    /// Their standard deviation around it.
    pub deviation: f64,
    /// Their autocorrelation at lag one; NaN for fewer than three, and where all are the same.
    pub autocorrelation: f64,
    /// The chance that independent residuals show an autocorrelation as large, after the fit (the exact
    /// distribution of von Neumann's ratio); None for more than 100 residuals, and where the fit leaves too
    /// few.
    #[serde(default)]
    pub chance: Option<f64>,
    /// The autocorrelation that is shown, without what the fit takes of it: see `chance`.
    #[serde(default)]
    pub autocorrelation_before_fit: Option<f64>,
    /// Number of residuals beyond [`outlier_limit`](Self::outlier_limit) robust standard deviations (by the
    /// median absolute deviation) from the median; none where there are fewer than 20.
    pub n_outliers: usize,
    /// Four where so many beyond it have a chance of less than one in a thousand with normally distributed
    /// residuals, else the number beyond which any has.
    #[serde(default)]
    pub outlier_limit: Option<f64>,
    /// Number of groups of neighbours that they form; as many as there are outliers where each is alone.
    #[serde(default)]
    pub n_outlier_groups: usize,
    /// Number of standard deviations by which the number of runs of one sign is above (below: negative) that
    /// of independent residuals (Wald and Wolfowitz, Ann. Math. Statist. 11, 1940); NaN where all have one
    /// sign.
    pub runs: f64,
    /// True if the residuals are rounding, below 1e-10 of the size of the measurements: there are no findings
    /// about them.
    #[serde(default)]
    pub is_rounding: bool,
    /// True if the residuals are autocorrelated, or have an offset, because the weights of other outputs keep
    /// the parameters from values that would leave none of that.
    #[serde(default)]
    pub is_by_weights: bool,
    /// One number of the measurements that would explain most of them, where they show something that lasts.
    #[serde(default)]
    pub unmodelled: Option<OutputEffect>,
}

impl ResidualCheck {
    /// Of all outputs; `independent`: the covariance that independent errors leave to the residuals of each,
    /// where it is known.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`].
    pub(crate) fn all(
        layout: &ResidualLayout,
        names: &[String],
        residuals: &[f64],
        independent: Option<&[OfIndependent]>,
        context: &RunContext<'_>,
    ) -> Result<Vec<Self>, CalibrationError> {
        let check = |(k, output): (usize, &OutputResiduals)| {
            go_on(context)?;
            let r = &residuals[output.range.clone()];
            let without_fit = independent.is_none().then(|| OfIndependent::without_fit(r.len()));
            let independent = without_fit.as_ref().or(independent.and_then(|all| all.get(k)));
            let own = Self {
                experiment: names[output.experiment].clone(),
                variable: output.variable.clone(),
                n: 0,
                mean: 0.0,
                mean_by_starts: 0.0,
                deviation: 0.0,
                autocorrelation: 0.0,
                chance: None,
                autocorrelation_before_fit: None,
                outlier_limit: None,
                n_outliers: 0,
                n_outlier_groups: 0,
                runs: 0.0,
                is_rounding: is_rounding(output, r),
                is_by_weights: false,
                unmodelled: None,
            };
            Ok(own.with_numbers_of(r, independent))
        };
        layout.outputs.iter().enumerate().map(check).collect()
    }

    /// Findings about the residuals of all outputs, with the experiment where there are several. `has_loss`:
    /// the cost counts outliers less; `has_errors`: there are standard errors, too.
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
        let mut said = Vec::new();
        if self.is_rounding {
            return said;
        }
        let subject = format!("residuals of {name}");
        let mut find = |severity, sentence: String, remedy: &str| {
            said.push(Finding::new(severity, subject.clone(), format!("the {subject} {sentence}"), remedy));
        };
        let lag = format!("are autocorrelated ({:.2} at lag one)", self.size_of_autocorrelation());
        if self.is_by_weights {
            let how =
                if self.is_autocorrelated() { lag } else { "have an offset or keep their sign".to_owned() };
            find(
                Severity::Warning,
                format!(
                    "{how}, but other values of the parameters leave none of that: the weights of the other outputs keep them away"
                ),
                "give each output a weight of 1 over its noise (weights=\"sd\" where that is not known)",
            );
        } else {
            let what = "the model leaves out something that lasts, or the noise lasts";
            let remedy = match self.unmodelled {
                None => {
                    "plot the residuals; search=\"global\" tells whether values far from these leave none of that"
                }
                Some(_) => "",
            };
            if self.is_autocorrelated() {
                let corrected = match has_errors {
                    true => ": standard errors are corrected for that, the values of the parameters are not",
                    false => "",
                };
                find(Severity::Warning, format!("{lag}: {what}{corrected}"), remedy);
            } else if self.keeps_sign() {
                let sentence = "keep their sign longer than independent ones would";
                find(Severity::Warning, format!("{sentence}: {what}"), remedy);
            }
            if self.has_offset() {
                let mean = digits(self.mean);
                find(
                    Severity::Warning,
                    format!("have the mean {mean}: simulated minus measured, an offset"),
                    "a Parameter with offset_of fits it, where it is one of the sensor",
                );
            }
        }
        if let Some(unmodelled) = self.unmodelled {
            let (what, remedy) = (unmodelled.words(), unmodelled.kind.remedy());
            let sentence = format!(
                "{what} would take away {:.1} % of the squares of the {subject}",
                100.0 * (1.0 - unmodelled.left)
            );
            said.push(Finding::warning(subject.clone(), sentence, remedy));
        }
        let share = 100.0 * self.n_outliers as f64 / self.n as f64;
        // Those of a systematic misfit are said already.
        if share > MANY_OUTLIERS && !(self.are_outliers_together() && self.is_systematic()) {
            let (severity, what, remedy) = match (self.are_outliers_together(), has_loss) {
                (true, _) => (
                    Severity::Warning,
                    ", most of them beside each other: the model does not follow these measurements",
                    "look at what happens there, in the recording and in the model",
                ),
                (false, true) => (Severity::Note, ": outliers, which the robust loss counts less", ""),
                (false, false) if self.is_autocorrelated() => (Severity::Warning, ": outliers", ""),
                (false, false) => (Severity::Warning, ": outliers", "a robust loss counts them less"),
            };
            let sentence = format!(
                "{} of {} {subject} ({share:.1} %) lie beyond {} robust standard deviations{what}",
                self.n_outliers,
                self.n,
                digits(self.outlier_limit.unwrap_or(OUTLIER)),
            );
            said.push(Finding::new(severity, subject, sentence, remedy));
        }
        said
    }

    /// True if most outliers have another one beside them: of independent residuals few have.
    fn are_outliers_together(&self) -> bool {
        2 * self.n_outlier_groups <= self.n_outliers
    }

    fn keeps_sign(&self) -> bool {
        self.runs < -DEVIATIONS
    }

    fn has_offset(&self) -> bool {
        let of_mean = (self.deviation / (self.n as f64).sqrt()).hypot(self.mean_by_starts);
        self.mean.abs() > DEVIATIONS * of_mean && self.mean.abs() > 0.1 * self.deviation && self.n > 2
    }

    /// True if the residuals are systematic: autocorrelated, with long runs of one sign, or with an offset.
    pub(crate) fn is_systematic(&self) -> bool {
        !self.is_rounding && (self.is_autocorrelated() || self.keeps_sign() || self.has_offset())
    }

    /// The same with the numbers of other residuals.
    pub(crate) fn with_numbers_of(self, r: &[f64], independent: Option<&OfIndependent>) -> Self {
        let (mean, deviation) = mean_and_deviation(r);
        let (outlier_limit, n_outliers, n_outlier_groups) = outliers(r);
        let (chance, shown) = independent.and_then(|own| own.autocorrelation(r)).unzip();
        Self {
            chance,
            autocorrelation_before_fit: shown,
            outlier_limit,
            n: r.len(),
            mean,
            deviation,
            autocorrelation: autocorrelation(r),
            n_outliers,
            n_outlier_groups,
            runs: runs(r),
            ..self
        }
    }

    /// The autocorrelation at lag one, without what the fit takes of it where that is known.
    fn size_of_autocorrelation(&self) -> f64 {
        self.autocorrelation_before_fit.unwrap_or(self.autocorrelation)
    }

    pub(crate) fn is_autocorrelated(&self) -> bool {
        // Of n independent residuals it has the standard deviation 1 / sqrt(n).
        let is_no_chance = match self.chance {
            None => self.autocorrelation > 3.0 / (self.n as f64).sqrt(),
            Some(chance) => chance < BY_CHANCE,
        };
        !self.is_rounding && is_no_chance && self.size_of_autocorrelation() > CORRELATED
    }
}

/// True if the residuals `r` of an output are rounding of its measurements.
pub(crate) fn is_rounding(output: &OutputResiduals, r: &[f64]) -> bool {
    r.iter().map(|r| r * r).sum::<f64>() <= square_of_rounding(output)
}

/// The sum of squares below which the residuals of an output are rounding.
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

/// At lag one: `sum (r_i - mean) (r_(i+1) - mean) / sum (r_i - mean)^2`.
pub(crate) fn autocorrelation(r: &[f64]) -> f64 {
    if r.len() < 3 {
        return f64::NAN;
    }
    let (mean, _) = mean_and_deviation(r);
    let products: f64 = r.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean)).sum();
    products / r.iter().map(|r| (r - mean) * (r - mean)).sum::<f64>()
}

/// Beyond how many robust standard deviations residuals are outliers, the number of outliers, and of the
/// groups of neighbours that they form.
fn outliers(r: &[f64]) -> (Option<f64>, usize, usize) {
    let n = r.len();
    let distances = distances(r);
    if n < FEWEST_WITH_OUTLIERS || !distances.iter().all(|distance| distance.is_finite()) {
        return (None, 0, 0);
    }
    let is_no_chance =
        |limit: f64, count: usize| count > 0 && chance_of_outliers(n, limit, count) < 0.5 * BY_CHANCE;
    let beyond = |limit: f64| distances.iter().filter(|distance| **distance > limit).count();
    let limit = match is_no_chance(OUTLIER, beyond(OUTLIER)) {
        true => OUTLIER,
        false => {
            let (mut low, mut high) = (OUTLIER, distances.iter().copied().fold(OUTLIER, f64::max));
            if !is_no_chance(high, 1) {
                return (Some(OUTLIER), 0, 0);
            }
            // To the two digits that are shown.
            while high - low > 0.01 * low {
                let middle = 0.5 * (low + high);
                if is_no_chance(middle, 1) { high = middle } else { low = middle }
            }
            high
        }
    };
    let is_outlier = |distance: &f64| *distance >= limit;
    let groups =
        distances.chunk_by(|a, b| is_outlier(a) == is_outlier(b)).filter(|group| is_outlier(&group[0]));
    let (n, n_groups) = groups.fold((0, 0), |(n, n_groups), group| (n + group.len(), n_groups + 1));
    (Some(limit), n, n_groups)
}

fn runs(r: &[f64]) -> f64 {
    let signs: Vec<bool> = r.iter().filter(|r| **r != 0.0).map(|r| *r > 0.0).collect();
    let positive = signs.iter().filter(|s| **s).count() as f64;
    let (n, negative) = (signs.len() as f64, signs.len() as f64 - positive);
    let product = 2.0 * positive * negative;
    let expected = product / n + 1.0;
    let variance = product * (product - n) / (n * n * (n - 1.0));
    let found = 1.0 + signs.windows(2).filter(|pair| pair[0] != pair[1]).count() as f64;
    if variance > 0.0 { (found - expected) / variance.sqrt() } else { f64::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textbook_numbers() {
        assert!(autocorrelation(&[1.0, 2.0]).is_nan());
        assert!((autocorrelation(&[1.0, -1.0, 1.0, -1.0]) + 0.75).abs() < 1e-15);
        assert!((autocorrelation(&[-2.0, -1.0, 0.0, 1.0, 2.0]) - 0.4).abs() < 1e-15);
        let mut r: Vec<f64> = (0..99).map(|k| f64::from(k % 7) - 3.0).collect();
        let number = |r: &[f64]| (outliers(r).1, outliers(r).2);
        assert_eq!(number(&r), (0, 0));
        r[5] = 100.0;
        assert_eq!((number(&r), number(&[1.0; 5])), ((1, 1), (0, 0)));
        // One beyond four standard deviations is nothing among few, several are.
        r[5] = 12.0;
        assert_eq!(number(&r[..25]), (0, 0));
        r[20..24].fill(-100.0);
        assert_eq!(number(&r), (5, 2));
        // 6 positive and 4 negative in 2 runs: expected 5.8, variance 48 (48 - 10) / 900.
        let two = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0];
        assert!((runs(&two) - (2.0 - 5.8) / (48.0f64 * 38.0 / 900.0).sqrt()).abs() < 1e-14);
        assert!(runs(&[1.0, 1.0, 1.0]).is_nan());
    }

    /// 400 residuals with the mean 0.3 and the deviation 1: 6 of its standard errors, but 1.5 of those of a
    /// simulation that starts from a measurement.
    #[test]
    fn noise_of_a_measured_start_is_no_offset() {
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
        };
        let layout = ResidualLayout { outputs: vec![output], priors: Vec::new() };
        let checks = ResidualCheck::all(&layout, &["a".to_owned()], &r, None, &RunContext::new());
        let mut check = checks.unwrap().remove(0);
        assert!(check.has_offset());
        check.mean_by_starts = 0.2;
        assert!(!check.has_offset());
    }
}
