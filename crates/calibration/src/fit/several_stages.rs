//! Fits in stages. Each stage frees some of the parameters, fixes the others, and starts from the result of
//! the previous stage.

use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Origin};
use crate::findings::identifier::FindingId;
use crate::fit::one_stage::{
    FinalSearch, Fit, FitObserver, FitOptions, Job, SearchResult, UsedLimits, add_earlier, checkpoint_of,
    ended_by,
};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::FitPhase;
use crate::loaded::budget::Extra;
use crate::loaded::calibration::Calibration;
use crate::uncertainty::inactive_parameters::InactiveParameters;
use base::RunContext;
use dfo::{
    AnyMethod, Limits, Progress, Record, Report, RequestedRun, RunOptions, Termination, Tolerances, Value,
    field_names, read_part,
};
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;

/// One stage of a fit.
///
/// ```
/// use calibration::Stage;
/// use calibration::dfo::NelderMead;
/// let walls = Stage::new(["C2", "G2"]).window(0.0, 600.0).method(NelderMead::default());
/// assert_eq!(walls.parameters, ["C2", "G2"]);
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stage {
    /// Names of the free parameters. `T0` frees all values of a [local](crate::Parameter::local) parameter,
    /// and `T0[run1]` frees one of them. The other parameters keep their values.
    pub parameters: Vec<String>,
    /// Windows in s that select the measurements of this stage, in all experiments. If empty, the stage uses
    /// the measurements that count in the calibration.
    pub windows: Vec<(f64, f64)>,
    /// Method of the stage; default: the method of the fit.
    pub method: Option<AnyMethod>,
    /// Reason for the choice of the method if the user did not choose one.
    pub method_reason: Option<String>,
    /// Limits of this stage. The limits of the fit apply to all stages together.
    pub limits: Limits,
    /// Tolerances of the termination tests of this stage; default: the tolerances of the fit.
    pub tolerances: Option<Tolerances>,
}

impl Stage {
    /// Creates a stage that frees these parameters.
    pub fn new<S: Into<String>>(parameters: impl IntoIterator<Item = S>) -> Self {
        Self { parameters: parameters.into_iter().map(Into::into).collect(), ..Self::default() }
    }

    /// Adds a window. Only measurements in `[from, to]` and in the other windows count in this stage.
    #[must_use]
    pub fn window(mut self, from: f64, to: f64) -> Self {
        self.windows.push((from, to));
        self
    }

    /// Sets the method of this stage.
    #[must_use]
    pub fn method(mut self, method: impl Into<AnyMethod>) -> Self {
        self.method = Some(method.into());
        self
    }

    /// Sets the limits of this stage.
    #[must_use]
    pub fn limits(mut self, limits: Limits) -> Self {
        self.limits = limits;
        self
    }

    /// Sets the tolerances of this stage.
    #[must_use]
    pub fn tolerances(mut self, tolerances: Tolerances) -> Self {
        self.tolerances = Some(tolerances);
        self
    }
}

impl Stage {
    /// Creates a stage of a fit of `n` parameters from a record. The record contains `parameters`, `windows`
    /// and the options of the run. `workers` is the number of workers of the fit, which determines the batch
    /// plan.
    ///
    /// # Errors
    /// Returns an error if an option does not exist or its value is invalid.
    pub fn from_record(record: Record, n: usize, workers: Option<usize>) -> Result<Self, dfo::Error> {
        let (of_stage_record, of_run) = read_part::<StageRecord>(record, "option of a stage")?;
        let default = RunOptions { workers, ..FitOptions::default_run() };
        let run = RequestedRun::new(default, &of_run, n)?.options;
        let (method, tolerances) = (Some(run.method), Some(run.tolerances));
        let StageRecord { parameters, windows } = of_stage_record;
        Ok(Self { parameters, windows, method, limits: run.limits, tolerances, method_reason: None })
    }

    /// Returns the names of all options that a record of a stage may contain.
    ///
    /// # Errors
    /// Returns an error if the options of a method cannot be serialised.
    pub fn option_names() -> Result<BTreeSet<String>, dfo::Error> {
        let mut names = RequestedRun::option_names()?;
        names.extend(field_names::<StageRecord>()?);
        Ok(names)
    }
}

/// Options of a stage by name, without the options of its run.
#[derive(Debug, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct StageRecord {
    /// Names of the free parameters.
    parameters: Vec<String>,
    /// Windows in s, each with its start and end. Only measurements in one of these windows count.
    windows: Vec<(f64, f64)>,
}

/// Returns the finding about stages without a test of all parameters together.
fn untested() -> Finding {
    let sentence = "all parameters together were not tested, because there are no standard errors. The values of each stage depend on \
                    the parameters that it held fixed";
    let remedy = "Add a last stage with all parameters";
    Finding::warning(FindingId::StagesApart, "stages", sentence, remedy).of(Origin::Search)
}

/// Returns the smaller of two limits.
fn least<T: PartialOrd>(a: Option<T>, b: Option<T>) -> Option<T> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b < a { b } else { a }),
        (a, b) => a.or(b),
    }
}

/// Limits of a fit that remain after its first stages.
#[derive(Debug, Clone, Copy)]
struct Left {
    spent: UsedLimits,
    limits: Limits,
}

impl Left {
    fn after(fits: &[Fit], limits: &Limits, context: &RunContext<'_>) -> Self {
        let spent = UsedLimits {
            n_evaluations: fits.iter().map(|fit| fit.report.n_evaluations).sum(),
            n_iterations: fits.iter().map(|fit| fit.report.n_iterations).sum(),
            seconds: context.elapsed().as_secs_f64(),
        };
        let limits = Limits {
            max_evaluations: limits.max_evaluations.map(|n| n.saturating_sub(spent.n_evaluations)),
            max_iterations: limits.max_iterations.map(|n| n.saturating_sub(spent.n_iterations)),
            max_time: context.left(),
            ..*limits
        };
        Self { spent, limits }
    }

    /// Returns the limit that is used up.
    fn reached(&self) -> Option<Termination> {
        match (self.limits.max_evaluations, self.limits.max_iterations, self.limits.max_time) {
            (Some(0), ..) => Some(Termination::MaxEvaluations),
            (_, Some(0), _) => Some(Termination::MaxIterations),
            (.., Some(time)) if time.is_zero() => Some(Termination::MaxTime),
            _ => None,
        }
    }

    /// Returns the run of a stage. Also returns the stage's own time limit if it is shorter than the time
    /// left.
    fn run(&self, run: &RunOptions<AnyMethod>, stage: &Stage) -> (RunOptions<AnyMethod>, Option<Duration>) {
        let mut run_of_stage = run.clone();
        // The message of the stage reports the limit that ends the stage.
        let of_stage =
            stage.limits.max_time.filter(|limit| self.limits.max_time.is_none_or(|time| *limit < time));
        if let Some(method) = &stage.method {
            (run_of_stage.method, run_of_stage.method_reason) = (method.clone(), stage.method_reason.clone());
        }
        run_of_stage.tolerances = stage.tolerances.unwrap_or(run.tolerances);
        run_of_stage.limits = Limits {
            max_failed: run_of_stage.limits.max_failed,
            max_evaluations: least(stage.limits.max_evaluations, self.limits.max_evaluations),
            max_iterations: least(stage.limits.max_iterations, self.limits.max_iterations),
            max_time: of_stage.or(run.limits.max_time),
            // A target for the whole fit does not apply to a single window.
            target: stage.limits.target.or(run.limits.target.filter(|_| stage.windows.is_empty())),
        };
        (run_of_stage, of_stage)
    }
}

/// Completed stages.
#[derive(Default)]
struct Done {
    fits: Vec<Fit>,
    /// Residuals at the start of the first stage and at the end of the last stage, with weights and loss.
    at_start: Option<Vec<f64>>,
    at_end: Option<Vec<f64>>,
    /// Reason why the next stage did not run.
    ended: Option<Termination>,
}

/// Wraps an error of a stage, which is numbered from 0.
fn in_stage(k: usize) -> impl Fn(CalibrationError) -> CalibrationError {
    move |source| CalibrationError::Stage { number: k + 1, source: Box::new(source) }
}

/// Returns the parameters that ended at a bound or had no effect in the last stage that freed them.
fn inactive_in_all(fits: &[Fit], freed: &[Vec<usize>]) -> InactiveParameters {
    let mut all = InactiveParameters::default();
    for (fit, freed) in fits.iter().zip(freed) {
        all.at_bound.retain(|(i, _)| !freed.contains(i));
        all.without_effect.retain(|i| !freed.contains(i));
        all.at_bound.extend(&fit.at_bound);
        all.without_effect.extend(&fit.without_effect);
        all.n_checks += fit.n_checks;
    }
    all.at_bound.sort_by_key(|(i, _)| *i);
    all.without_effect.sort_unstable();
    all
}

/// Returns the report of the last stage with the counts of all stages. Its trace joins the trailing stages
/// that have the same windows and the same noise.
fn report_of_all(stages: &[Stage], fits: &[Fit], ended: Option<&Termination>) -> Report {
    let (n, last) = (fits.len(), &fits[fits.len() - 1]);
    let mut report = last.report.clone();
    // The Jacobian of a stage treats the parameters of other stages as known.
    (report.jacobian, report.active) = (None, Vec::new());
    let of_stage = |k: usize, message: &str| format!("stage {} of {}: {message}", k + 1, stages.len());
    report.message = of_stage(n - 1, &report.message);
    for (k, Fit { report: before, .. }) in fits[..n - 1].iter().enumerate().rev() {
        add_earlier(&mut report, before);
        if report.is_success() {
            report.termination.clone_from(&before.termination);
            report.tests = before.tests;
        }
        report.message = format!("{}; {}", of_stage(k, &before.message), report.message);
    }
    let is_same = |k: usize| stages[k].windows == stages[n - 1].windows && fits[k].noise == last.noise;
    let first = (0..n).rev().take_while(|k| is_same(*k)).last().unwrap_or(0);
    let mut traces = fits[first..].iter().map(|fit| fit.report.trace.clone());
    if let Some(mut trace) = traces.next() {
        traces.for_each(|later| trace.append(later));
        report.trace = trace;
    }
    if let Some(termination) = ended {
        report.message += &format!("; the fit ended before stage {}: {termination}", n + 1);
        report.termination = termination.clone();
    }
    report
}

impl Calibration {
    /// Fits in stages. Each stage frees its parameters, fixes the others, and starts from the result of the
    /// previous stage. Parameters that no stage frees keep their start values.
    ///
    /// The limits of the fit (evaluations, iterations, time, target) apply to all stages together. An
    /// interrupt or an observer can also end the whole fit. A stage may have separate limits; if it reaches
    /// one of them, the next stage begins.
    ///
    /// The result is the result of the last stage, with the evaluations, simulations and the trace of all
    /// stages. It is a success if all stages succeeded and all freed parameters together are at a minimum.
    /// One least-squares step in all of them tests this, with the standard errors. Without standard errors,
    /// a finding reports that it was not tested. [`Fit::stages`] contains the fit of each stage. A
    /// stage with its own window minimises a different cost. In this case, the costs of the result are
    /// computed again on the measurements of the calibration. The trace then contains only the last stages
    /// that share one window.
    ///
    /// A checkpoint has one file per stage: `fit.ckpt.stage1`, `fit.ckpt.stage2` and so on.
    ///
    /// The covariance of a method at the end of a stage ([`dfo::Report::covariance`]) is conditional because
    /// it treats the fixed parameters as known. The [uncertainty](Fit::uncertainty) of a stage is also
    /// conditional. The report of the result therefore contains no Jacobian; only the reports of the stages
    /// do. The uncertainty of the result covers all parameters that any stage freed.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::fit`]. Also returns an error if there are no stages, a stage has
    /// no parameters, a name is not a parameter, or a named parameter is fixed.
    pub fn fit_stages<'a>(
        &self,
        stages: &[Stage],
        options: impl Into<FitOptions<'a>>,
    ) -> Result<Fit, CalibrationError> {
        let _held = self.hold();
        let mut job = Job::new(self, options.into(), None)?;
        let freed = self.all_checked(stages, &job)?;
        let mut stats = Stats::default();
        let tolerance = self.choose_tolerance(&job);
        let with_tolerance = self.with_tolerance(tolerance.as_ref())?;
        let calibration = with_tolerance.as_ref().unwrap_or(self);
        job.enter(FitPhase::Checks, &stats);
        let done = calibration.in_turn(stages, &freed, &job)?;
        job.phases.borrow_mut().begin(FitPhase::Checks, &stats);
        let is_freed = |i: &usize| freed.iter().any(|freed| freed.contains(i));
        job.held = (0..job.start.len()).filter(|i| !is_freed(i)).collect();
        job.is_whole = true;
        let mut made = calibration.all_in_one(stages, &freed, &done, &job, &mut stats)?;
        made.searched.raised.extend(tolerance.and_then(|chosen| chosen.finding()));
        made.tolerance = tolerance;
        job.enter(FitPhase::Checks, &stats);
        for fit in &done.fits {
            stats += fit.stats;
            job.phases.borrow_mut().add(&fit.phases);
        }
        job.phases.borrow_mut().begin(FitPhase::Checks, &stats);
        let fitted = made.fitted_calibration.take();
        let last = done.fits.len() - 1;
        let is_joint =
            stages[last].windows.is_empty() && freed.iter().flatten().all(|i| freed[last].contains(i));
        let budget = match is_joint {
            true => made.budget(),
            false => made.budget().requiring(Extra::ShorterSteps),
        };
        let (mut fit, _) =
            calibration.assessed(fitted.as_ref().unwrap_or(calibration), &job, made, stats, budget);
        fit.phases = job.phases.borrow_mut().costs(&fit.stats);
        fit.stages = done.fits;
        match &mut fit.uncertainty {
            _ if is_joint => {}
            Some(uncertainty) => uncertainty.found_in_stages(),
            None if fit.report.is_success() => fit.setup_findings.push(untested()),
            None => {}
        }
        fit.note_end_before_minimum();
        Ok(fit)
    }

    /// Runs the stages in order, each from the end of the previous stage.
    fn in_turn(
        &self,
        stages: &[Stage],
        freed: &[Vec<usize>],
        job: &Job<'_>,
    ) -> Result<Done, CalibrationError> {
        let mut done = Done::default();
        let windowed = (stages.iter().enumerate())
            .map(|(k, stage)| match stage.windows.is_empty() {
                true => Ok(None),
                false => self.windowed(&stage.windows).map(Some).map_err(in_stage(k)),
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut observer = job.observer.borrow_mut();
        for (k, stage) in stages.iter().enumerate() {
            let left = Left::after(&done.fits, &job.run.limits, &job.context);
            done.ended = left.reached().filter(|_| k > 0);
            if done.ended.is_some() {
                break;
            }
            let (mut run, of_stage) = left.run(&job.run, stage);
            let part = format!(".stage{}", k + 1);
            run.checkpoint = job.run.checkpoint.as_ref().map(|c| checkpoint_of(c, &part, k == 0));
            let within = if of_stage.is_some() { job.context.within(of_stage) } else { job.context };
            let options = FitOptions {
                run,
                start: Some(done.fits.last().map_or_else(|| job.start.clone(), |fit| fit.x.clone())),
                held: (0..job.start.len()).filter(|i| !freed[k].contains(i)).collect(),
                cutoffs: job.cutoffs,
                objective: job.objective.clone(),
                loss: job.loss,
                noise: job.noise,
                preflight: job.has_preflight && k == 0,
                uncertainty: job.uncertainty.clone(),
                observer: observer.as_mut().map(|observer| {
                    Box::new(move |progress: &Progress<'_>| observer(&left.spent.before(progress)))
                        as Box<FitObserver<'_>>
                }),
                context: job.context,
                engine: job.engine.clone(),
                phase: job.phases.borrow().reported(),
                live: job.live.clone(),
            };
            let (mut fit, kept) =
                match windowed[k].as_ref().unwrap_or(self).fit_and_keep(options, Some(within)) {
                    Ok(fitted) => fitted,
                    // Keep the results of the earlier stages.
                    Err(error) => match ended_by(&error).filter(|_| k > 0) {
                        Some(termination) => {
                            done.ended = Some(termination);
                            break;
                        }
                        None => return Err(in_stage(k)(error)),
                    },
                };
            // The stage had no time for a single evaluation.
            if k > 0 && fit.cost.is_nan() && job.context.is_late() {
                done.ended = Some(fit.report.termination);
                break;
            }
            let termination = &fit.report.termination;
            let is_last = termination.cause().is_request()
                || (*termination.ended() == Termination::Target && stage.limits.target.is_none());
            if k == 0 {
                done.at_start = kept.at_start().map(<[f64]>::to_vec);
            }
            done.at_end = kept.at(&fit.x).map(<[f64]>::to_vec);
            let stage_record =
                StageRecord { parameters: stage.parameters.clone(), windows: stage.windows.clone() };
            let names = Stage::option_names()?;
            // The other options belong to the whole fit.
            fit.options.retain(|name, _| names.contains(name));
            if let Value::Record(stage_record) = Value::of(&stage_record)? {
                fit.options.extend(stage_record);
            }
            done.fits.push(fit);
            if is_last {
                break;
            }
        }
        Ok(done)
    }

    /// Combines the stages into one search, with the weights of the last stage. Computes the cost at the
    /// start and at the end again if the first or the last stage minimised a different cost.
    fn all_in_one(
        &self,
        stages: &[Stage],
        freed: &[Vec<usize>],
        done: &Done,
        job: &Job<'_>,
        stats: &mut Stats,
    ) -> Result<FinalSearch, CalibrationError> {
        let Done { fits, ended, .. } = done;
        let (first, last) = (&fits[0], &fits[fits.len() - 1]);
        let weighed = self.with_noise(last.noise.as_ref())?;
        let fitted = weighed.as_ref().unwrap_or(self);
        let (mut report, mut inactive) =
            (report_of_all(stages, fits, ended.as_ref()), inactive_in_all(fits, freed));
        let uses_final_noise = |k: usize| stages[k].windows.is_empty() && fits[k].noise == last.noise;
        let mut evaluated = |x: &[f64]| {
            inactive.n_checks += 1;
            fitted.cost_and_residuals(x, &job.objective, job.loss, &job.context, stats)
        };
        let reweighed = |residuals: &Option<Vec<f64>>| {
            residuals.as_deref().map(|r| fitted.residual_layout().reweighed(r, self.residual_layout()))
        };
        let at_end = match uses_final_noise(fits.len() - 1) {
            true => reweighed(&done.at_end),
            false => {
                let (cost, at_end) = evaluated(&last.x).unzip();
                (report.fun, report.residuals) = (cost.unwrap_or(f64::NAN), None);
                at_end
            }
        };
        let (start_cost, at_start) = match uses_final_noise(0) {
            true => (first.start_cost, reweighed(&done.at_start)),
            false => evaluated(&job.start).unzip(),
        };
        let held = job.held.iter().filter(|i| !self.parameters()[**i].is_fixed());
        let names: Vec<&str> = held.map(|i| last.names[*i].as_str()).collect();
        let mut raised = last.setup_findings.clone();
        if !names.is_empty() {
            let names = names.join(", ");
            let sentence = format!("no stage frees {names}, which remain at the start values");
            raised.push(Finding::note(FindingId::UnusedParameter, names, sentence, ""));
        }
        let searched = SearchResult {
            residuals: KeptResiduals::new(&job.start, at_start).with(&report.x, at_end.as_deref()),
            report,
            inactive,
            start_cost,
            preflight: first.preflight.clone(),
            tolerances: job.run.tolerances,
            raised,
        };
        Ok(FinalSearch { fitted_calibration: weighed, searched, noise: last.noise.clone(), tolerance: None })
    }

    /// Checks the arguments of [`fit`](Self::fit), or of [`fit_stages`](Self::fit_stages) if there are
    /// stages, without a simulation. Use it before costly preparations for a fit.
    ///
    /// # Errors
    /// Returns the errors that these functions return for invalid arguments.
    pub fn check_fit<'a>(
        &self,
        stages: Option<&[Stage]>,
        options: impl Into<FitOptions<'a>>,
    ) -> Result<(), CalibrationError> {
        let mut job = Job::new(self, options.into(), None)?;
        match stages {
            Some(stages) => self.all_checked(stages, &job).map(|_| ()),
            None => self.choose_method(&mut job.run, &job.start, &job.held, &job.objective),
        }
    }

    /// Returns the entries of `x` that each stage frees.
    fn all_checked(&self, stages: &[Stage], job: &Job<'_>) -> Result<Vec<Vec<usize>>, CalibrationError> {
        if stages.is_empty() {
            return Err(CalibrationError::Setup("stages is empty. Specify at least one stage".to_owned()));
        }
        let freed = stages.iter().enumerate();
        freed.map(|(k, stage)| self.checked(stage, job).map_err(in_stage(k))).collect()
    }

    /// Returns the entries of `x` that a stage frees, after checking that its method can fit them.
    fn checked(&self, stage: &Stage, job: &Job<'_>) -> Result<Vec<usize>, CalibrationError> {
        let freed = self.freed(stage, &job.held)?;
        let held: Vec<usize> = (0..job.start.len()).filter(|i| !freed.contains(i)).collect();
        let method = stage.method.clone().unwrap_or_else(|| job.run.method.clone());
        let mut run = RunOptions { method, ..RunOptions::default() };
        self.choose_method(&mut run, &job.start, &held, &job.objective)?;
        Ok(freed)
    }

    /// Returns the entries of `x` that a stage frees.
    fn freed(&self, stage: &Stage, held: &[usize]) -> Result<Vec<usize>, CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        if stage.parameters.is_empty() {
            return setup("the stage has no parameters. Specify at least one".to_owned());
        }
        let mut freed: Vec<usize> = Vec::new();
        for name in &stage.parameters {
            let entries = self.entries_of(name);
            if entries.is_empty() {
                let names = self.parameters().iter().map(|p| p.name());
                let names = names.collect::<Vec<_>>().join(", ");
                return setup(format!("parameter '{name}' not found; available: {names}"));
            }
            if entries.iter().all(|&i| self.parameters()[i].is_fixed() || held.contains(&i)) {
                return setup(format!("parameter '{name}' is fixed, so a stage cannot free it"));
            }
            if entries.iter().any(|i| freed.contains(i)) {
                return setup(format!("parameter '{name}' is listed twice"));
            }
            freed.extend(entries.iter().filter(|i| !held.contains(i)));
        }
        Ok(freed)
    }

    /// Returns the entries of `x` with this name: one entry, or all entries of a local parameter.
    pub(crate) fn entries_of(&self, name: &str) -> Vec<usize> {
        let is_local = self.problem().parameters.iter().any(|p| p.is_local() && p.name() == name);
        let is_it = |entry: &str| {
            entry == name || (is_local && entry.strip_prefix(name).is_some_and(is_in_experiment))
        };
        let entries = self.parameters().iter().enumerate();
        entries.filter(|(_, p)| is_it(p.name())).map(|(i, _)| i).collect()
    }
}

/// True if the string is the experiment suffix of the name of a local parameter.
fn is_in_experiment(rest: &str) -> bool {
    rest.starts_with('[') && rest.ends_with(']')
}
