//! The fit: the objective meets an optimiser; parameters with names come out.

use crate::calibration::Calibration;
use crate::effect::{BoundSide, Findings, is_over};
use crate::error::CalibrationError;
use crate::finding::{Finding, Severity};
use crate::objective::CostKind;
use crate::output_fit::{KeptResiduals, OutputFit};
use crate::parameter::{Parameter, Scale};
use crate::preflight::{Preflight, PreflightOptions};
use crate::residual::CostRule;
use crate::simulations::Simulations;
use crate::solver::Solver;
use crate::spot_checks::SpotChecks;
use crate::worth::{KnownPoint, Worth, WorthOptions, digits};
use dfo::{
    Answer, AnyMethod, ByRef, Kind, Measure, Objective, Outcome, Progress, Query, Report, Resume, RobustLoss,
    RunOptions, Search, Stop, Tolerances, Want,
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
    /// The method, tolerances, limits, workers (default: all cores), checkpoint and so on. Model, data, parameters and settings
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
    /// What the simulations of the fit took in all: right-hand sides, steps, events, seconds (added up over all workers).
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
        self.calibration.evaluate_counted(x, (&query, self.loss), answer, &mut stats);
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
        let FitOptions {
            run: mut described,
            start,
            held,
            cutoffs,
            objective,
            loss,
            preflight,
            worth,
            mut observer,
            poll,
            cancel,
        } = options.into();
        objective.check(self.residual_layout(), !loss.is_linear())?;
        let cutoffs = cutoffs && objective.is_sum_of_squares();
        let poll = RefCell::new(poll);
        described.workers.get_or_insert_with(|| available_parallelism().map_or(1, usize::from));
        let start = start.unwrap_or_else(|| self.start());
        self.check_start(&start)?;
        if let Some(index) = held.iter().find(|&&i| i >= start.len()) {
            let n = start.len();
            return Err(CalibrationError::Setup(format!(
                "parameter {index} is held, but there are only {n}"
            )));
        }
        let bound = |side: fn(&Parameter) -> f64| {
            let mut bounds: Vec<f64> = self.parameters().iter().map(side).collect();
            held.iter().for_each(|&i| bounds[i] = start[i]);
            bounds
        };
        let transforms: Vec<Scale> = self.parameters().iter().map(Parameter::scale_kind).collect();
        let mut kinds: Vec<Kind> = self.parameters().iter().map(Parameter::value_kind).collect();
        // What is held can have any value, and does not choose the method.
        held.iter().for_each(|&i| kinds[i] = Kind::Continuous);
        let sizes: Vec<Option<f64>> =
            self.parameters().iter().zip(&start).map(|(p, x)| self.known_size(p, *x)).collect();
        if let Some(checkpoint) = &described.checkpoint {
            self.adopt_solver(checkpoint)?;
        }
        let is_flagged = || cancel.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed));
        let is_asked = || is_flagged() || poll.borrow_mut().as_mut().is_some_and(|poll| poll());
        // The race and the model's first-use test are not part of the time that the fit is given.
        let solver = self.solver_until(&is_asked)?;
        self.prepare(&is_asked)?;
        let max_time = described.limits.max_time;
        let late = max_time.and_then(|limit| Instant::now().checked_add(limit));
        let is_late = || late.is_some_and(|late| Instant::now() >= late);
        let cancelled = || is_late() || is_asked();
        let problem = self.problem_hash(solver);
        let problem = if loss.is_linear() { problem } else { format!("{problem}, loss {loss}") };
        let is_usual = objective.is_sum_of_squares();
        described.problem =
            Some(if is_usual { problem } else { format!("{problem}, objective {}", objective.name()) });
        described.checkpoint = described.checkpoint.map(|checkpoint| self.tag(checkpoint, solver));
        let (mut stats, mut n_beginnings) = (Stats::default(), 0);
        let preflight = preflight.then(|| {
            let options = PreflightOptions { start: Some(start.clone()), workers: described.workers, loss };
            self.preflight_counted(&options, &cancelled, &mut stats)
        });
        let preflight = preflight.transpose()?;
        let mut remarks: Vec<Finding> = Vec::new();
        if let Some(found) = &preflight
            && described.tolerances.measure == Measure::Relative
            && found.f_tol_above_noise(described.tolerances.f_tol) > described.tolerances.f_tol
        {
            described.tolerances.f_tol = found.noise;
            let sentence =
                format!("f_tol was raised to the noise of the simulations, {}", digits(found.noise));
            remarks.push(Finding::new(Severity::Note, "f_tol", sentence, ""));
        }
        let tolerances = described.tolerances;
        let (report, found, residuals) = loop {
            n_beginnings += 1;
            let n_findings = self.n_history_findings();
            let counted = Counted {
                calibration: self,
                cutoffs,
                kind: &objective,
                loss,
                start: &start,
                stats: Mutex::default(),
                n_findings,
            };
            let left = late.map(|late| late.saturating_duration_since(Instant::now()));
            described.limits.max_time = left.or(max_time);
            let mut run = dfo::minimize(ByRef(&counted))
                .start(&start)
                .bounds(&bound(Parameter::lower), &bound(Parameter::upper))
                .map_err(|e| self.name_parameter(e))?
                .transforms(&transforms)
                .kinds(&kinds)
                .known_scales(&sizes)
                .options(described.clone());
            if let Some(observer) = &mut observer {
                run = run.observer(|progress| observer(progress));
            }
            if poll.borrow().is_some() {
                run = run.poll(|| poll.borrow_mut().as_mut().is_some_and(|poll| poll()));
            }
            if let Some(flag) = &cancel {
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
            let (taken, checks, residuals) = counted.stats.into_inner().unwrap_or_else(|e| e.into_inner());
            stats += taken;
            let is_sound = || self.n_history_findings() == n_findings;
            if is_sound() || cancelled() {
                let report = outcome?;
                let differs = || self.depends_on_history(&report.x, &cancelled);
                if cancelled()
                    || !(differs()
                        || self.costs_depend_on_history(&checks, took, CostRule::whole(loss, &cancelled)))
                {
                    let of_run = (start.as_slice(), held.as_slice(), &report, &objective);
                    let found = self.findings(of_run, &tolerances, &cancelled, &mut stats);
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
        if n_beginnings > 1 {
            let sentence = format!("begun {n_beginnings} times: {HISTORY}");
            remarks.push(Finding::new(Severity::Note, "fit", sentence, ""));
        }
        let is_whole = worth.is_some() && held.is_empty();
        let (at_start, at_end) =
            self.plain_residuals((&start, &report.x), (residuals, loss), &cancelled, &mut stats);
        if let Some(at_end) = at_end.as_deref().filter(|_| is_whole && is_over(&report.termination)) {
            let (from, to) = ((start.as_slice(), at_start.as_deref()), (report.x.as_slice(), at_end));
            remarks.extend(self.check_after_fit(from, to, &cancelled, &mut stats));
        }
        let outputs =
            at_end.map_or_else(Vec::new, |at_end| self.output_fits_of(&at_end, at_start.as_deref()));
        let worth = worth.filter(|_| objective.has_worth()).and_then(|mut options| {
            options.workers = options.workers.or(described.workers);
            options.held.extend(&held);
            let asked = WorthOptions { loss, is_likelihood: objective.is_likelihood(), ..options };
            self.worth_of_fit((&report, &found), &tolerances, asked, (&cancelled, &mut stats))
        });
        let start_cost =
            report.trace.iter().find(|e| e.x == start.as_slice()).and_then(|e| e.outcome.value());
        let mut rms = |x: &[f64], cost: Option<f64>| {
            // Of another cost the residuals have to be known.
            match objective.is_sum_of_squares() {
                true => cost.map(|cost| self.rms(x, cost, loss)),
                false => self.cost_and_rms(x, (&objective, loss), &cancelled, &mut stats).map(|(_, rms)| rms),
            }
        };
        let names: Vec<String> = self.parameters().iter().map(|p| p.name().to_owned()).collect();
        let mut shown_names: Vec<String> =
            self.parameters().iter().map(|p| p.shown_name().to_owned()).collect();
        if shown_names == names {
            shown_names.clear();
        }
        let description = self.fmu().description();
        let unit = |p: &Parameter| p.unit(description).map(str::to_owned);
        Ok(Fit {
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
            start_rms: rms(&start, start_cost),
            objective: objective.name().to_owned(),
            start,
            stages: Vec::new(),
            at_bound: found.at_bound,
            without_effect: found.without_effect,
            n_checks: found.n_checks,
            n_beginnings,
            stats,
            solver: solver.clone(),
            report,
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

    /// What the result of a run is worth; `None` where it cannot be found out, or shall not.
    pub(crate) fn worth_of_fit(
        &self,
        (report, found): (&Report, &Findings),
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
            residuals: report.residuals.as_deref().filter(|r| r.len() == self.n_residuals()),
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

    /// Typical size of a parameter: what the user said, else the model's nominal value, else the width of its box,
    /// else its start value; none if that is zero. On a log scale: of its logarithm.
    fn known_size(&self, parameter: &Parameter, start: f64) -> Option<f64> {
        let (lower, upper) = (parameter.lower(), parameter.upper());
        let usable = |size: f64| (size.is_finite() && size > 0.0).then_some(size);
        match parameter.scale_kind() {
            Scale::Log => Some(usable((upper / lower).ln()).unwrap_or(1.0)),
            Scale::Linear => {
                let variable = parameter.variable().and_then(|name| self.fmu().description().variable(name));
                // That of the model is in the unit of the model.
                let nominal = variable.filter(|_| parameter.given_unit().is_none()).and_then(|v| v.nominal);
                parameter
                    .nominal_size()
                    .or(nominal)
                    .and_then(|n| usable(n.abs()))
                    .or_else(|| usable(upper - lower))
                    .or_else(|| usable(start.abs()))
            }
        }
    }

    /// The same; 1 where nothing is known.
    pub(crate) fn size_of(&self, parameter: &Parameter, start: f64) -> f64 {
        self.known_size(parameter, start).unwrap_or(1.0)
    }
}
