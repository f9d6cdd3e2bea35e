//! Noise of the measurements, either stated by their weights or estimated with the parameters.
//!
//! A prior is measured in units of its standard deviation, so the measurements must be in units of their
//! standard deviations. If their weights do not define these units, the fit alternates with estimates of the
//! noise.

use super::modelled_noise::{FEWEST, ModelledNoise, SigmaSeries, rows_of, weight};
use crate::error::CalibrationError;
use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, Severity};
use crate::findings::identifier::FindingId;
use crate::loaded::calibration::Calibration;
use crate::problem::definition::Problem;
use crate::problem::error_model::{Coefficient, ErrorModel};
use crate::problem::experiment::{Sigma, Weight};
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::robust::{MEDIAN_DEVIATION, median};
use crate::uncertainty::row_blocks::{ThinSvd, thin_svd};
use base::RunContext;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::fmt;

/// Source of the noise of the measurements, see [`FitOptions::noise`](crate::FitOptions::noise).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum NoiseRule {
    /// Acts as [`Estimated`](Self::Estimated) for outputs whose weights do not state the noise (weights of 1
    /// or inverse scales). This applies to fits of the sum of squares with priors and without a robust loss.
    /// In all other cases, acts as [`Stated`](Self::Stated).
    #[default]
    Auto,
    /// Weights are 1 over the known standard deviation of the noise, including weights of 1. Standard errors
    /// are absolute for the sum of squares without a robust loss.
    Stated,
    /// Estimates the noise of all outputs. Weights are relative: the standard deviation of a measurement is
    /// the standard deviation of its output divided by its weight. The fit minimises the sum of squares
    /// without a robust loss, with or without priors.
    Estimated,
}

/// Source of the noise of the measurements in a fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum FitNoise {
    /// The noise of all outputs is known, from [`Weight::Sigma`] or [`NoiseRule::Stated`]. Standard errors,
    /// intervals, profiles and bands are absolute.
    Known,
    /// Weights state the noise relative to the priors: each is 1 over the standard deviation. Standard errors
    /// use the size of the residuals.
    Stated,
    /// The noise was estimated. The weights of the fit are then divided by the estimates. They apply to its
    /// cost, residuals, derivatives and covariance.
    Estimated(EstimatedNoise),
}

impl FitNoise {
    /// Returns the estimates, if there are any.
    pub fn estimated(&self) -> Option<&EstimatedNoise> {
        match self {
            Self::Known | Self::Stated => None,
            Self::Estimated(estimated) => Some(estimated),
        }
    }

    /// True if the noise of all outputs is known, so that standard errors are absolute.
    pub fn is_known(&self) -> bool {
        *self == Self::Known || self.estimated().is_some_and(|noise| noise.is_known)
    }

    /// Returns the outputs with an error model; empty if there are none.
    pub fn models(&self) -> &[ModelledNoise] {
        self.estimated().map_or(&[], |noise| &noise.models)
    }
}

/// Describes the source and the size of the noise.
impl fmt::Display for FitNoise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Estimated(EstimatedNoise { outputs, models, n_rounds, .. }) = self else {
            return f.write_str(match self {
                Self::Known => "known (sigma)",
                _ => "stated by the weights (1 over its standard deviation)",
            });
        };
        let rounds = if *n_rounds == 1 { "round" } else { "rounds" };
        let is_estimated = !outputs.is_empty() || models.iter().any(|noise| noise.model.is_fitted());
        let source = if is_estimated { "estimated with the parameters" } else { "known (sigma)" };
        write!(f, "{source} in {n_rounds} {rounds}")?;
        for (k, OutputNoise { variable, sd, .. }) in outputs.iter().enumerate() {
            write!(f, ", {}{variable} {}", if k == 0 { "standard deviation " } else { "" }, digits(*sd))?;
        }
        for noise in models {
            write!(f, ", sigma of {} {}", noise.variable, noise.model)?;
            for (name, value) in noise.coefficients() {
                write!(f, ", {name} = {}", digits(value))?;
            }
            if !noise.is_of_residuals {
                f.write_str(" (not estimated)")?;
            }
        }
        Ok(())
    }
}

/// Noise of the measurements, estimated with the parameters of a fit.
///
/// The first estimate uses the differences between neighbouring measurements. It is the median size of `y_i`
/// minus the line through its two neighbours, or minus the cubic through four neighbours. The smaller result
/// is used because it contains less of the signal (pseudo-residuals: Gasser, Sroka and Jennen-Steinmetz,
/// Biometrika 73, 1986).
///
/// Each fit then uses the weights divided by the last estimate, and its residuals determine the next
/// estimate. The sum of the squares of the N residuals of an output is set to `s^2 (N - h)`. Here h is the
/// sum of the diagonal of `J (J'J)^-1 J'` over these residuals, and J includes the rows of the priors
/// (evidence equation: MacKay, Neural Computation 4, 1992, page 426). The fits end when no estimate changes
/// by more than 1 %.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct EstimatedNoise {
    /// Noise of each variable of the model, over all of its recordings, in the order of the residual vector.
    pub outputs: Vec<OutputNoise>,
    /// Outputs whose noise depends on the simulated values.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub models: Vec<ModelledNoise>,
    /// True if the noise of all outputs is known: nothing is estimated, and the fits only follow the
    /// simulated values.
    #[serde(default)]
    pub is_known: bool,
    /// Number of fits.
    pub n_rounds: usize,
    /// True if the residuals of the last fit confirm its noise: estimates to 1 %, error models to 0.01 %, and
    /// to 0.1 % with estimated coefficients.
    pub is_settled: bool,
    /// True if the noise of all outputs is estimated. False if the weights of some outputs already specify
    /// it.
    pub is_of_all: bool,
}

/// Noise of one variable of the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct OutputNoise {
    /// Name of the variable.
    pub variable: String,
    /// Standard deviation of a measurement in the unit of the variable. With weights other than inverse
    /// scales, it is the standard deviation times the weight of the measurement.
    pub sd: f64,
    /// True if the noise was estimated from the residuals. Otherwise it was estimated from the differences
    /// between neighbouring measurements, because there are too few residuals or the search was interrupted.
    pub is_of_residuals: bool,
}

/// Estimates that differ by less than this fraction are considered equal.
const SETTLED: f64 = 0.01;

/// Maximum number of fits. A prior with the same weight as the measurements requires about five.
pub(super) const MOST_ROUNDS: usize = 10;

impl EstimatedNoise {
    /// Returns the first estimate, from the differences between neighbouring measurements, and the error
    /// models at the measured values. Without `estimates`, there are only error models. Returns `None` if the
    /// noise does not change between fits.
    pub(super) fn first(
        calibration: &Calibration,
        rule: NoiseRule,
        estimates: bool,
    ) -> Result<Option<Self>, CalibrationError> {
        let layout = calibration.residual_layout();
        let states_noise =
            |output: &OutputResiduals| match weight(calibration.problem(), output).error_model() {
                Some(model) => !model.is_fitted(),
                None => output.is_noise_known || rule == NoiseRule::Stated,
            };
        let mut noise = Self {
            outputs: Vec::new(),
            models: Vec::new(),
            is_known: layout.outputs.iter().all(states_noise),
            n_rounds: 0,
            is_settled: false,
            is_of_all: rule == NoiseRule::Estimated,
        };
        let problem = calibration.problem();
        for output in &layout.outputs {
            if let Some(model) = weight(problem, output).error_model()
                && !noise.models.iter().any(|estimated| estimated.is_of(problem, output))
            {
                noise.models.push(ModelledNoise::first(calibration, &output.variable, model)?);
            }
        }
        for output in layout.outputs.iter().filter(|_| estimates) {
            let has_estimate = noise.outputs.iter().any(|estimated| estimated.variable == output.variable);
            if has_estimate || !noise.is_of(problem, output) {
                continue;
            }
            let same = || layout.outputs.iter().filter(|o| o.variable == output.variable);
            let same = || same().filter(|o| noise.is_of(problem, o));
            let weighted = |o: &OutputResiduals| -> Vec<f64> {
                o.measured.iter().enumerate().map(|(k, y)| y * base(problem, o, k)).collect()
            };
            let distances = |n| same().flat_map(|o| pseudo_residuals(problem, o, n)).collect::<Vec<f64>>();
            let size = root_mean_square(&same().flat_map(weighted).collect::<Vec<f64>>());
            let spread = root_mean_square(&same().flat_map(|o| centered(&weighted(o))).collect::<Vec<f64>>());
            let whole = root_mean_square(&distances(1));
            // The remaining signal increases both estimates, so the smaller one is used.
            let of = |n| median(&mut distances(n)) / MEDIAN_DEVIATION;
            let found = of(1).min(of(2));
            let least = calibration.relative_tolerance() * size;
            // The median is zero for a constant signal with jumps. A single value does not determine an estimate.
            let sd = [found, whole, spread, size].into_iter().find(|sd| *sd > least && sd.is_finite());
            let sd = sd.unwrap_or(if least > 0.0 { least } else { 1.0 });
            noise.outputs.push(OutputNoise { variable: output.variable.clone(), sd, is_of_residuals: false });
        }
        let is_fixed = noise.outputs.is_empty() && noise.models.is_empty();
        Ok((!is_fixed).then_some(noise))
    }

    /// True if a part of the noise is estimated from residuals.
    pub(super) fn needs_leverages(&self) -> bool {
        !self.outputs.is_empty() || self.models.iter().any(|noise| noise.model.is_fitted())
    }

    /// Returns the next estimate from the residuals of a fit with this estimate and their [`leverages`].
    ///
    /// # Errors
    /// Returns an error if the standard deviation of an error model is zero.
    pub(super) fn next(
        &self,
        calibration: &Calibration,
        residuals: &[f64],
        leverages: &[f64],
    ) -> Result<Self, CalibrationError> {
        let (problem, layout) = (calibration.problem(), calibration.residual_layout());
        let mut next = self.clone();
        for model in &mut next.models {
            *model = model.next(calibration, residuals, leverages)?;
        }
        for noise in &mut next.outputs {
            let (mut squares, mut degrees, mut weighted) = (0.0, 0.0, Vec::new());
            let same = layout.outputs.iter().filter(|o| o.variable == noise.variable);
            for output in same.filter(|o| self.is_of(problem, o)) {
                for i in output.noisy_rows() {
                    let k = i - output.range.start;
                    squares += residuals[i] * residuals[i];
                    degrees += 1.0 - leverages[i];
                    weighted.push(output.measured[k] * base(problem, output, k));
                }
            }
            noise.is_of_residuals = degrees > FEWEST && squares.is_finite();
            if noise.is_of_residuals {
                let least = calibration.relative_tolerance() * root_mean_square(&weighted);
                let found = (noise.sd * (squares / degrees).sqrt()).max(least);
                noise.sd = if found > 0.0 { found } else { noise.sd };
            }
        }
        Ok(next)
    }

    /// True if the two estimates of the same outputs differ by at most the tolerance that ends the rounds.
    pub(super) fn is_close(&self, other: &Self) -> bool {
        let mut pairs = self.outputs.iter().zip(&other.outputs);
        pairs.all(|(a, b)| (a.sd / b.sd).ln().abs() <= SETTLED)
            && self.models.iter().zip(&other.models).all(|(a, b)| a.is_close(b))
    }

    /// True if the estimate applies to an output.
    fn is_of(&self, problem: &Problem, output: &OutputResiduals) -> bool {
        self.sd_applies(weight(problem, output))
    }

    /// True if the estimate applies to an output with this weight. Known noise is never estimated.
    fn sd_applies(&self, weight: &Weight) -> bool {
        !matches!(weight, Weight::Sigma(_)) && (self.is_of_all || !weight.states_noise())
    }

    /// Returns the standard deviation that divides the weights of a variable. Returns `None` if the weights
    /// state the noise.
    fn sd(&self, variable: &str, weight: &Weight) -> Option<f64> {
        let noise = self.outputs.iter().find(|noise| noise.variable == variable);
        noise.filter(|_| self.sd_applies(weight)).map(|noise| noise.sd)
    }

    /// Returns the estimated standard deviation of the residuals of an output, with the weights of the
    /// problem.
    pub(super) fn of_weighted(&self, problem: &Problem, output: &OutputResiduals) -> f64 {
        let sd = self.sd(&output.variable, weight(problem, output)).unwrap_or(0.0);
        sd * output.weights[0] / base(problem, output, 0)
    }

    /// Replaces the weights of a problem by the weights of the fit.
    ///
    /// # Errors
    /// Returns an error if a column of weights does not exist.
    pub(super) fn weigh(&self, problem: &mut Problem) -> Result<(), CalibrationError> {
        for experiment in &mut problem.experiments {
            for output in &mut experiment.outputs {
                let Some(sd) = self.sd(&output.variable, &output.weight) else { continue };
                let divided = |weights: &[f64]| Weight::Rows(weights.iter().map(|w| w / sd).collect());
                output.weight = match &output.weight {
                    Weight::Constant(weight) => Weight::Constant(weight / sd),
                    Weight::Log(weight) => Weight::Log(weight / sd),
                    Weight::Inverse(_) => Weight::Constant(1.0 / sd),
                    Weight::Column(column) => divided(experiment.data.series(column)?),
                    Weight::Rows(weights) => divided(weights),
                    // Known noise is never estimated.
                    Weight::Sigma(_) => continue,
                };
            }
        }
        // Afterwards, because these outputs would otherwise look like those with an estimated deviation.
        for model in &self.models {
            for SigmaSeries { experiment, output, sigma, .. } in &model.series {
                // The indices may come from a file.
                let output =
                    problem.experiments.get_mut(*experiment).and_then(|e| e.outputs.get_mut(*output));
                let Some(output) = output else { continue };
                output.weight = match model.model.is_fitted() {
                    true => Weight::Rows(sigma.iter().map(|sigma| 1.0 / sigma).collect()),
                    false => Sigma::Rows(sigma.clone().into()).into(),
                };
            }
        }
        Ok(())
    }

    /// Replaces the weights of a layout by the weights of the fit.
    pub(super) fn weigh_layout(&self, problem: &Problem, layout: &mut ResidualLayout) {
        self.weigh_models(problem, layout);
        for output in &mut layout.outputs {
            if let Some(sd) = self.sd(&output.variable, weight(problem, output)) {
                output.weights = (0..output.weights.len()).map(|k| base(problem, output, k) / sd).collect();
            }
        }
    }

    /// Replaces the weights of the outputs with an error model by the weights of the fit.
    pub(super) fn weigh_models(&self, problem: &Problem, layout: &mut ResidualLayout) {
        for SigmaSeries { experiment, output, sigma, .. } in
            self.models.iter().flat_map(|model| &model.series)
        {
            let is_of_series = |o: &&mut OutputResiduals| (o.experiment, o.output) == (*experiment, *output);
            let Some(residuals) = layout.outputs.iter_mut().find(is_of_series) else { continue };
            if let Ok(rows) = rows_of(problem, residuals) {
                let weight = |row: usize| sigma.get(row).map_or(0.0, |sigma| 1.0 / sigma);
                residuals.weights = rows.into_iter().map(weight).collect();
            }
        }
    }

    /// Returns the estimates without the error models.
    pub(crate) fn without_models(&self) -> Self {
        Self { models: Vec::new(), ..self.clone() }
    }

    /// Replaces estimated coefficients of error models by their values, for other recordings.
    pub(crate) fn state_models(&self, problem: &mut Problem) {
        for output in problem.experiments.iter_mut().flat_map(|experiment| &mut experiment.outputs) {
            let is_of_output = |model: &&ModelledNoise| {
                model.variable == output.variable && output.weight.error_model() == Some(&model.model)
            };
            if let Some(ModelledNoise { a, b, .. }) = self.models.iter().find(is_of_output) {
                let [constant, proportional] = [*a, *b].map(Coefficient::Stated);
                output.weight = Sigma::Model(ErrorModel { constant, proportional }).into();
            }
        }
    }

    /// Returns the findings about the estimate.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let open = self.outputs.iter().filter(|noise| !noise.is_of_residuals);
        let mut found: Vec<Finding> = open
            .map(|OutputNoise { variable, sd, .. }| {
                Finding::warning(
                    FindingId::RoughNoiseEstimate,
                    format!("noise of {variable}"),
                    format!(
                        "the standard deviation {} is estimated from differences between neighbouring measurements, because there are too few \
                         residuals or the search ended early. The weights of the fit are approximate",
                        digits(*sd)
                    ),
                    "Set the weights to 1 over the standard deviation",
                )
            })
            .collect();
        let start = |model: &&ModelledNoise| !model.is_of_residuals;
        found.extend(self.models.iter().filter(start).map(|model| {
            Finding::warning(
                FindingId::RoughNoiseEstimate,
                format!("noise of {}", model.variable),
                format!(
                    "the coefficients of sigma '{}' are not estimated, because there are too few residuals or the search ended early. The \
                     weights of the fit are approximate",
                    model.model
                ),
                "Write numbers instead of names in sigma",
            )
        }));
        if !self.is_settled && self.n_rounds >= MOST_ROUNDS {
            found.push(Finding::warning(
                FindingId::RoughNoiseEstimate,
                "noise",
                format!(
                    "the estimates or error models still changed after {MOST_ROUNDS} fits. The weights of the fit are approximate"
                ),
                "Set the weights to 1 over the standard deviation",
            ));
        }
        found
    }
}

/// Factor by which residuals contradict the stated noise, in either direction, and minimum number of
/// residuals.
const CONTRADICTS_STATED: (f64, usize) = (2.0, 10);

/// Returns findings about residuals of a fit that contradict the noise stated by its weights. `has_priors`:
/// the weight of the priors depends on the noise. Without priors, nothing depends on it because the standard
/// errors use the residuals.
pub(super) fn contradictions_of_stated(
    calibration: &Calibration,
    residuals: &[f64],
    has_priors: bool,
) -> Vec<Finding> {
    let (problem, layout) = (calibration.problem(), calibration.residual_layout());
    let (factor, fewest) = CONTRADICTS_STATED;
    let of = |output: &OutputResiduals| {
        if output.is_noise_known {
            return None;
        }
        // Weights of 0 and 1 only select measurements.
        let is_stated = weight(problem, output).states_noise()
            && (has_priors || output.weights.iter().any(|w| *w != 0.0 && *w != 1.0));
        let n = output.weights.iter().filter(|weight| **weight != 0.0).count();
        let squares = residuals[output.range.clone()].iter().map(|r| r * r).sum::<f64>();
        let ratio = (squares / n as f64).sqrt();
        if !is_stated || n < fewest || (1.0 / factor..=factor).contains(&ratio) {
            return None;
        }
        let (severity, meaning, remedy) = match (has_priors, ratio > 1.0) {
            (true, true) => (
                Severity::Warning,
                "A prior or the model keeps the fit away from the measurements, or the noise is larger than stated and priors count too little",
                "Check the priors and the weights (1/sigma), or use noise 'estimated'",
            ),
            (true, false) => (
                Severity::Warning,
                "The noise is smaller than stated, and priors count too much",
                "Check that the weights are 1/sigma and not sigma, or use noise 'estimated'",
            ),
            (false, is_larger) => (
                Severity::Note,
                match is_larger {
                    true => {
                        "The model lacks an effect, or the noise is larger than stated; standard errors use the residuals"
                    }
                    false => "The noise is smaller than stated; standard errors use the residuals",
                },
                "Check that the weights are 1/sigma",
            ),
        };
        let sentence =
            format!("the residuals are {} times the noise that the weights state. {meaning}", digits(ratio));
        let subject = format!("noise of {}", output.variable);
        Some(Finding::new(severity, FindingId::ContradictedNoise, subject, sentence, remedy))
    };
    layout.outputs.iter().filter_map(of).collect()
}

/// Probability below which residuals contradict known noise: one in a hundred fits by chance.
const SIGNIFICANT: f64 = 0.01;

/// Returns the finding about residuals that contradict known noise, by the chi-square test of their sum of
/// squares. `n_free` is the number of fitted parameters, and `is_noise_known` is true if the noise of all
/// outputs is known. Priors take up to `n_free` degrees of freedom less than the parameters, so the test with
/// priors uses the limit that favours the known noise.
pub(super) fn contradiction_of_known_noise(
    layout: &ResidualLayout,
    residuals: &[f64],
    n_free: usize,
    is_noise_known: bool,
) -> Option<Finding> {
    let rows = |output: &OutputResiduals| output.noisy_rows().collect::<Vec<usize>>();
    let outputs = || layout.outputs.iter().filter(|output| is_noise_known || output.is_noise_known);
    let noisy: Vec<usize> = outputs().flat_map(rows).collect();
    let n_all = layout.outputs.iter().flat_map(rows).count();
    let n = noisy.len() as f64;
    // Each output loses degrees of freedom in proportion to its measurements.
    let least = n - n_free as f64 * n / n_all as f64;
    let most = if layout.priors.is_empty() { least } else { n };
    if noisy.is_empty() || least <= 0.0 {
        return None;
    }
    let chi_square: f64 = noisy.iter().map(|i| residuals[*i] * residuals[*i]).sum();
    let is_larger = chi_square > most;
    let degrees = if is_larger { most } else { least };
    let of = ChiSquared::new(degrees).ok()?;
    // Both tails count.
    let p = 2.0 * if is_larger { of.sf(chi_square) } else { of.cdf(chi_square) };
    if p >= SIGNIFICANT {
        return None;
    }
    let reduced = chi_square / degrees;
    let (factor, _) = CONTRADICTS_STATED;
    let is_far = !(1.0 / factor..=factor).contains(&reduced.sqrt());
    let (meaning, remedy) = match is_larger {
        true => (
            "The model lacks an effect, or sigma is too small, so the standard errors are too small",
            "Check the model and sigma, or use weights instead of sigma, so that standard errors use the residuals",
        ),
        false => (
            "Sigma is too large, so the standard errors are too large",
            "Check that sigma is the standard deviation in the unit of the column, or use weights instead of sigma",
        ),
    };
    let sentence = format!(
        "the residuals are {} times the known noise (reduced chi-square {}, p = {}). {meaning}",
        digits(reduced.sqrt()),
        digits(reduced),
        digits(p),
    );
    let severity = if is_far { Severity::Warning } else { Severity::Note };
    Some(Finding::new(severity, FindingId::ContradictedNoise, "noise", sentence, remedy))
}

/// Returns the leverage of each residual: the diagonal of the projection onto the column space of the m x n
/// Jacobian of all residuals.
pub(super) fn leverages(
    jacobian: &[f64],
    n: usize,
    context: &RunContext<'_>,
) -> Result<Vec<f64>, CalibrationError> {
    if jacobian.is_empty() {
        return Ok(Vec::new());
    }
    let m = jacobian.len() / n;
    let mut columns = DMatrix::from_row_slice(m, n, jacobian);
    for mut column in columns.column_iter_mut() {
        // Scale each column to make the rank independent of units.
        let length = column.norm();
        column.iter_mut().for_each(|c| *c = if length > 0.0 { *c / length } else { 0.0 });
    }
    let Some(ThinSvd { u, values, .. }) = thin_svd(&columns, context)? else { return Ok(vec![0.0; m]) };
    let least = f64::EPSILON * m.max(n) as f64 * values.iter().copied().fold(0.0, f64::max);
    let kept: Vec<usize> = (0..values.len()).filter(|k| values[*k] > least).collect();
    let mut leverages = vec![0.0; m];
    for &k in &kept {
        leverages.iter_mut().zip(u.column(k).iter()).for_each(|(sum, u)| *sum += u * u);
    }
    Ok(leverages.into_iter().map(|leverage: f64| leverage.min(1.0)).collect())
}

/// Returns the part of a measurement's weight that describes the noise.
fn base(problem: &Problem, output: &OutputResiduals, k: usize) -> f64 {
    match weight(problem, output) {
        Weight::Inverse(_) => 1.0,
        _ => output.weights[k],
    }
}

/// Returns the size of each measurement minus the polynomial through `on_side` neighbours on each side. The
/// result is divided by the standard deviation that noise of `1 / base` would cause.
fn pseudo_residuals(problem: &Problem, output: &OutputResiduals, on_side: usize) -> Vec<f64> {
    let (times, y) = (&output.times, &output.measured);
    let variance = |k: usize| base(problem, output, k).powi(-2);
    let of_middle = |i: usize| {
        let neighbours = || (i - on_side..=i + on_side).filter(|k| *k != i);
        // Lagrange polynomials at the middle point.
        let part = |k: usize| {
            let others = neighbours().filter(|j| *j != k);
            others.map(|j| (times[i] - times[j]) / (times[k] - times[j])).product::<f64>()
        };
        let sums = neighbours().map(|k| (part(k), k)).fold((y[i], variance(i)), |(left, all), (part, k)| {
            (left - part * y[k], all + part * part * variance(k))
        });
        sums.0.abs() / sums.1.sqrt()
    };
    (on_side..y.len().saturating_sub(on_side)).map(of_middle).collect()
}

fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn centered(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|v| v - mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leverages_of(jacobian: &[f64], n: usize) -> Vec<f64> {
        leverages(jacobian, n, &RunContext::new()).unwrap()
    }

    #[test]
    fn leverages_are_the_diagonal_of_the_projection() {
        // A line at t = 0, 1, 2, 3 with its slope in a different unit has the leverages 0.7, 0.3, 0.3, 0.7.
        let line = [1.0, 0.0, 1.0, 1e6, 1.0, 2e6, 1.0, 3e6];
        for (got, expected) in leverages_of(&line, 2).iter().zip([0.7, 0.3, 0.3, 0.7]) {
            assert!((got - expected).abs() < 1e-12, "{got}");
        }
        // A duplicated column counts once, and a parameter without effect does not count. If there are fewer
        // residuals than parameters, all leverages are 1.
        let twice = [1.0, 1.0, 0.0, 1.0, 1.0, 0.0];
        assert!(leverages_of(&twice, 3).iter().all(|h| (h - 0.5).abs() < 1e-12));
        assert!((leverages_of(&[1.0, 2.0], 2)[0] - 1.0).abs() < 1e-12);
        assert!(leverages_of(&[], 0).is_empty());
    }
}
