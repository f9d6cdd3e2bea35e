//! Bootstrap: fits to synthetic measurements, whose spread estimates the uncertainty of the parameters
//! without a linear model.

use crate::cost::parallel;
use crate::data::NewValues;
use crate::error::CalibrationError;
use crate::findings::display_text::{digits, visible_line};
use crate::fit::one_stage::{Fit, FitNoise, FitOptions, NoiseRule};
use crate::loaded::calibration::Calibration;
use crate::problem::fingerprint::hash_of_bytes;
use crate::problem::objective::CostKind;
use crate::problem::residual_layout::OutputResiduals;
use crate::uncertainty::robust::quantile;
use crate::validation::saved_fits::SavedFits;
use base::RunContext;
use dfo::{RunOptions, standard_normals, uniforms};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// Source of the synthetic errors, which are added to the simulation of the fit (Efron and Tibshirani, An
/// Introduction to the Bootstrap, 1993, chapters 8 and 9).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BootstrapKind {
    /// Normal errors with the known standard deviation, or with the standard deviation of the weighted
    /// residuals of each output.
    #[default]
    Parametric,
    /// Weighted residuals of the same output, drawn with replacement. They are centred and scaled by `sqrt(N
    /// / (N - p))`.
    Residual,
    /// Blocks of consecutive residuals, for autocorrelated errors (circular blocks: Politis and Romano, in:
    /// Exploring the Limits of Bootstrap, 1992). The blocks have the length `N^(1/3)`, rounded up (Hall,
    /// Horowitz and Jing, Biometrika 82, 1995).
    Block,
}

/// Options of [`Calibration::bootstrap`].
#[derive(Debug, Clone, PartialEq)]
pub struct BootstrapOptions {
    /// Number of fits; default 200, for standard errors. Percentile intervals require about 1000.
    pub n: usize,
    /// Source of the errors.
    pub kind: BootstrapKind,
    /// Seed of the random numbers; default: drawn, and stored in the result. Each fit has a separate stream,
    /// so the result does not depend on the number of workers, and a larger `n` only adds fits.
    pub seed: Option<u64>,
    /// Number of fits that run in parallel; default: all cores.
    pub workers: Option<usize>,
    /// File with the completed fits. An existing file of the same bootstrap is continued, also with a larger
    /// `n`; its seed is used if none is given.
    pub checkpoint: Option<PathBuf>,
}

impl Default for BootstrapOptions {
    fn default() -> Self {
        Self { n: 200, kind: BootstrapKind::default(), seed: None, workers: None, checkpoint: None }
    }
}

/// Fits to synthetic measurements. `Display` prints a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Bootstrap {
    /// Names of the parameters.
    pub names: Vec<String>,
    /// Values of the original fit.
    pub x: Vec<f64>,
    /// Fitted values of the synthetic measurements, in the order of the random numbers, without failed fits.
    pub samples: Vec<Vec<f64>>,
    /// Number of fits that failed.
    pub n_failed: usize,
    /// Reason of the first failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// Source of the errors.
    pub kind: BootstrapKind,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Bootstrap {
    /// Returns the standard deviation of each parameter; NaN for fewer than two fits.
    pub fn standard_errors(&self) -> Vec<f64> {
        let n = self.samples.len() as f64;
        let of = |i: usize| {
            let mean = self.samples.iter().map(|x| x[i]).sum::<f64>() / n;
            let squares: f64 = self.samples.iter().map(|x| (x[i] - mean).powi(2)).sum();
            (squares / (n - 1.0)).sqrt()
        };
        (0..self.x.len()).map(of).collect()
    }

    /// Returns the percentile intervals of the parameters at `level`, for example 0.95. Quantiles are
    /// interpolated linearly between the ordered values.
    ///
    /// # Errors
    /// Returns an error if the level is not between 0 and 1.
    pub fn intervals(&self, level: f64) -> Result<Vec<(f64, f64)>, CalibrationError> {
        if !(level > 0.0 && level < 1.0) || self.samples.is_empty() {
            return Err(CalibrationError::Setup(format!(
                "intervals require a level between 0 and 1, not level = {level} ({} fits)",
                self.samples.len()
            )));
        }
        let of = |i: usize| {
            let mut values: Vec<f64> = self.samples.iter().map(|x| x[i]).collect();
            let mut at = |p: f64| quantile(&mut values, p);
            (at(0.5 - 0.5 * level), at(0.5 + 0.5 * level))
        };
        Ok((0..self.x.len()).map(of).collect())
    }
}

/// Errors of an output, in units of its weighted residuals.
struct Errors {
    /// Centred and scaled residuals of the fit.
    residuals: Vec<f64>,
    /// Standard deviation of the parametric errors.
    sd: f64,
}

impl Errors {
    fn new(residuals: Vec<f64>, free_part: f64, is_noise_known: bool) -> Self {
        let n = residuals.len() as f64;
        let scale = (1.0 / (1.0 - free_part)).sqrt();
        let squares: f64 = residuals.iter().map(|r| r * r).sum();
        let mean = residuals.iter().sum::<f64>() / n;
        let sd = if is_noise_known { 1.0 } else { scale * (squares / n).sqrt() };
        Self { residuals: residuals.iter().map(|r| (r - mean) * scale).collect(), sd }
    }

    /// Draws errors for all measurements, as a function of the seed and the index.
    fn draw(&self, kind: BootstrapKind, seed: u64, index: usize) -> Vec<f64> {
        let (r, n) = (&self.residuals, self.residuals.len());
        let rows = |count: usize| uniforms(seed, index, count).into_iter().map(|u| (u * n as f64) as usize);
        match kind {
            BootstrapKind::Parametric => {
                standard_normals(seed, index, n).into_iter().map(|deviate| self.sd * deviate).collect()
            }
            BootstrapKind::Residual => rows(n).map(|row| r[row]).collect(),
            BootstrapKind::Block => {
                let length = (n as f64).cbrt().ceil().max(1.0) as usize;
                let blocks = rows(n.div_ceil(length));
                blocks.flat_map(|first| (first..first + length).map(|row| r[row % n])).take(n).collect()
            }
        }
    }
}

impl Calibration {
    /// Fits synthetic measurements: the simulation of a fit plus random errors. The fits start at the fitted
    /// values, with the objective, the loss and the weights of the fit, and run in parallel. Priors and
    /// measured initial states remain as they are.
    ///
    /// # Errors
    /// Returns an error if the fit minimised neither a sum of squares nor the likelihood, if there are no
    /// more measurements than parameters, if the simulation fails, or if none of the fits succeeds. Also
    /// returns an error if the file contains another bootstrap, or cannot be read or written. Returns
    /// [`CalibrationError::Cancelled`] if the context has ended; the file then contains the completed fits.
    pub fn bootstrap(
        &self,
        fit: &Fit,
        options: &BootstrapOptions,
        context: &RunContext<'_>,
    ) -> Result<Bootstrap, CalibrationError> {
        self.as_fitted(fit, |fitted| fitted.bootstrap_fitted(fit, options, context))
    }

    /// Computes the bootstrap with the weights and the tolerance of the fit.
    fn bootstrap_fitted(
        &self,
        fit: &Fit,
        options: &BootstrapOptions,
        context: &RunContext<'_>,
    ) -> Result<Bootstrap, CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        let objective = CostKind::of_name(&fit.objective).filter(CostKind::has_uncertainty);
        let Some(objective) = objective else {
            return setup(format!(
                "a bootstrap requires a sum of squares or the likelihood, but the fit minimised {}",
                fit.objective
            ));
        };
        let goodness = fit.goodness();
        if goodness.nfree == 0 || options.n == 0 {
            return setup(format!(
                "a bootstrap requires more measurements ({}) than fitted parameters ({}), and n of at least 1, not {}",
                goodness.ndata, goodness.nvarys, options.n
            ));
        }
        let residuals = self.residuals(&fit.x, context)?;
        let free_part = goodness.nvarys as f64 / goodness.ndata as f64;
        let errors = |output: &OutputResiduals| {
            let residuals_of_output = output.noisy_rows().map(|row| residuals[row]).collect();
            Errors::new(
                residuals_of_output,
                free_part,
                output.is_noise_known || fit.noise.as_ref().is_some_and(FitNoise::is_known),
            )
        };
        let errors: Vec<Errors> = self.residual_layout().outputs.iter().map(errors).collect();
        self.prepare()?;
        let saved = self.bootstrap_file(fit, options)?;
        let seed = saved.seed;
        let saved = Mutex::new(saved);
        let held = || saved.lock().unwrap_or_else(PoisonError::into_inner);
        let task = |number: usize, context: &RunContext<'_>| {
            if let Some(known) = held().fits.get(&number) {
                return Ok(known.clone());
            }
            let drawn = errors.iter().enumerate();
            let drawn = drawn.map(|(k, of)| of.draw(options.kind, seed, number * errors.len() + k));
            let drawn: Vec<Vec<f64>> = drawn.collect();
            let fitted = self.with_errors(&residuals, &drawn)?.fit(FitOptions {
                run: RunOptions { workers: Some(1), seed: Some(0), ..FitOptions::default_run() },
                start: Some(fit.x.clone()),
                loss: fit.report.loss.sparing(0),
                objective: objective.clone(),
                noise: NoiseRule::Stated,
                uncertainty: None,
                context: *context,
                ..FitOptions::default()
            });
            match fitted {
                _ if context.is_over() => Err(CalibrationError::Cancelled),
                fitted => {
                    let nearest = |found: Fit| -> Vec<f64> {
                        let own = self.parameters().iter().zip(&fit.x).zip(&found.x);
                        own.map(|((p, center), x)| p.nearest_to(*center, *x)).collect()
                    };
                    let x = match fitted {
                        Ok(found) if found.report.is_success() => Ok(nearest(found)),
                        Ok(found) => Err(found.report.message),
                        Err(error) => Err(error.to_string()),
                    };
                    held().add(number, x.clone());
                    Ok(x.ok())
                }
            }
        };
        let workers = options.workers.unwrap_or_else(base::available_cores);
        let made = parallel::map(options.n, workers, context, &task).into_iter();
        held().write();
        let made: Vec<Option<Vec<f64>>> =
            made.map(|x| x.unwrap_or(Err(CalibrationError::Cancelled))).collect::<Result<_, _>>()?;
        let n_failed = made.iter().filter(|x| x.is_none()).count();
        let failure = held().failures.range(..options.n).next().map(|(_, reason)| reason.clone());
        let samples: Vec<Vec<f64>> = made.into_iter().flatten().collect();
        if samples.is_empty() {
            return setup(format!(
                "none of the {n_failed} fits of the bootstrap succeeded. Reason of the first: {}",
                failure.as_deref().unwrap_or("unknown")
            ));
        }
        Ok(Bootstrap {
            names: fit.names.clone(),
            x: fit.x.clone(),
            samples,
            n_failed,
            failure,
            kind: options.kind,
            seed,
        })
    }

    /// Opens the file of a bootstrap with everything that its fits depend on.
    fn bootstrap_file(&self, fit: &Fit, options: &BootstrapOptions) -> Result<SavedFits, CalibrationError> {
        let bounds: Vec<_> = self
            .parameters()
            .iter()
            .map(|p| (p.lower(), p.upper(), p.scale_kind(), p.nominal_size(), p.is_fixed()))
            .collect();
        let is_known = fit.noise.as_ref().is_some_and(FitNoise::is_known);
        let words = format!(
            "{} {:?} {bounds:?} {:?} {:?} {is_known} {}",
            self.problem_hash(),
            fit.x,
            fit.report.loss,
            options.kind,
            fit.objective
        );
        let (path, seed) = (options.checkpoint.as_deref(), options.seed);
        SavedFits::open(path, hash_of_bytes(words.as_bytes()), fit.x.len(), seed)
    }

    /// Returns a copy whose measurements are the simulation plus these weighted errors.
    fn with_errors(&self, residuals: &[f64], errors: &[Vec<f64>]) -> Result<Self, CalibrationError> {
        let mut problem = self.problem().clone();
        // New values by experiment and column, by time and old value.
        let mut moved: BTreeMap<(usize, &str), NewValues> = BTreeMap::new();
        for (output, errors) in self.residual_layout().outputs.iter().zip(errors) {
            let data = &self.problem().experiments[output.experiment].data;
            let recorded = data.measured(&output.column, 0..data.time().len())?;
            let rows = output.rows_of(data.time(), recorded);
            let column = moved.entry((output.experiment, &output.column)).or_default();
            for (row, error) in output.noisy_rows().zip(errors) {
                let k = row - output.range.start;
                let Some(old) = rows.get(k).map(|row| recorded[*row]) else { continue };
                let time = output.times[k];
                let new = output.value(output.measured[k] + (residuals[row] + error) / output.weights[k]);
                column.entry((time.to_bits(), old.to_bits())).or_insert(new);
            }
        }
        for ((experiment, column), values) in moved {
            problem.experiments[experiment].data.replace(column, &values);
        }
        self.derived(problem)
    }
}

impl fmt::Display for Bootstrap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<String> = self.names.iter().map(|name| visible_line(name).into_owned()).collect();
        let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(9);
        let n = self.samples.len();
        write!(f, "{:<width$}  {:>12}  {:>12}  95 % interval of {n} fits", "parameter", "value", "error")?;
        let intervals = self.intervals(0.95).unwrap_or_default();
        for (i, (name, error)) in names.iter().zip(self.standard_errors()).enumerate() {
            let [value, error] = [self.x[i], error].map(|value| digits(value).to_string());
            write!(f, "\n{name:<width$}  {value:>12}  {error:>12}")?;
            if let Some((low, high)) = intervals.get(i) {
                write!(f, "  {} to {}", digits(*low), digits(*high))?;
            }
        }
        if self.n_failed > 0 {
            write!(f, "\n{} fits failed and are not included", self.n_failed)?;
            if let Some(reason) = &self.failure {
                write!(f, "; reason of the first: {}", visible_line(reason))?;
            }
        }
        Ok(())
    }
}
