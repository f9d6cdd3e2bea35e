//! The search for the best point, with what comes before it: the objective meets an optimiser.

use super::engine::Engine;
use super::fresh::Fresh;
use super::noise::NoiseRule;
use super::options::{FitObserver, FitOptions};
use super::tolerance::AtStart;
use crate::cost::calibration::Calibration;
use crate::cost::process::HIDDEN_STATE;
use crate::cost::residual::sum_of_squares;
use crate::cost::solver::Solver;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::{CurrentPhase, FitPhase};
use crate::problem::objective::CostKind;
use crate::problem::parameter::{Parameter, Scale};
use crate::uncertainty::active_bounds::Findings;
use crate::uncertainty::estimate::{UncertaintyOptions, digits};
use crate::uncertainty::preflight::{Preflight, PreflightOptions};
use base::RunContext;
use dfo::{
    Answer, AnyMethod, ByRef, Evaluator, GivesUp, Kind, Measure, NothingFound, Objective, Outcome, Polled,
    ProblemClass, Query, Report, Resume, RobustLoss, RunOptions, Search, Termination, Tolerances, Trace,
    Wait, Want,
};
use ode::{Number, Stats};
use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::thread::available_parallelism;

/// The objective of one fit, which adds up what its simulations take.
struct Counted<'a> {
    calibration: &'a Calibration,
    cutoffs: bool,
    kind: &'a CostKind,
    loss: RobustLoss,
    start: &'a [f64],
    /// The residuals there, as they count, where they are known already.
    at_start: Option<Vec<f64>>,
    stats: Mutex<(Stats, KeptResiduals)>,
}

impl Counted<'_> {
    /// The query to the simulations: they always give residuals.
    fn asked<'q>(&self, query: &Query<'q>) -> Query<'q> {
        let mut query = *query;
        query.want = Want::Residuals;
        if !self.cutoffs {
            query.cutoff = f64::INFINITY;
        }
        query
    }

    /// The answer at the start, where it is known; whether it is.
    fn know(&self, x: &[f64], answer: &mut Answer) -> bool {
        let Some(residuals) = self.at_start.as_ref().filter(|_| x == self.start) else { return false };
        answer.residuals.clone_from(residuals);
        answer.outcome = Outcome::Value(sum_of_squares(residuals));
        true
    }

    fn count(&self, stats: Stats) {
        // A poisoned lock is no reason to fail: the counts are whole at every instant.
        self.stats.lock().unwrap_or_else(|e| e.into_inner()).0 += stats;
    }

    /// Makes of the residuals at a point what is minimised.
    fn finish(&self, x: &[f64], wanted: Want, answer: &mut Answer) {
        let mut own = Vec::new();
        if let Some(sum) = answer.outcome.value() {
            // A function of the user's may take its time.
            let layout = self.calibration.residual_layout();
            answer.outcome = self.kind.outcome(layout, (sum, &answer.residuals), &mut own);
            if let Some(cost) = answer.outcome.value() {
                let mut known = self.stats.lock().unwrap_or_else(|e| e.into_inner());
                known.1.note((x, self.start), cost, &answer.residuals);
            }
            if !self.kind.is_sum_of_squares() {
                answer.residuals = own;
            }
        }
        if wanted == Want::Cost {
            answer.residuals.clear();
        }
    }
}

impl Objective for Counted<'_> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        if !self.know(x, answer) {
            let mut stats = Stats::default();
            self.calibration.evaluate_counted(x, (&self.asked(query), self.loss), answer, &mut stats);
            self.count(stats);
        }
        self.finish(x, query.want, answer);
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

/// A fit's simulations on an engine.
struct OnEngine<'a, 'e> {
    counted: &'a Counted<'a>,
    engine: &'a mut (dyn Engine + 'e),
    under_way: HashMap<u64, (Vec<f64>, Want)>,
    /// Points whose answer is known.
    known: VecDeque<(u64, Answer)>,
}

impl Evaluator for OnEngine<'_, '_> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        let mut answer = Answer::default();
        if self.counted.know(x, &mut answer) {
            self.counted.finish(x, query.want, &mut answer);
            self.known.push_back((query.id, answer));
            return;
        }
        self.under_way.insert(query.id, (x.to_vec(), query.want));
        self.engine.submit(x, self.counted.asked(&query));
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
        if let Some((id, known)) = self.known.pop_front() {
            *answer = known;
            return Polled::Answered(id);
        }
        let polled = self.engine.poll(wait, answer);
        self.counted.count(self.engine.take_stats());
        if let Polled::Answered(id) = polled
            && let Some((x, want)) = self.under_way.remove(&id)
        {
            self.counted.finish(&x, want, answer);
        }
        polled
    }

    fn cancel(&mut self, id: u64) {
        self.engine.cancel(id);
    }

    fn width(&self) -> usize {
        self.engine.width()
    }

    fn gives_up(&self) -> GivesUp {
        if self.counted.cutoffs { GivesUp::Yes } else { GivesUp::No }
    }

    fn leave(&mut self) -> bool {
        self.engine.leave()
    }
}

/// Part of the limits that earlier searches have used.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Spent {
    pub(super) n_evaluations: usize,
    pub(super) n_iterations: usize,
    pub(super) seconds: f64,
}

/// Options of a fit, checked, with its clock.
pub(super) struct Job<'a> {
    pub(super) run: RunOptions<AnyMethod>,
    pub(super) start: Vec<f64>,
    pub(super) held: Vec<usize>,
    pub(super) cutoffs: bool,
    pub(super) objective: CostKind,
    pub(super) loss: RobustLoss,
    pub(super) noise: NoiseRule,
    pub(super) wants_preflight: bool,
    pub(super) uncertainty: Option<UncertaintyOptions>,
    pub(super) observer: RefCell<Option<Box<FitObserver<'a>>>>,
    pub(super) engine: Option<Rc<RefCell<dyn Engine>>>,
    pub(super) phase: Arc<CurrentPhase>,
    /// Who may end it, and its time.
    pub(super) context: RunContext<'a>,
    /// True if it is a part of a fit, which has chosen the tolerance.
    pub(super) is_part: bool,
    /// Of the limits, by searches before.
    pub(super) spent: Spent,
    /// The residuals at the start, as they count, where they were known before the search.
    pub(super) at_start: RefCell<Option<Vec<f64>>>,
}

impl<'a> Job<'a> {
    pub(super) fn new(
        calibration: &Calibration,
        options: FitOptions<'a>,
        within: Option<RunContext<'a>>,
    ) -> Result<Self, CalibrationError> {
        let is_part = within.is_some();
        let context = within.unwrap_or_else(|| options.context.within(options.run.limits.max_time));
        let mut run = options.run;
        options.objective.check(calibration.residual_layout(), !options.loss.is_linear())?;
        if options.noise == NoiseRule::Estimated
            && !(options.objective.is_sum_of_squares() && options.loss.is_linear())
        {
            return Err(CalibrationError::Setup(
                "noise 'estimated' belongs to the sum of squares without a robust loss; the objective 'likelihood' estimates the noise by itself"
                    .to_owned(),
            ));
        }
        run.workers.get_or_insert_with(|| available_parallelism().map_or(1, usize::from));
        let start = options.start.unwrap_or_else(|| calibration.start());
        calibration.check_start(&start)?;
        if let Some(index) = options.held.iter().find(|&&i| i >= start.len()) {
            let n = start.len();
            return Err(CalibrationError::Setup(format!(
                "parameter {index} is held, but there are only {n}"
            )));
        }
        calibration.choose_method(&mut run, &options.held, &options.objective)?;
        Ok(Self {
            run,
            start,
            held: options.held,
            cutoffs: options.cutoffs && options.objective.is_sum_of_squares(),
            objective: options.objective,
            loss: options.loss,
            noise: options.noise,
            wants_preflight: options.preflight,
            uncertainty: options.uncertainty,
            observer: RefCell::new(options.observer),
            engine: options.engine,
            phase: options.phase,
            context,
            is_part,
            spent: Spent::default(),
            at_start: RefCell::default(),
        })
    }
}

/// Result of the search of a fit.
pub(super) struct Searched {
    pub(super) report: Report,
    pub(super) found: Findings,
    pub(super) residuals: KeptResiduals,
    pub(super) preflight: Option<Preflight>,
    pub(super) solver: Solver,
    /// Those that held.
    pub(super) tolerances: Tolerances,
    /// Findings of the search, about its tolerances and the noise.
    pub(super) raised: Vec<Finding>,
}

impl Calibration {
    /// The search for the best point, with what comes before it. `at_start`: the residuals at the start, as
    /// they count, where they are known.
    pub(super) fn search(
        &self,
        job: &Job<'_>,
        mut at_start: AtStart,
        stats: &mut Stats,
    ) -> Result<Searched, CalibrationError> {
        let Job { start, held, cutoffs, objective, loss, context, .. } = job;
        let (cutoffs, loss) = (*cutoffs, *loss);
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
        let solver = self.solver(context)?;
        job.phase.set(FitPhase::ModelTest);
        self.prepare()?;
        let problem = self.problem_hash(solver);
        let problem = if loss.is_linear() { problem } else { format!("{problem}, loss {loss}") };
        let is_usual = objective.is_sum_of_squares();
        described.problem =
            Some(if is_usual { problem } else { format!("{problem}, objective {}", objective.name()) });
        described.checkpoint = described.checkpoint.map(|checkpoint| self.tag(checkpoint, solver));
        let preflight = job.wants_preflight.then(|| {
            job.phase.set(FitPhase::Preflight);
            let options = PreflightOptions { start: Some(start.clone()), workers: described.workers, loss };
            self.preflight_counted(&options, &mut at_start, context, stats)
        });
        let preflight = preflight.transpose()?;
        let mut raised = Vec::new();
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
        if let Ok(remote) = &self.evaluator().remote {
            remote.set_checked();
        }
        let mut observer = job.observer.borrow_mut();
        let mut remark = None;
        let (report, found, residuals) = loop {
            let known = at_start.take().map(|(residuals, _)| residuals);
            job.at_start.borrow_mut().clone_from(&known);
            let counted = Counted {
                calibration: self,
                cutoffs,
                kind: objective,
                loss,
                start,
                at_start: known.clone(),
                stats: Mutex::new((Stats::default(), KeptResiduals::of_start(known))),
            };
            let limits = job.run.limits;
            described.limits.max_evaluations =
                limits.max_evaluations.map(|n| n.saturating_sub(job.spent.n_evaluations));
            described.limits.max_iterations =
                limits.max_iterations.map(|n| n.saturating_sub(job.spent.n_iterations));
            let mut engine = job.engine.as_ref().map(|engine| engine.borrow_mut());
            let run = match &mut engine {
                Some(engine) => {
                    engine.begin(self, loss);
                    let (under_way, known) = (HashMap::new(), VecDeque::new());
                    let on_engine = OnEngine { counted: &counted, engine: &mut **engine, under_way, known };
                    dfo::minimize_by(on_engine).with_residuals(counted.has_residuals()).loss(loss)
                }
                None => dfo::minimize(ByRef(&counted)),
            };
            let mut run = run
                .start(start)
                .bounds(&bound(Parameter::lower), &bound(Parameter::upper))
                .map_err(|e| self.name_parameter(e))?
                .transforms(&transforms)
                .kinds(&kinds)
                .known_scales(&sizes)
                .spent(context.elapsed())
                .options(described.clone());
            if let Some(observer) = &mut *observer {
                run = run.observer(|progress| {
                    let mut progress = *progress;
                    progress.n_evaluations += job.spent.n_evaluations;
                    progress.n_iterations += job.spent.n_iterations;
                    progress.seconds += job.spent.seconds;
                    observer(&progress)
                });
            }
            let outcome = run.context(*context).run().map_err(|error| match error {
                dfo::Error::NeedsResiduals { method } => CalibrationError::Setup(format!(
                    "{method} minimises sums of squares, and the objective '{}' is none: leave the method to the fit \
                     (method auto), or take nelder-mead",
                    objective.name()
                )),
                error => self.name_parameter(error),
            });
            job.phase.set(FitPhase::Checks);
            let (taken, residuals) = counted.stats.into_inner().unwrap_or_else(|e| e.into_inner());
            *stats += taken;
            let report = outcome?;
            let of_run = (start.as_slice(), held.as_slice(), &report, objective);
            let best = residuals.at((&report.x, start)).map(|known| (report.x.as_slice(), known));
            let best = best.filter(|_| job.uncertainty.is_some());
            let (found, again) = self.beside_fresh_process(best, loss, context, || {
                self.findings(of_run, &tolerances, context, stats)
            });
            match again {
                Fresh::Same => break (report, found, residuals),
                Fresh::Random => {
                    remark = Some(
                        "two evaluations of the best point in fresh processes differ: no cost can be reproduced",
                    );
                    break (report, found, residuals);
                }
                Fresh::Other => {
                    log::warn!(
                        "{}: {HIDDEN_STATE}: the fit begins anew",
                        self.fmu().description().model_name
                    );
                    remark = Some(HIDDEN_STATE);
                }
            }
            // What was stored, here or by an earlier fit, may depend on what ran before.
            described.checkpoint = described.checkpoint.map(|checkpoint| checkpoint.resume(Resume::Never));
            described.known.iter_mut().for_each(|known| known.problem = None);
        };
        raised.extend(remark.map(|sentence| Finding::new(Severity::Warning, "FMU", sentence, "")));
        Ok(Searched { report, found, residuals, preflight, solver: solver.clone(), tolerances, raised })
    }

    /// The start as the result of a search that had no time for a single evaluation.
    ///
    /// # Errors
    /// The error that ended the search, unless it is that.
    pub(super) fn start_alone(
        &self,
        job: &Job<'_>,
        error: CalibrationError,
    ) -> Result<Searched, CalibrationError> {
        let found = match error {
            CalibrationError::Cancelled if job.context.is_late() => {
                let trace = Trace::new(job.start.len());
                NothingFound { n_evaluations: 0, failures: Vec::new(), x: None, trace }
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
            job.context.elapsed().as_secs_f64(),
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
        })
    }

    /// Chooses the method of a run in which these entries of `x` are held, where the choice is open.
    pub(crate) fn choose_method(
        &self,
        run: &mut RunOptions<AnyMethod>,
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
        let class = ProblemClass {
            lower: &all.clone().map(|i| bound(i, Parameter::lower)).collect::<Vec<_>>(),
            upper: &all.clone().map(|i| bound(i, Parameter::upper)).collect::<Vec<_>>(),
            // What is held can have any value, and does not choose the method.
            kinds: &all.filter(is_free).map(|i| self.parameters()[i].value_kind()).collect::<Vec<_>>(),
            residuals: objective.has_residuals(),
            search: Search::Local,
        };
        run.choose(&class).map_err(|error| self.name_parameter(error))
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
}
