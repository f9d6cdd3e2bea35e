//! Fits in stages: each frees some of the parameters, holds the others, and starts from the result of the
//! last.

use crate::cost::calibration::Calibration;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::FitPhase;
use crate::fit::stage::{Fit, FitOptions, add_earlier, checkpoint_of, ended_by};
use crate::uncertainty::active_bounds::{Findings, is_over};
use crate::uncertainty::estimate::UncertaintyOptions;
use base::RunContext;
use dfo::{AnyMethod, AskedRun, Limits, Progress, Record, RunOptions, Termination, Tolerances};
use ode::Stats;
use std::sync::Arc;
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
    /// The parameters that it frees, by name: all values of a [local](crate::Parameter::local) one (`T0`), or
    /// one of them (`T0[run1]`). The others stay where they are.
    pub parameters: Vec<String>,
    /// Only measurements in these count in this stage, in all experiments, in s; none: those that count in
    /// the calibration.
    pub windows: Vec<(f64, f64)>,
    /// The method; default: that of the fit.
    pub method: Option<AnyMethod>,
    /// Why it was chosen, where the user left it open.
    pub method_reason: Option<String>,
    /// Limits of this stage; those of the fit hold for all stages together.
    pub limits: Limits,
    /// When the tests of this stage pass; default: as in the fit.
    pub tolerances: Option<Tolerances>,
}

impl Stage {
    /// Frees these parameters.
    pub fn new<S: Into<String>>(parameters: impl IntoIterator<Item = S>) -> Self {
        Self { parameters: parameters.into_iter().map(Into::into).collect(), ..Self::default() }
    }

    /// Only measurements in `[from, to]`, and in other windows given so, count in this stage.
    #[must_use]
    pub fn window(mut self, from: f64, to: f64) -> Self {
        self.windows.push((from, to));
        self
    }

    /// A method of its own.
    #[must_use]
    pub fn method(mut self, method: impl Into<AnyMethod>) -> Self {
        self.method = Some(method.into());
        self
    }

    /// Limits of its own.
    #[must_use]
    pub fn limits(mut self, limits: Limits) -> Self {
        self.limits = limits;
        self
    }

    /// Tolerances of its own.
    #[must_use]
    pub fn tolerances(mut self, tolerances: Tolerances) -> Self {
        self.tolerances = Some(tolerances);
        self
    }
}

impl Stage {
    /// A stage of a fit of `n` parameters as a record asks for it: `parameters`, `windows`, and the options
    /// of its run.
    ///
    /// # Errors
    /// An option that there is not, or a value that it cannot have.
    pub fn asked(mut record: Record, n: usize) -> Result<Self, dfo::Error> {
        let mut stage = Self::default();
        if let Some(parameters) = record.remove("parameters") {
            stage.parameters = parameters.read("parameters")?;
        }
        if let Some(windows) = record.remove("windows") {
            stage.windows = windows.read("windows")?;
        }
        let run = AskedRun::new(FitOptions::default_run(), &record, n)?.options;
        (stage.method, stage.limits, stage.tolerances) = (Some(run.method), run.limits, Some(run.tolerances));
        Ok(stage)
    }
}

/// The smaller of two limits.
fn least<T: PartialOrd>(a: Option<T>, b: Option<T>) -> Option<T> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b < a { b } else { a }),
        (a, b) => a.or(b),
    }
}

/// Part of the limits of a fit that its first stages have left.
#[derive(Debug, Clone, Copy)]
struct Left {
    n_evaluations: usize,
    n_iterations: usize,
    limits: Limits,
}

impl Left {
    fn after(fits: &[Fit], limits: &Limits, context: &RunContext<'_>) -> Self {
        let n_evaluations = fits.iter().map(|fit| fit.report.n_evaluations).sum();
        let n_iterations = fits.iter().map(|fit| fit.report.n_iterations).sum();
        let limits = Limits {
            max_evaluations: limits.max_evaluations.map(|n| n.saturating_sub(n_evaluations)),
            max_iterations: limits.max_iterations.map(|n| n.saturating_sub(n_iterations)),
            max_time: context.left(),
            ..*limits
        };
        Self { n_evaluations, n_iterations, limits }
    }

    /// The limit of which nothing is left.
    fn reached(&self) -> Option<Termination> {
        match (self.limits.max_evaluations, self.limits.max_iterations, self.limits.max_time) {
            (Some(0), ..) => Some(Termination::MaxEvaluations),
            (_, Some(0), _) => Some(Termination::MaxIterations),
            (.., Some(time)) if time.is_zero() => Some(Termination::MaxTime),
            _ => None,
        }
    }

    /// The run of a stage, and the stage's own limit of time where that is the shorter one.
    fn run(&self, run: &RunOptions<AnyMethod>, stage: &Stage) -> (RunOptions<AnyMethod>, Option<Duration>) {
        let mut own = run.clone();
        // The limit that ends the stage is the one that its message names.
        let of_stage =
            stage.limits.max_time.filter(|limit| self.limits.max_time.is_none_or(|time| *limit < time));
        if let Some(method) = &stage.method {
            (own.method, own.method_reason) = (method.clone(), stage.method_reason.clone());
        }
        own.tolerances = stage.tolerances.unwrap_or(run.tolerances);
        own.limits = Limits {
            max_failed: own.limits.max_failed,
            max_evaluations: least(stage.limits.max_evaluations, self.limits.max_evaluations),
            max_iterations: least(stage.limits.max_iterations, self.limits.max_iterations),
            max_time: of_stage.or(run.limits.max_time),
            // What a target says of one window says nothing of another.
            target: stage.limits.target.or(run.limits.target.filter(|_| stage.windows.is_empty())),
        };
        (own, of_stage)
    }
}

impl Calibration {
    /// Fits in stages. Each frees its parameters, from where the last stage left them, and holds the others;
    /// those that no stage frees stay at the start.
    ///
    /// Limits of the fit (evaluations, iterations, time, target) hold for all stages together, and so do an
    /// interrupt and an observer that ends the fit; a stage may have limits of its own, at which the next one
    /// begins. The result is that of the last stage, with the evaluations, simulations and the trace of all;
    /// it is a success if all stages were one, and [`Fit::stages`] has the fit of each. A stage with a window
    /// of its own sees other costs: then those of the result are computed once more, on the measurements of
    /// the calibration, and its trace is that of the last stages with one window. A checkpoint has one file
    /// per stage: `fit.ckpt.stage1`, `fit.ckpt.stage2` and so on.
    ///
    /// The covariance of a method at the end of a stage ([`dfo::Report::covariance`]) is conditional: it
    /// takes the held parameters as known, and so does the [uncertainty](Fit::uncertainty) of a stage. So the
    /// result has no Jacobian in its report, only the stages have; its uncertainty is found with all
    /// parameters that any stage freed.
    ///
    /// # Errors
    /// As [`Calibration::fit`]; no stages, stages without parameters, names that are no parameters or those
    /// of fixed ones.
    pub fn fit_stages<'a>(
        &self,
        stages: &[Stage],
        options: impl Into<FitOptions<'a>>,
    ) -> Result<Fit, CalibrationError> {
        let FitOptions {
            run,
            start,
            held,
            cutoffs,
            objective,
            loss,
            noise,
            preflight,
            uncertainty,
            mut observer,
            context,
            engine,
            phase,
        } = options.into();
        let context = context.within(run.limits.max_time);
        let start = start.unwrap_or_else(|| self.start());
        let in_stage =
            |k: usize| move |source| CalibrationError::Stage { number: k + 1, source: Box::new(source) };
        if stages.is_empty() {
            return Err(CalibrationError::Setup("stages: there are none".to_owned()));
        }
        let freed = (stages.iter().enumerate())
            .map(|(k, stage)| self.freed(stage, &held).map_err(in_stage(k)))
            .collect::<Result<Vec<_>, _>>()?;
        for (k, stage) in stages.iter().enumerate() {
            let held: Vec<usize> = (0..start.len()).filter(|i| !freed[k].contains(i)).collect();
            let method = stage.method.clone().unwrap_or_else(|| run.method.clone());
            let mut own = RunOptions { method, ..RunOptions::default() };
            self.choose_method(&mut own, &held, &objective).map_err(in_stage(k))?;
        }
        if let Some(checkpoint) = &run.checkpoint {
            self.adopt_solver(&checkpoint_of(checkpoint, ".stage1", true))?;
        }
        let mut stats = Stats::default();
        // The stages have one solver and one tolerance. Where there is no time for that, the first one ends at its start.
        let chosen = self.solver_counted(&context, &mut stats).and_then(|_| {
            self.choose_tolerance((&start, None), (loss, &run.tolerances), &context, &mut stats)
        });
        let tolerance = match chosen {
            Err(error) if !context.is_late() || context.is_cancelled() => return Err(error),
            chosen => chosen.ok().flatten().map(|(tolerance, _)| tolerance),
        };
        let tolerant = self.with_tolerance(tolerance.as_ref())?;
        let this = tolerant.as_ref().unwrap_or(self);
        let windowed = (stages.iter().enumerate())
            .map(|(k, stage)| match stage.windows.is_empty() {
                true => Ok(None),
                false => this.windowed(&stage.windows).map(Some).map_err(in_stage(k)),
            })
            .collect::<Result<Vec<_>, _>>()?;
        let (mut x, mut fits, mut ended) = (start.clone(), Vec::<Fit>::new(), None);
        let (mut first_kept, mut last_kept) = (KeptResiduals::default(), KeptResiduals::default());
        for (k, stage) in stages.iter().enumerate() {
            let left = Left::after(&fits, &run.limits, &context);
            ended = left.reached().filter(|_| k > 0);
            if ended.is_some() {
                break;
            }
            let (mut own, of_stage) = left.run(&run, stage);
            let part = format!(".stage{}", k + 1);
            own.checkpoint = run.checkpoint.as_ref().map(|c| checkpoint_of(c, &part, k == 0));
            let before = context.elapsed().as_secs_f64();
            let within = if of_stage.is_some() { context.within(of_stage) } else { context };
            let options = FitOptions {
                run: own,
                start: Some(x.clone()),
                held: (0..x.len()).filter(|i| !freed[k].contains(i)).collect(),
                cutoffs,
                objective: objective.clone(),
                loss,
                noise,
                preflight: preflight && k == 0,
                uncertainty: uncertainty.clone(),
                observer: observer.as_mut().map(|observer| {
                    Box::new(move |progress: &Progress<'_>| {
                        let mut progress = *progress;
                        progress.n_evaluations += left.n_evaluations;
                        progress.n_iterations += left.n_iterations;
                        progress.seconds += before;
                        observer(&progress)
                    }) as Box<crate::fit::stage::FitObserver<'_>>
                }),
                context,
                engine: engine.clone(),
                phase: Arc::clone(&phase),
            };
            let fitted = windowed[k].as_ref().unwrap_or(this).fit_and_keep(options, Some(within));
            let fit = match fitted {
                // It had no time for a single evaluation.
                Ok((fit, _)) if k > 0 && fit.cost.is_nan() && context.is_late() => {
                    ended = Some(fit.report.termination);
                    break;
                }
                Ok((fit, kept)) => {
                    if k == 0 {
                        first_kept = KeptResiduals::of_start(kept.at_start().map(<[f64]>::to_vec));
                    }
                    last_kept = kept;
                    fit
                }
                // The results of the stages before are not lost.
                Err(error) if k > 0 => match ended_by(&error) {
                    Some(termination) => {
                        ended = Some(termination);
                        break;
                    }
                    None => return Err(in_stage(k)(error)),
                },
                Err(error) => return Err(in_stage(k)(error)),
            };
            x.clone_from(&fit.x);
            let is_last = match &fit.report.termination {
                Termination::Interrupted
                | Termination::StoppedByObserver
                | Termination::Aborted(_)
                | Termination::NotSaved(_) => true,
                Termination::Target => stage.limits.target.is_none(),
                _ => false,
            };
            fits.push(fit);
            if is_last {
                break;
            }
        }
        // What all stages give has the weights of the last one.
        let noise = fits[fits.len() - 1].noise.clone();
        let weighed = this.with_noise(noise.as_ref())?;
        let own = weighed.as_ref().unwrap_or(this);
        let mut n_checks = 0;
        let mut cost_at = |x: &[f64]| {
            n_checks += 1;
            let found = own.cost_and_residuals(x, (&objective, loss), &context, &mut stats);
            found.map(|(cost, residuals)| (cost, this.rms_of(&residuals, own.residual_layout())))
        };
        let is_own = |k: usize| stages[k].windows.is_empty() && fits[k].noise == noise;
        let (n_fits, is_kept) = (fits.len(), |k: usize| stages[k].windows.is_empty());
        let (is_first_own, is_last_own) = (is_own(0), is_own(n_fits - 1));
        let at_end = if is_last_own { None } else { Some(cost_at(&x).unwrap_or((f64::NAN, f64::NAN))) };
        let cost_at_start = match is_first_own {
            true => fits[0].start_cost.zip(fits[0].start_rms),
            false => cost_at(&start),
        };
        let mut fit = self.in_all(stages, fits, &freed, ended);
        fit.stats += stats;
        fit.n_checks += n_checks;
        if let Some((cost, rms)) = at_end {
            (fit.cost, fit.report.fun, fit.rms) = (cost, cost, rms);
        }
        phase.set(FitPhase::Checks);
        let is_checked = uncertainty.is_some() && is_over(&fit.report.termination) && !context.is_over();
        let (at_start, at_end) = match is_checked || !(is_first_own && is_last_own) {
            true => {
                let of_stage = &fit.stages[fit.stages.len() - 1].start;
                let known = KeptResiduals::of_both(
                    first_kept.at_start().filter(|_| is_kept(0)),
                    last_kept
                        .at((&x, of_stage))
                        .filter(|_| is_kept(n_fits - 1))
                        .map(|residuals| (x.as_slice(), residuals)),
                );
                let known = known.reweighed(this.residual_layout(), own.residual_layout());
                own.plain_residuals((&start, &x), (&known, loss), &context, &mut fit.stats)
            }
            false => (None, None),
        };
        if let Some(at_end) = at_end.as_deref().filter(|_| is_checked) {
            let (from, to) = ((start.as_slice(), at_start.as_deref()), (x.as_slice(), at_end));
            let mut found = own.check_after_fit(from, to, &context, &mut fit.stats);
            found.retain(|finding| !fit.setup_findings.contains(finding));
            fit.setup_findings.extend(found);
        }
        phase.set(FitPhase::Uncertainty);
        fit.uncertainty = uncertainty.filter(|_| objective.has_uncertainty()).and_then(|mut options| {
            options.workers = options.workers.or(Some(fit.report.workers));
            options.held.extend((0..x.len()).filter(|i| !freed.iter().any(|freed| freed.contains(i))));
            if !is_last_own {
                fit.report.residuals = None;
            }
            let asked = UncertaintyOptions { loss, is_likelihood: objective.is_likelihood(), ..options };
            let found = Findings {
                at_bound: fit.at_bound.clone(),
                without_effect: fit.without_effect.clone(),
                n_checks: 0,
            };
            let known = fit.report.residuals.as_deref().or(at_end.as_deref());
            own.uncertainty_of_fit(
                (&fit.report, &found, known),
                &run.tolerances,
                asked,
                &context,
                &mut fit.stats,
            )
        });
        (fit.start_cost, fit.start_rms) = cost_at_start.unzip();
        (fit.n_measurements, fit.tolerance) = (self.n_measurements(), tolerance);
        fit.setup_findings.extend(tolerance.and_then(|chosen| chosen.finding()));
        if is_first_own && is_last_own {
            let at_start = fit.stages[0].outputs.iter().map(|output| output.start_rms);
            fit.outputs.iter_mut().zip(at_start).for_each(|(output, rms)| output.start_rms = rms);
        } else {
            fit.outputs =
                at_end.map_or_else(Vec::new, |at_end| own.output_fits_of(&at_end, at_start.as_deref()));
        }
        Ok(fit)
    }

    /// The fit of all stages, from that of each.
    fn in_all(
        &self,
        stages: &[Stage],
        fits: Vec<Fit>,
        freed: &[Vec<usize>],
        ended: Option<Termination>,
    ) -> Fit {
        let mut all = fits[fits.len() - 1].clone();
        all.start.clone_from(&fits[0].start);
        all.preflight.clone_from(&fits[0].preflight);
        let (at_bound, without_effect) = (&mut all.at_bound, &mut all.without_effect);
        at_bound.clear();
        without_effect.clear();
        for (fit, freed) in fits.iter().zip(freed) {
            at_bound.retain(|(i, _)| !freed.contains(i));
            without_effect.retain(|i| !freed.contains(i));
            at_bound.extend(&fit.at_bound);
            without_effect.extend(&fit.without_effect);
        }
        at_bound.sort_by_key(|(i, _)| *i);
        without_effect.sort_unstable();
        let report = &mut all.report;
        // Each takes what other stages hold as known.
        (report.jacobian, report.active) = (None, Vec::new());
        report.message = format!("stage {} of {}: {}", fits.len(), stages.len(), report.message);
        for (k, earlier) in fits[..fits.len() - 1].iter().enumerate().rev() {
            let before = &earlier.report;
            add_earlier(report, before);
            if report.is_success() {
                report.termination.clone_from(&before.termination);
                report.tests = before.tests;
            }
            report.message =
                format!("stage {} of {}: {}; {}", k + 1, stages.len(), before.message, report.message);
            all.stats += earlier.stats;
            all.n_checks += earlier.n_checks;
        }
        let last_windows = &stages[fits.len() - 1].windows;
        let noise = &fits[fits.len() - 1].noise;
        let is_same = |k: usize| stages[k].windows == *last_windows && fits[k].noise == *noise;
        let same_windows = |k: &usize| (*k..fits.len()).all(is_same);
        let first = (0..fits.len()).find(same_windows).unwrap_or(0);
        let mut traces = fits[first..].iter().map(|fit| fit.report.trace.clone());
        if let Some(mut trace) = traces.next() {
            traces.for_each(|later| trace.append(later));
            report.trace = trace;
        }
        if let Some(termination) = ended {
            report.message += &format!("; the fit ended before stage {}: {termination}", fits.len() + 1);
            report.termination = termination;
        }
        let is_freed = |i: &usize| freed.iter().any(|freed| freed.contains(i));
        let held = (0..all.x.len()).filter(|i| !is_freed(i) && !self.parameters()[*i].is_fixed());
        let names: Vec<&str> = held.map(|i| all.names[i].as_str()).collect();
        if !names.is_empty() {
            let names = names.join(", ");
            let sentence = format!("no stage frees {names}: at the start");
            all.setup_findings.push(Finding::new(Severity::Note, names, sentence, ""));
        }
        all.stages = fits;
        all
    }

    /// The entries of `x` that a stage frees.
    fn freed(&self, stage: &Stage, held: &[usize]) -> Result<Vec<usize>, CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        if stage.parameters.is_empty() {
            return setup("it frees no parameter".to_owned());
        }
        let mut freed: Vec<usize> = Vec::new();
        for name in &stage.parameters {
            let entries = self.entries_of(name);
            if entries.is_empty() {
                let names = self.parameters().iter().map(|p| p.name());
                let names = names.collect::<Vec<_>>().join(", ");
                return setup(format!("there is no parameter '{name}'; there are: {names}"));
            }
            if entries.iter().all(|&i| self.parameters()[i].is_fixed() || held.contains(&i)) {
                return setup(format!("parameter '{name}' is fixed, a stage cannot free it"));
            }
            if entries.iter().any(|i| freed.contains(i)) {
                return setup(format!("parameter '{name}' is named twice"));
            }
            freed.extend(entries.iter().filter(|i| !held.contains(i)));
        }
        Ok(freed)
    }

    /// The entries of `x` that a name stands for: one, or all of a local parameter.
    pub(crate) fn entries_of(&self, name: &str) -> Vec<usize> {
        let is_local = self.problem().parameters.iter().any(|p| p.is_local() && p.name() == name);
        let is_it =
            |own: &str| own == name || (is_local && own.strip_prefix(name).is_some_and(is_in_experiment));
        let entries = self.parameters().iter().enumerate();
        entries.filter(|(_, p)| is_it(p.name())).map(|(i, _)| i).collect()
    }
}

/// True for the suffix of the name of a local parameter in an experiment.
fn is_in_experiment(rest: &str) -> bool {
    rest.starts_with('[') && rest.ends_with(']')
}
