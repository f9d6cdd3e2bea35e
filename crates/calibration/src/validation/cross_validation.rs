//! Cross-validation by recording: fits that leave out some of the recordings, each validated on these
//! recordings.

use crate::cost::parallel;
use crate::error::CalibrationError;
use crate::findings::display_text::{digits, visible_line};
use crate::fit::one_stage::{Fit, FitOptions, NoiseRule};
use crate::loaded::calibration::Calibration;
use crate::problem::experiment::Experiment;
use crate::problem::objective::CostKind;
use crate::problem::parameter::Parameter;
use crate::validation::held_out::{Validation, ValidationSet};
use base::{Number, RunContext};
use dfo::{AnyMethod, Record, RobustLoss, RunOptions};
use ode::Stats;
use std::fmt;
use std::time::Duration;

/// Options of a cross-validation.
#[derive(Debug, Clone)]
pub struct CrossValidationOptions {
    /// Number of folds k. Each fold holds out every k-th recording. Default: the number of recordings, so
    /// that each fold holds out one recording.
    pub folds: Option<usize>,
    /// Options of each fit. The fits run in parallel and share the `workers` (default: all cores). The limit
    /// `max_time` applies to all fits together, and folds that exceed it are omitted. Checkpoints are not
    /// written.
    pub run: RunOptions<AnyMethod>,
    /// Loss function: the contribution of a residual to the cost.
    pub loss: RobustLoss,
    /// Cost to minimise. It must be a named cost if local parameters are fitted to recordings that are held
    /// out.
    pub objective: CostKind,
    /// Source of the noise of the measurements, see [`FitOptions::noise`]; estimated in each fold.
    pub noise: NoiseRule,
}

impl Default for CrossValidationOptions {
    fn default() -> Self {
        let (loss, objective, noise) = (RobustLoss::default(), CostKind::default(), NoiseRule::default());
        Self { folds: None, run: FitOptions::default_run(), loss, objective, noise }
    }
}

impl CrossValidationOptions {
    /// Returns the options of a record for fits of `n` parameters: `folds` and the fields of
    /// [`FitOptions::from_record`].
    ///
    /// # Errors
    /// Returns an error if an option is unknown or has an invalid value.
    pub fn from_record(mut record: Record, n: usize) -> Result<Self, dfo::Error> {
        let folds = record.remove("folds").map_or(Ok(None), |folds| folds.read_limit("folds", 0))?;
        let FitOptions { run, loss, objective, noise, .. } = FitOptions::from_record(record, n)?;
        Ok(Self { folds, run, loss, objective, noise })
    }
}

/// A fold: the recordings held out, the fit to the others, and its validation.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Fold {
    /// Names of the recordings held out.
    pub held_out: Vec<String>,
    /// Fit to the other recordings.
    pub fit: Fit,
    /// Root mean square of the weighted residuals of the fitted recordings. It uses plain residuals with
    /// every loss, like the validation.
    pub fit_rms: f64,
    /// Validation of the fit on the recordings held out.
    pub validation: Validation,
}

/// A cross-validation. `Display` prints a table.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CrossValidation {
    /// Finished folds.
    pub folds: Vec<Fold>,
    /// Names of the recordings that unfinished folds would have held out; the time limit did not suffice for
    /// these folds.
    pub unfinished: Vec<Vec<String>>,
    /// Root mean square of the weighted residuals of all recordings, each from the fold that held it out.
    pub rms: f64,
    /// Shared parameters: name, mean over the folds, standard deviation between the folds.
    pub parameters: Vec<(String, f64, f64)>,
    /// Statistics of all simulations.
    pub stats: Stats,
}

impl Calibration {
    /// Fits without some of the recordings and validates on these recordings; by default, each recording is
    /// left out once. A fit that describes the machine predicts a recording as well as it reproduces the
    /// fitted recordings. Its parameters are also similar, whichever recording is left out.
    /// [Local](crate::Parameter::local) parameters of a recording that is held out, and parameters that act
    /// in no other recording, are not predicted: they are fitted to the recording while all others are held,
    /// and [`Validation::fitted`] lists them.
    ///
    /// # Errors
    /// Returns an error if there are fewer than two recordings, the number of folds is invalid, or a fit
    /// fails. Returns an error if the time limit expires before the first fold is complete.
    pub fn cross_validate(
        &self,
        options: &CrossValidationOptions,
        context: &RunContext<'_>,
    ) -> Result<CrossValidation, CalibrationError> {
        let _held = self.hold();
        let setup = |message: String| Err(CalibrationError::Setup(message));
        let n = self.problem().experiments.len();
        if n < 2 {
            return setup(
                "a cross-validation requires at least two experiments, but there is one. Fit in a window, and validate on the rest"
                    .to_owned(),
            );
        }
        let k = options.folds.unwrap_or(n);
        if !(2..=n).contains(&k) {
            return setup(format!("folds = {k} must be from 2 to the number of recordings, {n}"));
        }
        let acts_in = |name: &str| self.problem().parameters.iter().any(|p| p.acts_in(name));
        if let Some(name) = self.problem().experiment_names().iter().find(|name| !acts_in(name)) {
            return setup(format!(
                "no parameter acts in {name}, so a fit of the others does not predict it. Leave this recording out"
            ));
        }
        if context.is_cancelled() {
            return Err(CalibrationError::Cancelled);
        }
        self.prepare()?;
        let workers = options.run.workers.unwrap_or_else(base::available_cores);
        let end = context.within(options.run.limits.max_time).end();
        let task = |fold: usize, context: &RunContext<'_>| {
            let context = context.until(end);
            let mut run = options.run.clone();
            (run.workers, run.checkpoint) = (Some((workers / k).max(1)), None);
            run.limits.max_time = context.left().map(|left| left.max(Duration::from_millis(1)));
            match self.fold(fold, k, run, options, &context) {
                // A fold that ended at the time limit is unreliable.
                _ if context.is_late() && !context.is_cancelled() => Ok(None),
                fold => fold.map(Some),
            }
        };
        let made = parallel::map(k, workers, context, &task).into_iter();
        let made: Vec<Option<Fold>> =
            made.map(|fold| fold.unwrap_or(Err(CalibrationError::Cancelled))).collect::<Result<_, _>>()?;
        let names = self.problem().experiment_names();
        let unfinished: Vec<Vec<String>> = (made.iter().enumerate().filter(|(_, fold)| fold.is_none()))
            .map(|(fold, _)| names.iter().skip(fold).step_by(k).cloned().collect())
            .collect();
        let folds: Vec<Fold> = made.into_iter().flatten().collect();
        if folds.is_empty() {
            let limit = Number(options.run.limits.max_time.map_or(f64::NAN, |limit| limit.as_secs_f64()));
            return setup(format!(
                "the time limit of {limit} s ended the cross-validation before one of {k} folds was complete. Set a larger limit"
            ));
        }
        let counted: usize = folds.iter().map(|fold| fold.validation.n).sum();
        let sum: f64 =
            folds.iter().map(|f| f.validation.n as f64 * f.validation.rms * f.validation.rms).sum();
        let mut stats = Stats::default();
        for fold in &folds {
            stats += fold.fit.stats;
            stats += fold.validation.stats;
        }
        let shared = self.problem().parameters.iter().filter(|p| !p.is_local());
        let spread = |p: &Parameter| {
            let name = p.name();
            let of = |fit: &Fit| fit.names.iter().position(|n| n == name).map(|i| fit.x[i]);
            let found: Vec<f64> = folds.iter().filter_map(|fold| of(&fold.fit)).collect();
            let values: Vec<f64> = found.iter().map(|x| p.nearest_to(found[0], *x)).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
            (name.to_owned(), mean, (squares / (values.len() as f64 - 1.0)).sqrt())
        };
        let parameters = shared.map(spread).collect();
        Ok(CrossValidation { rms: (sum / counted as f64).sqrt(), parameters, stats, folds, unfinished })
    }

    /// Fits without the recordings of a fold and validates on them.
    fn fold(
        &self,
        fold: usize,
        k: usize,
        run: RunOptions<AnyMethod>,
        options: &CrossValidationOptions,
        context: &RunContext<'_>,
    ) -> Result<Fold, CalibrationError> {
        let mut problem = self.problem().clone();
        let (mut held_out, mut kept) = (Vec::new(), Vec::new());
        for ((i, mut experiment), name) in
            problem.experiments.drain(..).enumerate().zip(self.problem().experiment_names())
        {
            // The name is fixed, because a default name by position would change among the
            // remaining experiments.
            experiment.name = Some(name);
            if i % k == fold { held_out.push(experiment) } else { kept.push(experiment) }
        }
        let named = |experiments: &[Experiment]| -> Vec<String> {
            experiments.iter().filter_map(|experiment| experiment.name.clone()).collect()
        };
        problem.parameters = self.problem().acting_in(&named(&kept));
        problem.experiments = kept;
        problem.drop_foreign_constraints()?;
        let names = named(&held_out);
        let without = |source| CalibrationError::Experiment {
            name: format!("without {}", names.join(", ")),
            source: Box::new(source),
        };
        let fitted = self.derived(problem).map_err(without)?;
        let fit = fitted
            .fit(FitOptions {
                run,
                loss: options.loss,
                objective: options.objective.clone(),
                noise: options.noise,
                context: *context,
                uncertainty: None,
                ..FitOptions::default()
            })
            .map_err(without)?;
        if context.is_over() {
            return Err(CalibrationError::Cancelled);
        }
        let set = ValidationSet::Experiments(held_out);
        let validation = fitted.validate_with(&fit, &set, self.problem().acting_in(&names), context);
        let mut validation = validation.map_err(without)?;
        let mut fit_rms = fit.rms;
        if !options.loss.is_linear() {
            let (objective, stats) = (&options.objective, &mut validation.stats);
            let found = fitted.cost_and_residuals(&fit.x, objective, RobustLoss::default(), context, stats);
            validation.n_simulations += 1;
            fit_rms = found.map_or(f64::NAN, |(_, r)| fitted.rms_of(&r, fitted.residual_layout(), None));
        }
        Ok(Fold { held_out: names, fit, fit_rms, validation })
    }
}

impl fmt::Display for CrossValidation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = |text: &str| visible_line(text).into_owned();
        let held_out: Vec<String> = self.folds.iter().map(|fold| line(&fold.held_out.join(", "))).collect();
        let width = held_out.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(8);
        let columns: Vec<usize> =
            self.parameters.iter().map(|(name, ..)| line(name).chars().count().max(10)).collect();
        write!(f, "{:<width$}  {:>10}  {:>10}", "held out", "RMS", "RMS of fit")?;
        for ((name, ..), column) in self.parameters.iter().zip(&columns) {
            write!(f, "  {:>column$}", line(name))?;
        }
        for (fold, name) in self.folds.iter().zip(&held_out) {
            let [rms, of_fit] = [fold.validation.rms, fold.fit_rms].map(|rms| digits(rms).to_string());
            write!(f, "\n{name:<width$}  {rms:>10}  {of_fit:>10}")?;
            for ((name, ..), column) in self.parameters.iter().zip(&columns) {
                let value = fold.fit.names.iter().position(|n| n == name).map(|i| fold.fit.x[i]);
                let value = value.map_or_else(String::new, |value| digits(value).to_string());
                write!(f, "  {value:>column$}")?;
            }
        }
        write!(f, "\n{:<width$}  {:>10}  {:>10}", "mean", digits(self.rms).to_string(), "")?;
        for ((_, mean, _), column) in self.parameters.iter().zip(&columns) {
            write!(f, "  {:>column$}", digits(*mean).to_string())?;
        }
        write!(f, "\n{:<width$}  {:>10}  {:>10}", "spread", "", "")?;
        for ((.., spread), column) in self.parameters.iter().zip(&columns) {
            write!(f, "  {:>column$}", digits(*spread).to_string())?;
        }
        let fitted = self.folds.iter().flat_map(|fold| &fold.validation.fitted).map(|name| line(name));
        let fitted: Vec<String> = fitted.collect();
        if !fitted.is_empty() {
            let fitted = fitted.join(", ");
            write!(
                f,
                "\nnot predicted but fitted to the omitted recording, which alone determines them: {fitted}"
            )?;
        }
        for held_out in &self.unfinished {
            write!(f, "\n{}: not complete in time", line(&held_out.join(", ")))?;
        }
        Ok(())
    }
}
