//! Validation of fitted parameters on data that they were not fitted to: other parts of the recordings, or
//! other recordings.

use crate::cost::residual::PointResiduals;
use crate::error::CalibrationError;
use crate::findings::display_text::{digits, visible_line};
use crate::findings::finding::{Finding, table};
use crate::findings::identifier::FindingId;
use crate::fit::one_stage::{Fit, FitNoise, FitOptions, NoiseRule};
use crate::fit::output_fit::OutputFit;
use crate::loaded::calibration::Calibration;
use crate::problem::definition::Element;
use crate::problem::experiment::Experiment;
use crate::problem::objective::CostKind;
use crate::problem::parameter::Parameter;
use crate::problem::residual_layout::OutputResiduals;
use base::RunContext;
use dfo::RobustLoss;
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::fmt;

/// Data to validate a fit on.
#[derive(Debug, Clone, PartialEq)]
pub enum ValidationSet {
    /// Measurements of the calibration in these windows, each from and to a time. Simulations start at
    /// their usual times, so that the model reaches a window with its history.
    Windows(Vec<(f64, f64)>),
    /// Other recordings.
    Experiments(Vec<Experiment>),
}

/// Validation of parameters on measurements that they were not fitted to. `Display` prints a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Validation {
    /// Names of the parameters. Local parameters belong to the validated recordings.
    pub names: Vec<String>,
    /// Values of the parameters.
    pub x: Vec<f64>,
    /// All outputs of all experiments, in the order of the residual vector.
    pub outputs: Vec<ValidatedOutput>,
    /// Number of measurements that count.
    pub n: usize,
    /// Unit of the times.
    #[serde(default = "second")]
    pub time_unit: String,
    /// Names of the parameters that were fitted to these recordings, because the fit does not contain their
    /// values there.
    #[serde(default)]
    pub fitted: Vec<String>,
    /// Root mean square of the weighted residuals. It uses plain residuals even with a loss.
    pub rms: f64,
    /// RMS at the start of the fit; `None` if the simulation failed there.
    pub start_rms: Option<f64>,
    /// Warnings about measurements that the fit has used. For these, the RMS does not measure predictions.
    #[serde(default)]
    pub findings: Vec<Finding>,
    /// Number of simulations.
    pub n_simulations: usize,
    /// Statistics of the simulations; not stored.
    #[serde(skip)]
    pub stats: Stats,
}

/// An output of an experiment: measured, and simulated with the fitted parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ValidatedOutput {
    /// Quality of fit of the output.
    pub fit: OutputFit,
    /// Times of the measurements, in the time unit of the model.
    pub times: Vec<f64>,
    /// Measured values.
    pub measured: Vec<f64>,
    /// Simulated minus measured, without weights.
    pub residuals: Vec<f64>,
    /// Simulated minus measured at the start of the fit; `None` if the simulation failed there.
    pub start_residuals: Option<Vec<f64>>,
}

/// Returns the unit of times in files of older versions.
fn second() -> String {
    "s".to_owned()
}

impl ValidatedOutput {
    /// Returns the simulated values at the times of the measurements.
    pub fn simulated(&self) -> Vec<f64> {
        self.measured.iter().zip(&self.residuals).map(|(m, r)| m + r).collect()
    }
}

impl Validation {
    /// Returns the RMS relative to the RMS at the start of the fit, on the same measurements. Returns `None`
    /// if the simulation failed at the start.
    pub fn scaled_rms(&self) -> Option<f64> {
        self.start_rms.map(|start| self.rms / start)
    }
}

impl fmt::Display for Validation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = |o: &OutputFit| visible_line(&format!("{}: {}", o.experiment, o.variable)).into_owned();
        let width = self.outputs.iter().map(|o| names(&o.fit).chars().count()).max().unwrap_or(0).max(6);
        writeln!(
            f,
            "{:<width$}  {:>6}  {:>10}  {:>10}  {:>7}  unit",
            "output", "n", "RMS", "scaled RMS", "fit"
        )?;
        for output in self.outputs.iter().map(|o| &o.fit) {
            let scaled = output
                .start_rms
                .map_or_else(|| "-".to_owned(), |start| digits(output.rms / start).to_string());
            let (name, rms) = (names(output), digits(output.rms).to_string());
            let percent = format!("{:.1} %", output.fit_percent);
            let unit = visible_line(output.unit.as_deref().unwrap_or(""));
            writeln!(f, "{name:<width$}  {:>6}  {rms:>10}  {scaled:>10}  {percent:>7}  {unit}", output.n)?;
        }
        let scaled = self.scaled_rms().map_or_else(|| "-".to_owned(), |scaled| digits(scaled).to_string());
        write!(
            f,
            "{:<width$}  {:>6}  {:>10}  {scaled:>10}",
            "all, weighted",
            self.n,
            digits(self.rms).to_string()
        )?;
        if !self.fitted.is_empty() {
            write!(f, "\nfitted to these recordings: {}", visible_line(&self.fitted.join(", ")))?;
        }
        f.write_str(&table(&self.findings))
    }
}

impl Calibration {
    /// Simulates with the parameters of a fit of this calibration and compares with measurements that the fit
    /// has not used. Other recordings may have local parameters that the fit does not contain. These are
    /// first fitted to the recordings, from their start values there, with the same cost and loss while all
    /// others are held. A parameter that acts in some experiments only acts in the recordings with their
    /// names. All RMS values use plain residuals, with every loss. Error models have the coefficients of the
    /// fit and use the measured values instead of the simulated ones.
    ///
    /// ```
    /// use calibration::{Calibration, Data, Experiment, FitOptions, Parameter, ValidationSet};
    /// let t = vec![0.0, 0.5, 1.0, 1.5];
    /// let x = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
    /// let data = Data::from_columns(t, [("x".to_owned(), x)])?;
    /// let calibration = Calibration::builder(fmi::Fmu::open(example_models::example_fmu("dahlquist")?)?)
    ///     .experiment(Experiment::new(data).output("x", "x").window(0.0, 0.5))
    ///     .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
    ///     .build()?;
    /// let fit = calibration.fit(FitOptions::default())?;
    /// let window = ValidationSet::Windows(vec![(1.0, 1.5)]);
    /// let validation = calibration.validate(&fit, &window, &calibration::RunContext::new())?;
    /// assert!(validation.rms < 1e-3 && validation.scaled_rms() < Some(0.01));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Returns an error if:
    /// - windows or recordings are invalid,
    /// - local parameters must be fitted but the fit used a user-defined function,
    /// - a parameter acts in none of the recordings, because their names differ from its experiments,
    /// - a simulation fails at the fitted parameters.
    pub fn validate(
        &self,
        fit: &Fit,
        set: &ValidationSet,
        context: &RunContext<'_>,
    ) -> Result<Validation, CalibrationError> {
        let parameters = match set {
            ValidationSet::Experiments(experiments) => {
                let mut other = self.problem().clone();
                other.experiments.clone_from(experiments);
                let names = other.experiment_names();
                let of_fit = self.problem().experiment_names();
                let are_of_fit = names.iter().all(|name| of_fit.contains(name));
                let error = |p: &Parameter| CalibrationError::Parameter {
                    name: p.name().to_owned(),
                    message: format!(
                        "acts in {} only, so it is unknown whether it acts in the recordings {}. Name a recording after the \
                             experiment whose parameters it has",
                        p.given_experiments().unwrap_or_default().join(", "),
                        names.join(", ")
                    ),
                };
                // Recordings that are named after experiments of the fit have their parameters and no others.
                let acting = |p: &Parameter| match p.restricted_to(&names) {
                    None if are_of_fit => None,
                    restricted => Some(restricted.ok_or_else(|| error(p))),
                };
                let kept = self.problem().parameters.iter().filter_map(acting);
                self.problem().with_used(kept.collect::<Result<_, _>>()?)
            }
            ValidationSet::Windows(_) => self.problem().parameters.clone(),
        };
        self.validate_with(fit, set, parameters, context)
    }

    /// Validates as [`validate`](Self::validate) does, with these parameters in other recordings.
    pub(super) fn validate_with(
        &self,
        fit: &Fit,
        set: &ValidationSet,
        parameters: Vec<Parameter>,
        context: &RunContext<'_>,
    ) -> Result<Validation, CalibrationError> {
        self.check_length(&fit.x)?;
        let models =
            fit.noise.as_ref().and_then(FitNoise::estimated).filter(|noise| !noise.models.is_empty());
        if let Some(noise) = models {
            // Standard deviations of the fit belong to its own measurements; its coefficients hold everywhere.
            let with_models_stated = |experiments: &[Experiment]| {
                let mut problem = self.problem().clone();
                problem.experiments = experiments.to_vec();
                noise.state_models(&mut problem);
                problem.experiments
            };
            let mut problem = self.problem().clone();
            problem.experiments = with_models_stated(&problem.experiments);
            let fit = Fit { noise: Some(FitNoise::Estimated(noise.without_models())), ..fit.clone() };
            let set = match set {
                ValidationSet::Experiments(other) => ValidationSet::Experiments(with_models_stated(other)),
                windows => windows.clone(),
            };
            return self.derived(problem)?.validate_with(&fit, &set, parameters, context);
        }
        match set {
            ValidationSet::Windows(windows) => {
                let other = self.windowed(windows)?;
                let validation = other.validation(&fit.start, &fit.x, Stats::default(), 0, context)?;
                Ok(Validation { findings: self.seen(&other, 0.0), ..validation })
            }
            ValidationSet::Experiments(experiments) => {
                let mut problem = self.problem().clone();
                problem.experiments.clone_from(experiments);
                problem.parameters = parameters;
                problem.drop_foreign_constraints()?;
                let other = self.derived(problem)?;
                let (start, mut x, local) = (
                    self.carried(&other, &fit.start)?,
                    self.carried(&other, &fit.x)?,
                    self.not_shared(&other)?,
                );
                let (mut stats, mut n, mut fitted) = (Stats::default(), 0, Vec::new());
                if local.iter().any(|&i| !other.parameters()[i].is_fixed()) {
                    let held = (0..x.len()).filter(|i| !local.contains(i)).collect();
                    let free = local.iter().map(|&i| &other.parameters()[i]).filter(|p| !p.is_fixed());
                    fitted = free.map(|p| p.name().to_owned()).collect();
                    let Some(objective) = CostKind::of_name(&fit.objective) else {
                        return Err(CalibrationError::Setup(format!(
                            "{} would be fitted to these recordings, but the fit minimised a function that is not stored ('{}'). Fix \
                             these parameters, or fit with a named objective",
                            fitted.join(", "),
                            fit.objective
                        )));
                    };
                    let fitted_calibration = other.of_fit(fit)?;
                    let refit = fitted_calibration.as_ref().unwrap_or(&other).fit(FitOptions {
                        noise: NoiseRule::Stated,
                        start: Some(x),
                        held,
                        context: *context,
                        objective,
                        loss: fit.report.loss,
                        uncertainty: None,
                        ..FitOptions::default()
                    })?;
                    if context.is_over() {
                        return Err(CalibrationError::Cancelled);
                    }
                    n = refit.report.n_evaluations + refit.report.n_speculative + refit.n_checks;
                    (stats, x) = (refit.stats, refit.x);
                }
                let validation = other.validation(&start, &x, stats, n, context)?;
                // A time and a value may be equal by chance.
                Ok(Validation { findings: self.seen(&other, 0.5), fitted, ..validation })
            }
        }
    }

    /// Returns warnings about outputs of `other` if at least this share of their measurements was used to fit
    /// this calibration.
    fn seen(&self, other: &Calibration, share: f64) -> Vec<Finding> {
        let points = |output: &OutputResiduals| -> Vec<(u64, u64)> {
            output.times.iter().zip(&output.measured).map(|(t, y)| (t.to_bits(), y.to_bits())).collect()
        };
        let outputs = &self.residual_layout().outputs;
        let names = other.problem().experiment_names();
        let finding = |output: &OutputResiduals| {
            let same = outputs.iter().filter(|o| o.variable == output.variable);
            let points_of_fit: HashSet<(u64, u64)> = same.flat_map(points).collect();
            let n = points(output).iter().filter(|point| points_of_fit.contains(point)).count();
            let all = output.measured.len();
            let is_seen = n > 0 && n as f64 >= share * all as f64;
            is_seen.then(|| {
                Finding::warning(
                    FindingId::ValidationOverlap,
                    format!("{}: {}", names[output.experiment], output.variable),
                    format!(
                        "the fit has used {n} of these {all} measurements. Their RMS shows how well they are reproduced, not how well new \
                         ones are predicted"
                    ),
                    "Fit in one window and validate in another, or use another recording",
                )
            })
        };
        other.residual_layout().outputs.iter().filter_map(finding).collect()
    }

    /// Compares simulations with the measurements of this calibration.
    fn validation(
        &self,
        start: &[f64],
        x: &[f64],
        mut stats: Stats,
        n_simulations: usize,
        context: &RunContext<'_>,
    ) -> Result<Validation, CalibrationError> {
        let end = PointResiduals { x: x.to_vec(), residuals: self.residuals(x, context)? };
        let residuals = self.residuals_with(None, start, RobustLoss::default(), context, &mut stats)?;
        let start = residuals.map(|residuals| PointResiduals { x: start.to_vec(), residuals });
        let fits = self.output_fits(&end, start.as_ref());
        let outputs = self.residual_layout().outputs.iter().zip(fits).map(|(output, fit)| {
            let plain = |of: &PointResiduals| output.differences(&of.residuals);
            ValidatedOutput {
                fit,
                times: output.times.to_vec(),
                measured: output.measured_values(),
                residuals: plain(&end),
                start_residuals: start.as_ref().map(plain),
            }
        });
        let n = self.n_measurements();
        let rms =
            |of: &PointResiduals| (of.residuals[..n].iter().map(|r| r * r).sum::<f64>() / n as f64).sqrt();
        Ok(Validation {
            names: self.parameters().iter().map(|p| p.name().to_owned()).collect(),
            x: x.to_vec(),
            outputs: outputs.collect(),
            n,
            time_unit: self.fmu().description().time_unit().to_owned(),
            rms: rms(&end),
            start_rms: start.as_ref().map(rms),
            fitted: Vec::new(),
            findings: Vec::new(),
            n_simulations: n_simulations + 2,
            stats,
        })
    }

    /// Returns the indices of the entries of another problem that this one does not contain: local
    /// parameters, and parameters that act only in other experiments than those of this problem.
    fn not_shared(&self, other: &Calibration) -> Result<Vec<usize>, CalibrationError> {
        let own = self.problem().elements()?;
        let is_known = |e: &Element| {
            e.experiment.is_none()
                && own.iter().any(|o| o.experiment.is_none() && o.parameter.name() == e.parameter.name())
        };
        let elements = other.problem().elements()?;
        Ok((0..elements.len()).filter(|&i| !is_known(&elements[i])).collect())
    }

    /// Returns values for another problem with the same parameters. Shared values are taken from `x`, and
    /// local values are the start values of the other problem.
    fn carried(&self, other: &Calibration, x: &[f64]) -> Result<Vec<f64>, CalibrationError> {
        let elements = self.problem().elements()?;
        let shared =
            |name: &str| elements.iter().position(|e| e.experiment.is_none() && e.parameter.name() == name);
        let value = |(i, e): (usize, &Element)| match shared(e.parameter.name()) {
            Some(k) if e.experiment.is_none() => x[k],
            _ => other.parameters()[i].start(),
        };
        Ok(other.problem().elements()?.iter().enumerate().map(value).collect())
    }
}
