//! Search for the best point, and the steps before it.

use super::noise::NoiseRule;
use super::options::{FitObserver, FitOptions};
use super::simulation_executor::SimulationExecutor;
use crate::cost::residual::sum_of_squares;
use crate::cost::split::Slots;
use crate::error::CalibrationError;
use crate::findings::display_text::digits;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use crate::fit::live::{LiveFit, lock};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::{FitPhase, Phases};
use crate::loaded::budget::Budget;
use crate::loaded::calibration::Calibration;
use crate::loaded::effort::Effort;
use crate::problem::objective::{CostKind, reweighted_by_likelihood};
use crate::problem::parameter::{Parameter, Scale};
use crate::uncertainty::inactive_parameters::{EndedRun, InactiveParameters};
use crate::uncertainty::preflight::{Preflight, PreflightOptions};
use crate::uncertainty::result::UncertaintyOptions;
use base::{Number, RunContext};
use dfo::{
    Answer, AnyMethod, ByRef, CutoffUse, EvaluationKind, Evaluator, MethodOptions, NothingFound, Objective,
    Outcome, ParameterKind, PollResult, ProblemClass, Progress, Query, Record, Report, Resume, RobustLoss,
    RunOptions, Search, Termination, ToleranceMeasure, Tolerances, Trace, Wait,
};
use ode::Stats;
use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Objective of one fit, which adds up the cost of its simulations.
struct Counted<'a> {
    calibration: &'a Calibration,
    cutoffs: bool,
    kind: &'a CostKind,
    has_residuals: bool,
    loss: RobustLoss,
    start: &'a [f64],
    /// Residuals at the start, with weights and loss, if they are already known.
    at_start: Option<Vec<f64>>,
    stats: Mutex<Stats>,
    kept: Arc<Mutex<KeptResiduals>>,
    live: Option<&'a LiveFit>,
    slots: Slots,
}

impl Counted<'_> {
    /// Returns the query for the simulations, which always requests residuals.
    fn requested<'q>(&self, query: &Query<'q>) -> Query<'q> {
        let mut query = *query;
        query.kind = EvaluationKind::Residuals;
        if !self.cutoffs {
            query.cutoff = f64::INFINITY;
        }
        query
    }

    /// Fills in the answer at the start if it is known. Returns true if it is.
    fn know(&self, x: &[f64], answer: &mut Answer) -> bool {
        let Some(residuals) = self.at_start.as_ref().filter(|_| x == self.start) else { return false };
        answer.residuals.clone_from(residuals);
        answer.outcome = Outcome::Value(sum_of_squares(residuals));
        true
    }

    fn count(&self, stats: Stats) {
        *lock(&self.stats) += stats;
    }

    /// Converts the residuals at a point to the quantity to minimise.
    fn finish(&self, x: &[f64], wanted: EvaluationKind, answer: &mut Answer) {
        let mut custom_residuals = Vec::new();
        let criteria = self.calibration.take_criteria(&mut answer.residuals);
        if let Some(sum) = answer.outcome.value() {
            // No lock is held here because a user-defined function may be slow.
            let layout = self.calibration.residual_layout();
            let values = (&*answer.residuals, &*criteria);
            answer.outcome = self.calibration.outcome_of(self.kind, x, sum, values, &mut custom_residuals);
            if let Some(cost) = answer.outcome.value() {
                lock(&self.kept).note(x, cost, &answer.residuals);
            }
            if self.kind.is_likelihood() && wanted == EvaluationKind::Residuals {
                custom_residuals = reweighted_by_likelihood(layout, &answer.residuals);
            }
            if !self.kind.is_sum_of_squares() {
                answer.residuals = custom_residuals;
            }
        }
        if wanted == EvaluationKind::Cost {
            answer.residuals.clear();
        }
        self.calibration.constraints().nonlinear(x, &criteria, &mut answer.constraints);
    }
}

impl Objective for Counted<'_> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        if !self.know(x, answer) {
            let _running = self.live.map(|live| live.running(query.id, x));
            let mut stats = Stats::default();
            let (query, slots) = (self.requested(query), Some(&self.slots));
            self.calibration.evaluate_counted(x, &query, self.loss, slots, answer, &mut stats);
            self.count(stats);
        }
        self.finish(x, query.kind, answer);
    }

    fn uses_cutoff(&self) -> bool {
        self.cutoffs
    }

    fn has_residuals(&self) -> bool {
        self.has_residuals
    }

    fn residual_loss(&self) -> RobustLoss {
        self.loss
    }
}

/// Evaluator of a fit whose simulations run on an executor.
struct OnEngine<'a, 'e> {
    counted: &'a Counted<'a>,
    engine: &'a mut (dyn SimulationExecutor + 'e),
    under_way: HashMap<u64, (Vec<f64>, EvaluationKind)>,
    /// Points with known answers.
    answered: VecDeque<(u64, Answer)>,
}

impl Evaluator for OnEngine<'_, '_> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        let mut answer = Answer::default();
        if self.counted.know(x, &mut answer) {
            self.counted.finish(x, query.kind, &mut answer);
            self.answered.push_back((query.id, answer));
            return;
        }
        self.under_way.insert(query.id, (x.to_vec(), query.kind));
        self.counted.live.iter().for_each(|live| live.add(query.id, x));
        self.engine.submit(x, self.counted.requested(&query));
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        if let Some((id, answered)) = self.answered.pop_front() {
            *answer = answered;
            return PollResult::Answered(id);
        }
        let polled = self.engine.poll(wait, answer);
        self.counted.count(self.engine.take_stats());
        if let PollResult::Answered(id) = polled
            && let Some((x, kind)) = self.under_way.remove(&id)
        {
            self.counted.live.iter().for_each(|live| live.remove(id));
            self.counted.finish(&x, kind, answer);
        }
        polled
    }

    fn cancel(&mut self, id: u64) {
        self.counted.live.iter().for_each(|live| live.remove(id));
        self.engine.cancel(id);
    }

    fn width(&self) -> usize {
        self.engine.width()
    }

    fn cutoff_use(&self) -> CutoffUse {
        if self.counted.cutoffs { CutoffUse::Yes } else { CutoffUse::No }
    }

    fn leave(&mut self) -> bool {
        self.engine.leave()
    }

    fn n_lost(&self) -> usize {
        self.engine.n_lost()
    }
}

/// Returns the `x_tol` of least squares for the likelihood. The reweighted residuals bend within the standard
/// errors of the most precise output, which may be smaller than `x_tol`. Without the factor, 6 of 31 fits
/// ended more than 1e-4 of the variances above the minimum, one of them 14 %. With it, all 31 are within
/// 2e-5, for 20 % more evaluations (`tests/all/likelihood.rs`, ignored test).
fn x_tol_of_likelihood(x_tol: f64) -> f64 {
    (0.01 * x_tol).max(1e-6).min(x_tol)
}

/// Part of the limits that earlier searches have used.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct UsedLimits {
    pub(crate) n_evaluations: usize,
    pub(crate) n_iterations: usize,
    pub(crate) seconds: f64,
}

impl UsedLimits {
    pub(crate) fn of(report: &Report) -> Self {
        let Report { n_evaluations, n_iterations, seconds, .. } = *report;
        Self { n_evaluations, n_iterations, seconds }
    }

    /// Returns the progress of the whole fit, given the progress of a later search.
    pub(crate) fn before<'p>(&self, progress: &Progress<'p>) -> Progress<'p> {
        let mut whole = *progress;
        whole.n_evaluations += self.n_evaluations;
        whole.n_iterations += self.n_iterations;
        whole.seconds += self.seconds;
        whole
    }
}

/// Checked options of a fit, with its clock.
pub(crate) struct Job<'a> {
    pub(crate) run: RunOptions<AnyMethod>,
    /// Requested options by name.
    pub(crate) requested: Record,
    pub(crate) start: Vec<f64>,
    pub(crate) held: Vec<usize>,
    pub(crate) cutoffs: bool,
    pub(crate) objective: CostKind,
    pub(crate) loss: RobustLoss,
    pub(crate) noise: NoiseRule,
    pub(crate) has_preflight: bool,
    pub(crate) uncertainty: Option<UncertaintyOptions>,
    pub(crate) observer: RefCell<Option<Box<FitObserver<'a>>>>,
    pub(crate) engine: Option<Rc<RefCell<dyn SimulationExecutor>>>,
    pub(crate) phases: RefCell<Phases>,
    pub(crate) live: Option<Arc<LiveFit>>,
    /// Context that can interrupt the fit, with its time limit.
    pub(crate) context: RunContext<'a>,
    /// True if the job is part of a fit that has already chosen the tolerance.
    pub(crate) is_part: bool,
    /// True if only the parameters that no stage frees are fixed, so that the result can be used to check the
    /// problem.
    pub(crate) is_whole: bool,
    /// Part of the limits that earlier searches have used.
    pub(crate) spent: UsedLimits,
    /// Residuals at the start, with weights and loss, if they were known before the search.
    pub(crate) at_start: RefCell<Option<Vec<f64>>>,
}

impl<'a> Job<'a> {
    pub(crate) fn new(
        calibration: &Calibration,
        options: FitOptions<'a>,
        within: Option<RunContext<'a>>,
    ) -> Result<Self, CalibrationError> {
        let mut options = options;
        if !calibration.problem().goals.is_empty() {
            (options.objective, options.uncertainty) = (CostKind::Goals, None);
        }
        let is_part = within.is_some();
        let context = within.unwrap_or_else(|| options.context.within(options.run.limits.max_time));
        let requested = options.record()?;
        let mut run = options.run;
        options.objective.check(calibration.residual_layout(), !options.loss.is_linear())?;
        if options.noise == NoiseRule::Estimated
            && !(options.objective.is_sum_of_squares() && options.loss.is_linear())
        {
            return Err(CalibrationError::Setup(
                "noise 'estimated' requires the sum of squares without a robust loss. The objective 'likelihood' also estimates the noise"
                    .to_owned(),
            ));
        }
        let output = calibration.residual_layout().outputs.iter().find(|output| output.is_noise_known);
        if let Some(output) = output
            && (options.noise == NoiseRule::Estimated || options.objective.is_likelihood())
        {
            return Err(CalibrationError::Setup(format!(
                "the noise of '{}' is known (sigma), but the fit was asked to estimate it. Use the sum of squares with noise 'auto', or omit sigma",
                output.variable
            )));
        }
        let weights = calibration.problem().experiments.iter().flat_map(|e| &e.outputs);
        if let Some(model) = weights.filter_map(|output| output.weight.error_model()).next()
            && !(options.objective.is_sum_of_squares() && options.loss.is_linear())
        {
            return Err(CalibrationError::Setup(format!(
                "sigma '{model}' depends on simulated values, which requires the sum of squares without a robust loss. Use a column or a number \
                 as sigma, or omit the loss and the objective"
            )));
        }
        calibration.problem().check_logarithms(options.noise == NoiseRule::Estimated)?;
        run.workers.get_or_insert_with(base::available_cores);
        let mut start = options.start.unwrap_or_else(|| calibration.start());
        // An angle outside of its period is the same point as one inside.
        for (value, parameter) in start.iter_mut().zip(calibration.parameters()) {
            if !(parameter.lower()..=parameter.upper()).contains(value) {
                *value = parameter.reported(*value);
            }
        }
        calibration.check_start(&start)?;
        run.constraints = calibration.constraints().of_search(run.constraints.tolerance);
        if let Some(index) = options.held.iter().find(|&&i| i >= start.len()) {
            let n = start.len();
            return Err(CalibrationError::Setup(format!(
                "held: parameter index {index} is not below the number of parameters, {n}"
            )));
        }
        Ok(Self {
            run,
            requested,
            start,
            is_whole: options.held.is_empty(),
            held: options.held,
            // The criteria of a simulation are known at its end.
            cutoffs: options.cutoffs
                && options.objective.is_sum_of_squares()
                && calibration.evaluator().n_criteria() == 0,
            objective: options.objective,
            // The loss applies to outliers of measurements, not to priors.
            loss: options.loss.sparing(calibration.residual_layout().priors.len()),
            noise: options.noise,
            has_preflight: options.preflight,
            uncertainty: options.uncertainty,
            observer: RefCell::new(options.observer),
            engine: options.engine,
            phases: RefCell::new(Phases::new(options.phase)),
            live: options.live,
            context,
            is_part,
            spent: UsedLimits::default(),
            at_start: RefCell::default(),
        })
    }
}

impl Job<'_> {
    /// Resets the job for a restart with another way of resetting the model. Stored results, of this fit
    /// or of an earlier one, are ignored because they may depend on previous evaluations.
    pub(super) fn restart(&mut self, run: RunOptions<AnyMethod>, has_preflight: bool) {
        (self.run, self.has_preflight) = (run, has_preflight);
        self.run.checkpoint = self.run.checkpoint.take().map(|checkpoint| checkpoint.resume(Resume::Never));
        self.run.evaluated.iter_mut().for_each(|point| point.problem = None);
        self.spent = UsedLimits::default();
    }

    /// True if standard errors are requested and the objective supports them.
    pub(crate) fn has_uncertainty(&self) -> bool {
        self.uncertainty.is_some() && self.objective.has_uncertainty()
    }

    /// Begins a phase. `stats` counts all simulations of the fit so far.
    pub(crate) fn enter(&self, phase: FitPhase, stats: &Stats) {
        self.phases.borrow_mut().enter(phase, stats);
    }

    /// True if the problem is checked again at the result.
    pub(super) fn is_checked(&self) -> bool {
        self.is_whole && self.uncertainty.is_some()
    }
}

/// Result of the search of a fit.
pub(crate) struct SearchResult {
    pub(crate) report: Report,
    pub(crate) inactive: InactiveParameters,
    pub(crate) residuals: KeptResiduals,
    /// Cost at the start, if an evaluation of the fit computed it.
    pub(crate) start_cost: Option<f64>,
    pub(crate) preflight: Option<Preflight>,
    /// Tolerances that the search used.
    pub(crate) tolerances: Tolerances,
    /// Findings of the search about its tolerances and the noise.
    pub(crate) raised: Vec<Finding>,
}

/// Raises the relative `f_tol` of a run to the noise of the simulations if the noise is larger.
fn raise_f_tol(tolerances: &mut Tolerances, preflight: &Preflight) -> Option<Finding> {
    let is_larger = preflight.f_tol_above_noise(tolerances.f_tol) > tolerances.f_tol;
    (tolerances.measure == ToleranceMeasure::Relative && is_larger).then(|| {
        tolerances.f_tol = preflight.noise;
        let noise = digits(preflight.noise);
        let sentence = format!(
            "f_tol was raised to the noise of the simulations, {noise}. Smaller changes of the cost are simulation errors"
        );
        let remedy = "Set a smaller relative_tolerance if f_tol must be smaller";
        Finding::note(FindingId::RaisedFTol, "f_tol", sentence, remedy)
    })
}

/// Returns the cost at the start if a run computed it.
pub(super) fn start_cost_in(report: &Report, start: &[f64]) -> Option<f64> {
    let of_trace = report.trace.iter().find(|e| e.x == start).and_then(|e| e.outcome.value());
    of_trace.or_else(|| Some(report.fun).filter(|fun| report.trace.is_empty() && fun.is_finite()))
}

impl Calibration {
    /// Searches for the best point, after the preparation and the preflight.
    pub(super) fn search(&self, job: &Job<'_>, stats: &mut Stats) -> Result<SearchResult, CalibrationError> {
        let Job { start, context, .. } = job;
        let mut at_start = None;
        job.enter(FitPhase::ModelTest, stats);
        self.prepare()?;
        let mut run = self.run_of_search(job);
        let preflight = job.has_preflight.then(|| {
            job.enter(FitPhase::Preflight, stats);
            let (workers, loss) = (run.workers, job.loss);
            let options = PreflightOptions { start: Some(start.clone()), workers, loss };
            self.preflight_counted(&options, &mut at_start, context, stats)
        });
        let preflight = preflight.transpose()?;
        let raised: Vec<Finding> =
            preflight.iter().filter_map(|found| raise_f_tol(&mut run.tolerances, found)).collect();
        job.enter(FitPhase::Search, stats);
        if let Some(at_start) = &at_start {
            // This simulation is the first evaluation of the search.
            let effort = Effort::of(
                &at_start.stats,
                Duration::try_from_secs_f64(at_start.stats.seconds.get()).unwrap_or_default(),
            );
            job.phases.borrow_mut().move_part(effort, FitPhase::Preflight, FitPhase::Search);
        }
        let at_start = at_start.take().map(|at_start| at_start.residuals);
        job.at_start.borrow_mut().clone_from(&at_start);
        let (report, residuals) = self.run_once(job, &run, at_start, stats)?;
        job.enter(FitPhase::Checks, stats);
        let ended = EndedRun {
            start,
            held: &job.held,
            report: &report,
            kind: &job.objective,
            tolerances: &run.tolerances,
            has_errors: job.has_uncertainty(),
        };
        let mut budget = Budget::after(report.n_evaluations);
        let inactive = self.inactive_parameters(&ended, &mut budget, context, stats);
        Ok(SearchResult {
            start_cost: start_cost_in(&report, start),
            report,
            inactive,
            residuals,
            preflight,
            tolerances: run.tolerances,
            raised,
        })
    }

    /// Returns the options of the optimiser for a search, with the identity of its problem and the limits
    /// that earlier searches have left.
    fn run_of_search(&self, job: &Job<'_>) -> RunOptions<AnyMethod> {
        let mut run = job.run.clone();
        let mut problem = self.problem_hash();
        if !job.loss.is_linear() {
            problem += &format!(", loss {}", job.loss);
            if self.has_priors() {
                problem += ", quadratic priors";
            }
        }
        if !job.objective.is_sum_of_squares() {
            problem += &format!(", objective {}", job.objective.name());
        }
        run.problem = Some(problem);
        run.checkpoint = run.checkpoint.map(|checkpoint| self.tag(checkpoint));
        let left = |limit: Option<usize>, spent: usize| limit.map(|n| n.saturating_sub(spent));
        run.limits.max_evaluations = left(run.limits.max_evaluations, job.spent.n_evaluations);
        run.limits.max_iterations = left(run.limits.max_iterations, job.spent.n_iterations);
        run
    }

    /// Runs the optimiser once. `at_start`: the residuals at the start, with weights and loss, if they are
    /// known.
    fn run_once(
        &self,
        job: &Job<'_>,
        run: &RunOptions<AnyMethod>,
        at_start: Option<Vec<f64>>,
        stats: &mut Stats,
    ) -> Result<(Report, KeptResiduals), CalibrationError> {
        let Job { start, held, objective, loss, context, .. } = job;
        let parameters = self.parameters();
        let bound = |side: fn(&Parameter) -> f64| {
            let mut bounds: Vec<f64> = parameters.iter().map(side).collect();
            held.iter().for_each(|&i| bounds[i] = start[i]);
            bounds
        };
        let transforms: Vec<Scale> = parameters.iter().map(Parameter::scale_kind).collect();
        let mut kinds: Vec<ParameterKind> = parameters.iter().map(Parameter::value_kind).collect();
        // Fixed parameters can have any value and must not affect the choice of the method.
        held.iter().for_each(|&i| kinds[i] = ParameterKind::Continuous);
        let sizes: Vec<Option<f64>> = parameters.iter().map(|p| self.given_size(p)).collect();
        let kept = Arc::new(Mutex::new(KeptResiduals::new(start, at_start.clone())));
        let live = job.live.as_deref();
        live.iter().for_each(|live| live.begin(self.residual_layout(), *loss, &kept));
        let counted = Counted {
            calibration: self,
            cutoffs: job.cutoffs,
            kind: objective,
            // A search for a front receives the goals as residuals.
            has_residuals: matches!(run.method, AnyMethod::Nsga2(_)) || self.has_residuals(objective, start),
            loss: *loss,
            start,
            at_start,
            stats: Mutex::default(),
            kept: Arc::clone(&kept),
            live,
            slots: Slots::new(run.workers.unwrap_or(1).max(1)),
        };
        let mut options = run.clone();
        if objective.is_likelihood() && run.method.needs_residuals() {
            options.tolerances.x_tol = x_tol_of_likelihood(run.tolerances.x_tol);
        }
        let mut observer = job.observer.borrow_mut();
        let mut engine = job.engine.as_ref().map(|engine| engine.borrow_mut());
        let search = match &mut engine {
            Some(engine) => {
                engine.begin(self, *loss);
                let (under_way, answered) = (HashMap::new(), VecDeque::new());
                let on_engine = OnEngine { counted: &counted, engine: &mut **engine, under_way, answered };
                dfo::minimize_by(on_engine).with_residuals(counted.has_residuals()).loss(*loss)
            }
            None => dfo::minimize(ByRef(&counted)),
        };
        let mut search = search
            .start(start)
            .bounds(&bound(Parameter::search_lower), &bound(Parameter::search_upper))
            .map_err(|e| self.name_parameter(e))?
            .transforms(&transforms)
            .kinds(&kinds)
            .optional_scales(&sizes)
            .spent(context.elapsed())
            .options(options);
        if observer.is_some() || live.is_some() {
            search = search.observer(|progress| {
                live.iter().for_each(|live| live.note(progress));
                observer
                    .as_mut()
                    .map_or(ControlFlow::Continue(()), |observer| observer(&job.spent.before(progress)))
            });
        }
        let outcome = search.context(*context).run().map_err(|error| match error {
            dfo::Error::NeedsResiduals { method } if objective.is_likelihood() => CalibrationError::Setup(format!(
                "{method} minimises the objective 'likelihood' only if the start is nearer to the priors: their squares exceed the number of \
                 residuals. Use another start, or method auto"
            )),
            dfo::Error::NeedsResiduals { method } => CalibrationError::Setup(format!(
                "{method} requires a sum of squares, and the objective '{}' is not one. Use method auto or nelder-mead",
                objective.name()
            )),
            error => self.name_parameter(error),
        });
        let outcome = outcome.map(|mut report| {
            if objective.is_likelihood() {
                // The residuals of the search are weighted, and so are their derivatives.
                (report.residuals, report.jacobian, report.active) = (None, None, Vec::new());
            }
            report
        });
        *stats += *lock(&counted.stats);
        // Other threads can still read the residuals of a live fit.
        let residuals = match live {
            Some(_) => lock(&kept).clone(),
            None => std::mem::take(&mut *lock(&kept)),
        };
        let mut report = outcome?;
        report.x.iter_mut().zip(parameters).for_each(|(x, p)| *x = p.reported(*x));
        Ok((report, residuals))
    }

    /// Returns the start as the result of a search that had no time for a single evaluation.
    ///
    /// # Errors
    /// Returns the error that ended the search if the cause was not the time limit.
    pub(super) fn start_alone(
        &self,
        job: &Job<'_>,
        error: CalibrationError,
    ) -> Result<SearchResult, CalibrationError> {
        let found = match error {
            CalibrationError::Cancelled if job.context.is_late() => {
                let trace = Trace::new(job.start.len());
                NothingFound { n_evaluations: 0, n_infeasible: 0, failures: Vec::new(), x: None, trace }
            }
            CalibrationError::Optimiser(dfo::Error::EndedWithoutPoint {
                termination: Termination::MaxTime,
                found,
            }) => *found,
            error => return Err(self.over_or(error)),
        };
        let mut report = Report::without_cost(
            &job.start,
            job.run.method.name(),
            found,
            job.context.elapsed().as_secs_f64(),
        );
        let residuals = KeptResiduals::new(&job.start, job.at_start.take());
        if let Some(residuals) = residuals.at_start() {
            let (layout, sum) = (self.residual_layout(), sum_of_squares(residuals));
            let outcome = job.objective.outcome(layout, sum, residuals, &mut Vec::new());
            report.fun = outcome.value().unwrap_or(f64::NAN);
        }
        report.message = format!(
            "stopped at the time limit of {} s before the first evaluation of the search. The result is the start",
            Number(job.run.limits.max_time.unwrap_or_default().as_secs_f64())
        );
        report.workers = job.run.workers.unwrap_or(1);
        report.loss = job.loss;
        Ok(SearchResult {
            start_cost: start_cost_in(&report, &job.start),
            report,
            inactive: InactiveParameters::default(),
            residuals,
            preflight: None,
            tolerances: job.run.tolerances,
            raised: Vec::new(),
        })
    }

    /// True if least squares can minimise the cost. The squares of priors enter the sum of squares of a
    /// likelihood by their exponential, which has a useful linear model only if they do not exceed the number
    /// of residuals.
    fn has_residuals(&self, objective: &CostKind, start: &[f64]) -> bool {
        let layout = self.residual_layout();
        let mut priors = vec![0.0; layout.priors.len()];
        let mut squares = || self.evaluator().prior_residuals(start, &mut priors);
        let n = layout.outputs.iter().map(|output| output.noisy_rows().count()).sum::<usize>();
        objective.has_residuals()
            && (!objective.is_likelihood() || squares().is_ok_and(|squares| squares <= n as f64))
    }

    /// Chooses the method of a run if the choice is open. `held` contains the fixed entries of `x`.
    pub(crate) fn choose_method(
        &self,
        run: &mut RunOptions<AnyMethod>,
        start: &[f64],
        held: &[usize],
        objective: &CostKind,
    ) -> Result<(), CalibrationError> {
        let is_free = |i: &usize| {
            let parameter = &self.parameters()[*i];
            !held.contains(i) && parameter.lower() < parameter.upper()
        };
        let all = 0..self.parameters().len();
        let bound = |i: usize, side: fn(&Parameter) -> f64| {
            if is_free(&i) { side(&self.parameters()[i]) } else { 0.0 }
        };
        let kind = |i: usize| {
            if is_free(&i) { self.parameters()[i].value_kind() } else { ParameterKind::Continuous }
        };
        let class = ProblemClass {
            lower: &all.clone().map(|i| bound(i, Parameter::search_lower)).collect::<Vec<_>>(),
            upper: &all.clone().map(|i| bound(i, Parameter::search_upper)).collect::<Vec<_>>(),
            // Fixed parameters can have any value and must not affect the choice of the method.
            kinds: &all.map(kind).collect::<Vec<_>>(),
            residuals: self.has_residuals(objective, start),
            search: Search::Local,
            linear: !run.constraints.linear.is_empty(),
            nonlinear: !run.constraints.nonlinear.is_empty(),
            equalities: run.constraints.nonlinear.iter().any(|limits| limits.lower == limits.upper),
        };
        run.choose(&class).map_err(|error| self.name_parameter(error))
    }

    /// Replaces the index of a parameter in an error by its name. Replaces a failure reason from a worker
    /// process by its explanation.
    pub(crate) fn name_parameter(&self, mut source: dfo::Error) -> CalibrationError {
        if let (dfo::Error::AllStartsFailed(found), Ok(remote)) = (&mut source, &self.evaluator().remote) {
            found.failures.iter_mut().for_each(|(reason, _)| remote.explain_reason(reason));
        }
        let texts = self.constraints().texts();
        match &source {
            dfo::Error::Infeasible { constraint: Some(k) } if *k < texts.len() => {
                return CalibrationError::Setup(format!(
                    "no parameter values satisfy the constraints: '{}' contradicts the bounds and the constraints before it",
                    texts[*k]
                ));
            }
            dfo::Error::DiscreteConstraint { constraint, index, kind } if *constraint < texts.len() => {
                return CalibrationError::Setup(format!(
                    "constraint '{}': '{}' is {kind}, but linear constraints require continuous parameters",
                    texts[*constraint],
                    self.parameters()[*index].name()
                ));
            }
            _ => {}
        }
        match source.parameter() {
            Some(index) => {
                let name = self.parameters()[index].name().to_owned();
                CalibrationError::OptimiserParameter { index, name, source: Box::new(source) }
            }
            None => source.into(),
        }
    }

    /// Checks a start for this fit by the rules for the start values of the parameters.
    fn check_start(&self, start: &[f64]) -> Result<(), CalibrationError> {
        self.check_length(start)?;
        for (parameter, value) in self.parameters().iter().zip(start) {
            let (lower, upper) = (parameter.lower(), parameter.upper());
            if !(lower..=upper).contains(value) {
                let name = parameter.name().to_owned();
                let is_fixed = lower == upper;
                let [lower, upper, value] = [lower, upper, *value].map(Number);
                let message = if is_fixed {
                    format!("is fixed at {lower} and cannot start at {value}")
                } else {
                    format!("start {value} is outside of the bounds {lower} and {upper}")
                };
                return Err(CalibrationError::Parameter { name, message });
            }
        }
        self.evaluator().check_derived_at(start)
    }
}
