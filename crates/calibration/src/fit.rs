//! The fit: the objective meets an optimiser; parameters with names come out.

use crate::calibration::Calibration;
use crate::effect::{BoundSide, Findings, is_over};
use crate::error::CalibrationError;
use crate::finding::{Finding, Severity};
use crate::objective::CostKind;
use crate::output_fit::{KeptResiduals, OutputFit};
use crate::parameter::{Parameter, Scale};
use crate::phase::{CurrentPhase, Deadline, FitPhase};
use crate::preflight::{Preflight, PreflightOptions};
use crate::residual::{CostRule, sum_of_squares};
use crate::simulations::Simulations;
use crate::solver::Solver;
use crate::spot_checks::SpotChecks;
use crate::worth::{KnownPoint, Worth, WorthOptions, digits};
use dfo::{
    Answer, AnyMethod, ByRef, Kind, Measure, NothingFound, Objective, Outcome, Progress, Query, Report,
    Resume, RobustLoss, RunOptions, Search, Stop, Termination, Tolerances, Trace, Want, typical_size,
};
use ode::{Number, Stats};
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::fmt;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::available_parallelism;
use std::time::Instant;

/// Why a fit is begun again.
const HISTORY: &str = "the fit's simulations were found to depend on earlier ones (a state that the model keeps and no variable shows)";

/// Called after each iteration; `Break` ends the fit.
pub type FitObserver<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// How a fit is made.
pub struct FitOptions<'a> {
    /// The method, tolerances, limits, workers (default: all cores), checkpoint and so on. The time limit holds for the whole fit, from
    /// the choice of a solver to the standard errors: where it is over before any evaluation has ended, the result is the start,
    /// with a cost of NaN. Model, data, parameters and settings
    /// of the calibration identify the fit's problem: a checkpoint of another one is refused, and points that are known
    /// from another one are evaluated again.
    pub run: RunOptions<AnyMethod>,
    /// Where to start; default: the parameters' start values.
    pub start: Option<Vec<f64>>,
    /// Parameters, by number, that stay at the start as if they were fixed; default: none.
    pub held: Vec<usize>,
    /// Whether a simulation is given up when its cost can no longer matter; default yes. Changes no decision, only the
    /// work.
    pub cutoffs: bool,
    /// What is minimised; default: the sum of the squared residuals.
    pub objective: CostKind,
    /// What a residual counts; default: its square. With another loss [`Fit::cost`] is the sum of what they count, also where
    /// the method sees costs alone.
    pub loss: RobustLoss,
    /// The start is looked at first, see [`Calibration::preflight`]; `f_tol` below the noise of the simulations is raised to it, with
    /// a word in the message. Default: no.
    pub preflight: bool,
    /// What the fit is worth is found out after the run: standard errors, correlation, what the data cannot tell. Takes at least two
    /// simulations for each parameter and one that is more accurate, in parallel; they are none of the run's evaluations, are not
    /// made after an interrupt or when the time is up, and are part of `stats`. `None`: it is not. Its loss is that of the fit.
    pub worth: Option<WorthOptions>,
    /// Called after each iteration, on the calling thread.
    pub observer: Option<Box<FitObserver<'a>>>,
    /// Asked on the calling thread at least every 50 ms; `true` interrupts the fit.
    pub poll: Option<Box<dyn FnMut() -> bool + 'a>>,
    /// A flag that interrupts the fit when it is raised, within a step of the simulations that are running.
    pub cancel: Option<Arc<AtomicBool>>,
    /// Where the fit says what it does.
    pub phase: Arc<CurrentPhase>,
}

impl FitOptions<'_> {
    /// The run of a fit by default: the method for residuals that [`AnyMethod::chosen_for`] chooses, tolerances of 1e-4 each, `x_tol` in units of the parameters' sizes and `f_tol` as a
    /// fraction of the cost, for a cost made of simulations is seldom smooth below that; all else as [`dfo::minimize`] has
    /// it.
    pub fn default_run() -> RunOptions<AnyMethod> {
        let tolerances = Tolerances { x_tol: 1e-4, f_tol: 1e-4, measure: Measure::Relative, stop: Stop::All };
        RunOptions { method: AnyMethod::auto(Search::Local), tolerances, ..RunOptions::default() }
    }
}

impl Default for FitOptions<'_> {
    fn default() -> Self {
        Self {
            run: Self::default_run(),
            start: None,
            held: Vec::new(),
            cutoffs: true,
            objective: CostKind::default(),
            loss: RobustLoss::default(),
            preflight: false,
            worth: Some(WorthOptions::default()),
            observer: None,
            poll: None,
            cancel: None,
            phase: Arc::default(),
        }
    }
}

impl<'a> From<RunOptions<AnyMethod>> for FitOptions<'a> {
    fn from(run: RunOptions<AnyMethod>) -> Self {
        Self { run, ..Self::default() }
    }
}

impl fmt::Debug for FitOptions<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FitOptions")
            .field("run", &self.run)
            .field("start", &self.start)
            .finish_non_exhaustive()
    }
}

/// The result of a fit. `Display` prints a summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Fit {
    /// Fitted values, one per parameter, user's order and units; fixed ones included.
    pub x: Vec<f64>,
    /// Names of the parameters, in the same order.
    pub names: Vec<String>,
    /// What reports and figures call them, in the same order (see [`Parameter::display_name`]); empty: all as they are named.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shown_names: Vec<String>,
    /// Values of the parameters that are tied to others, by name.
    pub tied: Vec<(String, f64)>,
    /// Where the fit started.
    pub start: Vec<f64>,
    /// Units of the parameters, where they are known, in the same order.
    pub units: Vec<Option<String>>,
    /// Lower and upper bounds of the parameters, in the same order; both the same where one is fixed.
    pub bounds: Vec<(f64, f64)>,
    /// Name of the model.
    pub model: String,
    /// How many measurements count.
    pub n_measurements: usize,
    /// Cost there: the sum of the squared weighted residuals; with a loss, of what they count.
    pub cost: f64,
    /// Root of the mean squared weighted residual of the measurements there; with a loss, of what they count.
    pub rms: f64,
    /// Name of the cost, see [`CostKind::name`].
    pub objective: String,
    /// Cost at the start, if the simulation did not fail there.
    pub start_cost: Option<f64>,
    /// RMS at the start, if the simulation did not fail there.
    pub start_rms: Option<f64>,
    /// The fit of each stage, see [`Calibration::fit_stages`]; empty if there were none.
    pub stages: Vec<Fit>,
    /// Parameters that ended at a bound, by number: the best values may lie beyond.
    pub at_bound: Vec<(usize, BoundSide)>,
    /// Parameters that did not change the cost (by more than the relative tolerance of the simulations), by number: their
    /// values say nothing.
    pub without_effect: Vec<usize>,
    /// Simulations made after the run to find out about both: at the bound, for each parameter that ended as near to it as
    /// `x_tol`; with the parameter moved, for each that no evaluation has shown to change the cost (those of a first simplex
    /// show it, because they differ in one parameter alone). They are none of the run's evaluations, which its budget
    /// counts, are not made after an interrupt or when the time is up, and are part of `stats`.
    pub n_checks: usize,
    /// How often the fit was begun: more than once where a simulation was found to depend on earlier ones
    /// ([`Fmu::n_history_findings`](fmi::Fmu::n_history_findings)). Its budget of evaluations counts from the last beginning.
    pub n_beginnings: usize,
    /// How well each output is reproduced, in the order of the residual vector; empty where the run was ended from outside.
    pub outputs: Vec<OutputFit>,
    /// What was found before the fit, where it was asked for.
    pub preflight: Option<Preflight>,
    /// What a [check](Calibration::check) says of the problem beyond notes, judged again with the fitted values (not where the fit is not
    /// asked what it is worth), and what is to be said of the run. [`Fit::findings`] has all.
    pub setup_findings: Vec<Finding>,
    /// What the fit is worth; `None` where it was not asked for, or the run was ended from outside.
    pub worth: Option<Worth>,
    /// What the simulations of the fit took in all: right-hand sides, steps, events, seconds (added up over all workers), from the
    /// choice of a solver, where this fit made it, to the standard errors.
    /// Those that failed or were given up count, those of a resumed fit from before do not.
    pub stats: Stats,
    /// The integration method of all simulations, and how it was found.
    pub solver: Solver,
    /// How the optimiser got there: counts, reason to end, trace.
    pub report: Report,
}

impl Fit {
    /// What reports and figures call the parameters.
    pub fn shown_names(&self) -> &[String] {
        if self.shown_names.is_empty() { &self.names } else { &self.shown_names }
    }

    /// What is to be said of the fit, the gravest first: parameters at a bound or without effect, what a check finds, what the data
    /// cannot tell, what the residuals look like.
    pub fn findings(&self) -> Vec<Finding> {
        self.findings_with(&self.names)
    }

    /// The same with other names of the parameters.
    pub(crate) fn findings_with(&self, names: &[String]) -> Vec<Finding> {
        let at_bound = |(i, side): &(usize, BoundSide)| {
            let bound = match side {
                BoundSide::Lower => self.bounds[*i].0,
                BoundSide::Upper => self.bounds[*i].1,
            };
            let sentence = format!(
                "{} is at its {} bound {}: the best value may lie beyond",
                names[*i],
                side.name(),
                Number(bound)
            );
            Finding::new(Severity::Warning, &names[*i], sentence, "")
        };
        let without_effect = |i: &usize| {
            let sentence = format!("{} did not change the cost: its value says nothing", names[*i]);
            Finding::new(Severity::Warning, &names[*i], sentence, "")
        };
        let is_said = |i: &&usize| !self.worth.as_ref().is_some_and(|worth| worth.undetermined.contains(i));
        let mut all: Vec<Finding> = self.at_bound.iter().map(at_bound).collect();
        all.extend(self.without_effect.iter().filter(is_said).map(without_effect));
        all.extend(self.setup_findings.iter().cloned());
        all.extend(self.worth.iter().flat_map(|worth| worth.findings_with(names)));
        all.sort_by_key(|finding| finding.severity);
        all
    }

    /// The RMS over that at the start, on the same measurements; `None` if the simulation failed at the start.
    pub fn scaled_rms(&self) -> Option<f64> {
        self.start_rms.map(|start| self.rms / start)
    }
}

/// The objective of one fit, which adds up what its simulations take.
struct Counted<'a> {
    calibration: &'a Calibration,
    cutoffs: bool,
    kind: &'a CostKind,
    loss: RobustLoss,
    start: &'a [f64],
    /// The residuals there, as they count, where they are known already.
    at_start: Option<Vec<f64>>,
    stats: Mutex<(Stats, SpotChecks, KeptResiduals)>,
    /// Findings before the run.
    n_findings: u64,
}

impl Objective for Counted<'_> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        let mut query = *query;
        if !self.cutoffs {
            query.cutoff = f64::INFINITY;
        }
        let wanted = std::mem::replace(&mut query.want, Want::Residuals);
        let mut stats = Stats::default();
        match &self.at_start {
            Some(residuals) if x == self.start => {
                answer.residuals.clone_from(residuals);
                answer.outcome = Outcome::Value(sum_of_squares(residuals));
            }
            _ => self.calibration.evaluate_counted(x, (&query, self.loss), answer, &mut stats),
        }
        // A poisoned lock is no reason to fail: the counts are whole at every instant.
        let mut known = self.stats.lock().unwrap_or_else(|e| e.into_inner());
        known.0 += stats;
        let sum = answer.outcome.value();
        known.1.note(x, sum);
        drop(known);
        let mut own = Vec::new();
        if let Some(sum) = sum {
            // A function of the user's may take its time.
            let layout = self.calibration.residual_layout();
            answer.outcome = self.kind.outcome(layout, (sum, &answer.residuals), &mut own);
            if let Some(cost) = answer.outcome.value() {
                let mut known = self.stats.lock().unwrap_or_else(|e| e.into_inner());
                known.2.note((x, self.start), cost, &answer.residuals);
            }
            if !self.kind.is_sum_of_squares() {
                answer.residuals = own;
            }
        }
        if wanted == Want::Cost {
            answer.residuals.clear();
        }
        if self.calibration.n_history_findings() > self.n_findings {
            answer.outcome = Outcome::Abort(HISTORY.to_owned());
        }
    }

    fn uses_cutoff(&self) -> bool {
        self.cutoffs
    }

    fn has_residuals(&self) -> bool {
        self.kind.has_residuals()
    }

    fn residual_loss(&self) -> RobustLoss {
        self.loss
    }
}

/// What a fit is asked for, checked, with its clock.
struct Job<'a> {
    run: RunOptions<AnyMethod>,
    start: Vec<f64>,
    held: Vec<usize>,
    cutoffs: bool,
    objective: CostKind,
    loss: RobustLoss,
    wants_preflight: bool,
    worth: Option<WorthOptions>,
    observer: RefCell<Option<Box<FitObserver<'a>>>>,
    poll: RefCell<Option<Box<dyn FnMut() -> bool + 'a>>>,
    cancel: Option<Arc<AtomicBool>>,
    phase: Arc<CurrentPhase>,
    deadline: Deadline,
    /// The residuals at the start, as they count, where they were known before the search.
    at_start: RefCell<Option<Vec<f64>>>,
}

impl<'a> Job<'a> {
    fn new(calibration: &Calibration, options: FitOptions<'a>) -> Result<Self, CalibrationError> {
        let deadline = Deadline::new(options.run.limits.max_time);
        let mut run = options.run;
        options.objective.check(calibration.residual_layout(), !options.loss.is_linear())?;
        run.workers.get_or_insert_with(|| available_parallelism().map_or(1, usize::from));
        let start = options.start.unwrap_or_else(|| calibration.start());
        calibration.check_start(&start)?;
        if let Some(index) = options.held.iter().find(|&&i| i >= start.len()) {
            let n = start.len();
            return Err(CalibrationError::Setup(format!(
                "parameter {index} is held, but there are only {n}"
            )));
        }
        Ok(Self {
            run,
            start,
            held: options.held,
            cutoffs: options.cutoffs && options.objective.is_sum_of_squares(),
            objective: options.objective,
            loss: options.loss,
            wants_preflight: options.preflight,
            worth: options.worth,
            observer: RefCell::new(options.observer),
            poll: RefCell::new(options.poll),
            cancel: options.cancel,
            phase: options.phase,
            deadline,
            at_start: RefCell::default(),
        })
    }

    fn is_polled(&self) -> bool {
        self.poll.borrow_mut().as_mut().is_some_and(|poll| poll())
    }

    /// Whether it is interrupted.
    fn is_asked(&self) -> bool {
        self.cancel.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed)) || self.is_polled()
    }

    /// Whether it is interrupted, or its time is up.
    fn is_cancelled(&self) -> bool {
        self.deadline.is_over() || self.is_asked()
    }
}

/// What the search of a fit gave.
struct Searched {
    report: Report,
    found: Findings,
    residuals: KeptResiduals,
    preflight: Option<Preflight>,
    solver: Solver,
    /// Those that held.
    tolerances: Tolerances,
    /// What is to be said of them.
    raised: Vec<Finding>,
    n_beginnings: usize,
}

impl Calibration {
    /// Fits the parameters.
    ///
    /// Simulations run on threads of their own where they are long enough for that; the calling thread observes and polls.
    /// Evaluations that can no longer matter are given up early (see [`dfo::Outcome::Above`]); this changes no decision.
    ///
    /// # Errors
    /// Options that cannot be used, simulations that fail at every starting point, a run ended before any point had a
    /// cost. Every other end, early ones included, is a [`Fit`] with the best point seen.
    pub fn fit<'a>(&self, options: impl Into<FitOptions<'a>>) -> Result<Fit, CalibrationError> {
        self.fit_and_keep(options.into()).map(|(fit, _)| fit)
    }

    /// The same, with the residuals that the run has computed.
    pub(crate) fn fit_and_keep(
        &self,
        options: FitOptions<'_>,
    ) -> Result<(Fit, KeptResiduals), CalibrationError> {
        let job = Job::new(self, options)?;
        let mut stats = Stats::default();
        let searched = self.search(&job, &mut stats);
        let Searched { report, found, residuals, preflight, solver, tolerances, raised, n_beginnings } =
            match searched {
                Err(error) if !job.is_asked() => self.start_alone(&job, error)?,
                searched => searched?,
            };
        let Job { start, held, objective, loss, deadline, phase, worth, .. } = &job;
        let cancelled = || job.is_cancelled();
        let mut remarks = raised;
        if n_beginnings > 1 {
            let sentence = format!("begun {n_beginnings} times: {HISTORY}");
            remarks.push(Finding::new(Severity::Note, "fit", sentence, ""));
        }
        phase.set(FitPhase::Checks);
        let is_whole = worth.is_some() && held.is_empty();
        let (at_start, at_end) =
            self.plain_residuals((start, &report.x), (&residuals, *loss), &cancelled, &mut stats);
        if let Some(at_end) = at_end.as_deref().filter(|_| is_whole && is_over(&report.termination)) {
            let (from, to) = ((start.as_slice(), at_start.as_deref()), (report.x.as_slice(), at_end));
            remarks.extend(self.check_after_fit(from, to, &cancelled, &mut stats));
        }
        let outputs = at_end
            .as_deref()
            .map_or_else(Vec::new, |at_end| self.output_fits_of(at_end, at_start.as_deref()));
        phase.set(FitPhase::Worth);
        let worth = worth.clone().filter(|_| objective.has_worth()).and_then(|mut options| {
            options.workers = options.workers.or(job.run.workers);
            options.held.extend(held);
            let asked = WorthOptions { loss: *loss, is_likelihood: objective.is_likelihood(), ..options };
            let known = report.residuals.as_deref().or(at_end.as_deref());
            let worth =
                self.worth_of_fit((&report, &found, known), &tolerances, asked, (&cancelled, &mut stats));
            if worth.is_none() && is_over(&report.termination) && deadline.is_over() {
                let sentence = "the time was up before the standard errors were known";
                remarks.push(Finding::new(Severity::Warning, "max_time", sentence, ""));
            }
            worth
        });
        let start_cost =
            report.trace.iter().find(|e| e.x == start.as_slice()).and_then(|e| e.outcome.value());
        let is_start = report.trace.is_empty() && report.fun.is_finite();
        let start_cost = start_cost.or(Some(report.fun).filter(|_| is_start));
        let mut rms = |x: &[f64], cost: Option<f64>| match (objective.is_sum_of_squares(), cost) {
            (true, cost) => cost.map(|cost| self.rms(x, cost, *loss)),
            // Of another cost the residuals have to be known.
            (false, None) => None,
            (false, Some(_)) => match residuals.at((x, start)) {
                Some(known) => Some(self.rms(x, sum_of_squares(known), *loss)),
                None => self.cost_and_rms(x, (objective, *loss), &cancelled, &mut stats).map(|(_, rms)| rms),
            },
        };
        let names: Vec<String> = self.parameters().iter().map(|p| p.name().to_owned()).collect();
        let mut shown_names: Vec<String> =
            self.parameters().iter().map(|p| p.shown_name().to_owned()).collect();
        if shown_names == names {
            shown_names.clear();
        }
        let description = self.fmu().description();
        let unit = |p: &Parameter| p.unit(description).map(str::to_owned);
        let fit = Fit {
            units: self.parameters().iter().map(unit).collect(),
            bounds: self.parameters().iter().map(|p| (p.lower(), p.upper())).collect(),
            model: description.model_name.clone(),
            n_measurements: self.n_measurements(),
            x: report.x.clone(),
            names,
            shown_names,
            outputs,
            preflight,
            setup_findings: remarks,
            worth,
            cost: report.fun,
            rms: rms(&report.x, Some(report.fun)).unwrap_or(f64::NAN),
            tied: self.tied_values(&report.x),
            start_cost,
            start_rms: rms(start, start_cost),
            objective: objective.name().to_owned(),
            start: start.clone(),
            stages: Vec::new(),
            at_bound: found.at_bound,
            without_effect: found.without_effect,
            n_checks: found.n_checks,
            n_beginnings,
            stats,
            solver,
            report,
        };
        Ok((fit, residuals))
    }

    /// The search for the best point, with what comes before it.
    fn search(&self, job: &Job<'_>, stats: &mut Stats) -> Result<Searched, CalibrationError> {
        let Job { start, held, cutoffs, objective, loss, deadline, .. } = job;
        let (cutoffs, loss, deadline) = (*cutoffs, *loss, *deadline);
        let mut described = job.run.clone();
        let bound = |side: fn(&Parameter) -> f64| {
            let mut bounds: Vec<f64> = self.parameters().iter().map(side).collect();
            held.iter().for_each(|&i| bounds[i] = start[i]);
            bounds
        };
        let transforms: Vec<Scale> = self.parameters().iter().map(Parameter::scale_kind).collect();
        let mut kinds: Vec<Kind> = self.parameters().iter().map(Parameter::value_kind).collect();
        // What is held can have any value, and does not choose the method.
        held.iter().for_each(|&i| kinds[i] = Kind::Continuous);
        let sizes: Vec<Option<f64>> = self.parameters().iter().map(|p| self.given_size(p)).collect();
        if let Some(checkpoint) = &described.checkpoint {
            self.adopt_solver(checkpoint)?;
        }
        let cancelled = || job.is_cancelled();
        job.phase.set(FitPhase::Solver);
        let (solver, raced) = self.solver_counted(&cancelled, stats)?;
        let raced = raced.filter(|_| *start == self.start());
        let counted = |plain: Vec<f64>| plain.into_iter().map(|r| loss.transform(r)).collect::<Vec<f64>>();
        let mut at_start = raced.map(|raced| (counted(raced.residuals), raced.seconds));
        *job.at_start.borrow_mut() = at_start.as_ref().map(|(residuals, _)| residuals.clone());
        job.phase.set(FitPhase::ModelTest);
        self.prepare(&cancelled)?;
        let problem = self.problem_hash(solver);
        let problem = if loss.is_linear() { problem } else { format!("{problem}, loss {loss}") };
        let is_usual = objective.is_sum_of_squares();
        described.problem =
            Some(if is_usual { problem } else { format!("{problem}, objective {}", objective.name()) });
        described.checkpoint = described.checkpoint.map(|checkpoint| self.tag(checkpoint, solver));
        let preflight = job.wants_preflight.then(|| {
            job.phase.set(FitPhase::Preflight);
            let options = PreflightOptions { start: Some(start.clone()), workers: described.workers, loss };
            self.preflight_counted(&options, &mut at_start, &cancelled, stats)
        });
        let preflight = preflight.transpose()?;
        let mut raised: Vec<Finding> = self.tightened().into_iter().collect();
        if let Some(found) = &preflight
            && described.tolerances.measure == Measure::Relative
            && found.f_tol_above_noise(described.tolerances.f_tol) > described.tolerances.f_tol
        {
            described.tolerances.f_tol = found.noise;
            let sentence =
                format!("f_tol was raised to the noise of the simulations, {}", digits(found.noise));
            raised.push(Finding::new(Severity::Note, "f_tol", sentence, ""));
        }
        let tolerances = described.tolerances;
        job.phase.set(FitPhase::Search);
        let mut observer = job.observer.borrow_mut();
        let mut n_beginnings = 0;
        let (report, found, residuals) = loop {
            n_beginnings += 1;
            let n_findings = self.n_history_findings();
            let known = at_start.take().map(|(residuals, _)| residuals);
            job.at_start.borrow_mut().clone_from(&known);
            let counted = Counted {
                calibration: self,
                cutoffs,
                kind: objective,
                loss,
                start,
                at_start: known.clone(),
                stats: Mutex::new((Stats::default(), SpotChecks::default(), KeptResiduals::of_start(known))),
                n_findings,
            };
            described.limits.max_time = deadline.left();
            let mut run = dfo::minimize(ByRef(&counted))
                .start(start)
                .bounds(&bound(Parameter::lower), &bound(Parameter::upper))
                .map_err(|e| self.name_parameter(e))?
                .transforms(&transforms)
                .kinds(&kinds)
                .known_scales(&sizes)
                .options(described.clone());
            if let Some(observer) = &mut *observer {
                run = run.observer(|progress| observer(progress));
            }
            if job.poll.borrow().is_some() {
                run = run.poll(|| job.is_polled());
            }
            if let Some(flag) = &job.cancel {
                run = run.cancel(Arc::clone(flag));
            }
            let began = Instant::now();
            let outcome = run.run().map_err(|error| match error {
                dfo::Error::NeedsResiduals { method } => CalibrationError::Setup(format!(
                    "{method} minimises sums of squares, and the objective '{}' is none: leave the method to the fit \
                     (method auto), or take nelder-mead",
                    objective.name()
                )),
                error => self.name_parameter(error),
            });
            let took = began.elapsed();
            job.phase.set(FitPhase::Checks);
            let (taken, checks, residuals) = counted.stats.into_inner().unwrap_or_else(|e| e.into_inner());
            *stats += taken;
            let is_sound = || self.n_history_findings() == n_findings;
            if is_sound() || cancelled() {
                let report = outcome?;
                let differs = || self.depends_on_history(&report.x, &cancelled);
                if cancelled()
                    || !(differs()
                        || self.costs_depend_on_history(&checks, took, CostRule::whole(loss, &cancelled)))
                {
                    let of_run = (start.as_slice(), held.as_slice(), &report, objective);
                    let found = self.findings(of_run, &tolerances, &cancelled, stats);
                    if is_sound() || cancelled() {
                        break (report, found, residuals);
                    }
                }
            }
            log::warn!("{}: {HISTORY}: it begins anew", self.fmu().description().model_name);
            // What was stored, here or by an earlier fit, may depend on what ran before.
            described.checkpoint = described.checkpoint.map(|checkpoint| checkpoint.resume(Resume::Never));
            described.known.iter_mut().for_each(|known| known.problem = None);
        };
        Ok(Searched {
            report,
            found,
            residuals,
            preflight,
            solver: solver.clone(),
            tolerances,
            raised,
            n_beginnings,
        })
    }

    /// What is said where simulations have a smaller tolerance than the model states.
    fn tightened(&self) -> Option<Finding> {
        let (settings, description) = (&self.problem().settings, self.fmu().description());
        let used = match settings.relative_tolerance {
            None => settings.tolerance_of_fits(description)?,
            Some(_) => return None,
        };
        let stated = description.default_experiment.tolerance.unwrap_or(f64::NAN);
        let sentence = format!(
            "simulations have the relative tolerance {} instead of the model's {}, which leaves the cost noisy",
            Number(used),
            Number(stated)
        );
        Some(Finding::new(Severity::Note, "relative tolerance", sentence, "relative_tolerance overrides it"))
    }

    /// The start as the result of a search that had no time for a single evaluation.
    ///
    /// # Errors
    /// The error that ended the search, unless it is that.
    fn start_alone(&self, job: &Job<'_>, error: CalibrationError) -> Result<Searched, CalibrationError> {
        let found = match error {
            CalibrationError::Cancelled if job.deadline.is_over() => {
                NothingFound { n_evaluations: 0, failures: Vec::new(), x: None, trace: Trace::default() }
            }
            CalibrationError::Optimiser(dfo::Error::EndedWithoutPoint {
                termination: Termination::MaxTime,
                found,
            }) => *found,
            error => return Err(error),
        };
        let named = Solver { method: self.problem().settings.method, race: None };
        let mut report = Report::without_cost(
            &job.start,
            job.run.method.name(),
            found,
            job.deadline.elapsed().as_secs_f64(),
        );
        let residuals = KeptResiduals::of_start(job.at_start.take());
        if let Some(known) = residuals.at_start() {
            let of_squares = (sum_of_squares(known), known);
            let outcome = job.objective.outcome(self.residual_layout(), of_squares, &mut Vec::new());
            report.fun = outcome.value().unwrap_or(f64::NAN);
        }
        report.message = format!(
            "stopped at the time limit of {} s before the search had found anything: the result is the start",
            Number(job.run.limits.max_time.unwrap_or_default().as_secs_f64())
        );
        report.workers = job.run.workers.unwrap_or(1);
        report.loss = job.loss;
        Ok(Searched {
            report,
            found: Findings::default(),
            residuals,
            preflight: None,
            solver: self.known_solver().cloned().unwrap_or(named),
            tolerances: job.run.tolerances,
            raised: Vec::new(),
            n_beginnings: 1,
        })
    }

    /// The cost at `x` and the RMS of the measurements there; `None` where the simulation fails.
    pub(crate) fn cost_and_rms(
        &self,
        x: &[f64],
        (kind, loss): (&CostKind, RobustLoss),
        cancelled: &dyn Fn() -> bool,
        stats: &mut Stats,
    ) -> Option<(f64, f64)> {
        let mut residuals = vec![0.0; self.n_residuals()];
        let sum = self.evaluate_into(x, CostRule::whole(loss, cancelled), &mut residuals, stats).ok()?;
        let outcome = kind.outcome(self.residual_layout(), (sum, &residuals), &mut Vec::new());
        Some((outcome.value()?, self.rms(x, sum, loss)))
    }

    /// What the result of a run is worth, from the residuals there, without a loss, where they are known; `None` where it cannot be found
    /// out, or shall not.
    pub(crate) fn worth_of_fit(
        &self,
        (report, found, residuals): (&Report, &Findings, Option<&[f64]>),
        tolerances: &Tolerances,
        mut options: WorthOptions,
        (cancelled, stats): (&dyn Fn() -> bool, &mut Stats),
    ) -> Option<Worth> {
        if !is_over(&report.termination) || cancelled() {
            return None;
        }
        let workers = options.workers.unwrap_or(1);
        let mut simulations = Simulations::new(self, (RobustLoss::default(), workers), cancelled).ok()?;
        let (inert, criterion) = (&found.without_effect, options.criterion());
        let at_bound = found.at_bound.iter().map(|(index, _)| index);
        options.held.extend(at_bound.filter(|index| !inert.contains(index)));
        let known = KnownPoint {
            // Those of a stage with a window of its own are others.
            residuals: residuals.filter(|r| r.len() == self.n_residuals()),
            jacobian: report.jacobian.as_deref(),
            held: options.held,
            inert,
            f_tol: match tolerances.measure {
                Measure::Relative => tolerances.f_tol,
                Measure::Absolute => tolerances.f_tol / report.fun.abs(),
            },
            criterion,
        };
        let worth = self.worth_of(&report.x, options.estimator, &known, &mut simulations);
        *stats += simulations.stats;
        match worth {
            Ok(worth) => Some(worth),
            Err(error) => {
                log::info!("what the fit is worth could not be found out: {error}");
                None
            }
        }
    }

    /// The optimiser knows parameters by number, the user by name.
    fn name_parameter(&self, source: dfo::Error) -> CalibrationError {
        match source.parameter() {
            Some(index) => {
                let name = self.parameters()[index].name().to_owned();
                CalibrationError::OptimiserParameter { index, name, source: Box::new(source) }
            }
            None => source.into(),
        }
    }

    /// Checks a start given for this fit as the parameters' own starts were checked.
    fn check_start(&self, start: &[f64]) -> Result<(), CalibrationError> {
        self.check_length(start)?;
        for (parameter, value) in self.parameters().iter().zip(start) {
            let (lower, upper) = (parameter.lower(), parameter.upper());
            if !(lower..=upper).contains(value) {
                let name = parameter.name().to_owned();
                let is_fixed = lower == upper;
                let [lower, upper, value] = [lower, upper, *value].map(Number);
                let message = if is_fixed {
                    format!("is fixed at {lower}, it cannot start at {value}")
                } else {
                    format!("start {value} is outside of the bounds {lower} and {upper}")
                };
                return Err(CalibrationError::Parameter { name, message });
            }
        }
        Ok(())
    }

    /// The size that was given for a parameter on a linear scale: what the user said, else the model's nominal value, but no more
    /// than the width of the bounds.
    fn given_size(&self, parameter: &Parameter) -> Option<f64> {
        if parameter.scale_kind() == Scale::Log {
            return None;
        }
        let variable = parameter.variable().and_then(|name| self.fmu().description().variable(name));
        // That of the model is in the unit of the model.
        let nominal = variable.filter(|_| parameter.given_unit().is_none()).and_then(|v| v.nominal);
        let width = parameter.upper() - parameter.lower();
        let of_model = nominal.map(|n| if width > 0.0 { n.abs().min(width) } else { n.abs() });
        parameter.nominal_size().or(of_model).map(f64::abs).filter(|size| size.is_finite() && *size > 0.0)
    }

    /// Typical size of a parameter near a value, by the rule of the search ([`dfo::typical_size`]); of its logarithm on a logarithmic
    /// scale; 1 where nothing is known. A value that has come near zero has the size that it had at the start.
    pub(crate) fn size_of(&self, parameter: &Parameter, at: f64) -> f64 {
        let (bounds, given) = ((parameter.lower(), parameter.upper()), self.given_size(parameter));
        let largest = at.abs().max(parameter.start().abs());
        typical_size(parameter.scale_kind(), largest, bounds, given).unwrap_or(1.0)
    }
}
