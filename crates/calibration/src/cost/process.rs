//! Worker processes of a model or a problem.

use crate::cost::accuracy::Accuracy;
use crate::cost::comparison::{Comparisons, FirstQuestion, NOT_REPRODUCED, ProcessChoice, bits_of};
use crate::cost::failure::{CostFailure, ReportedCostFailure};
use crate::cost::parallel::map;
use crate::cost::request::{Evaluated, Job, Loaded, evaluated, trajectory_of, unsaid, wrong};
use crate::cost::residual::CostRule;
use crate::error::CalibrationError;
use crate::problem::definition::{ModelFile, Problem};
use crate::problem::settings::SimulationSettings;
use base::RunContext;
use dfo::{FailureKind, RobustLoss};
use fmi::error::ReportedError;
use fmi::worker::{
    AnswerLimits, Frame, FrameSize, Held, Isolation, Load, Question, Repeat, RequestedProcess, WorkerLimits,
    Workers, check_sandbox,
};
use fmi::{FmiError, Fmu, Reuse, Trajectory};
use ode::Stats;
use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Settings of the evaluation of a point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Evaluation {
    /// Accuracy, if it differs from the accuracy of the problem.
    pub(crate) accuracy: Option<Accuracy>,
    pub(crate) process: ProcessChoice,
    /// Index of the only recording to simulate. `None`: all, followed by the priors.
    pub(crate) recording: Option<usize>,
}

impl Evaluation {
    /// Evaluates all recordings with the accuracy of the problem.
    pub(crate) const fn whole(process: ProcessChoice) -> Self {
        Self { accuracy: None, process, recording: None }
    }
}

/// Best point of a search, with its residuals if they are known.
pub(crate) struct BestPoint {
    pub(crate) x: Vec<f64>,
    /// Number of residuals, and of values with the criteria.
    pub(crate) n_residuals: usize,
    pub(crate) n_values: usize,
    pub(crate) residuals: Option<Vec<f64>>,
    /// Cost of the search, if it is the sum of squares and the residuals are unknown.
    pub(crate) cost: Option<f64>,
}

/// Introduction of the messages that a model logs when a failed request is repeated with logging.
const LOG_ON: &str = "repeated with logging of the model";

/// Worker processes that have loaded one problem or model.
#[derive(Debug)]
pub(super) struct Processes {
    fmu: Fmu,
    pub(super) workers: Arc<Workers>,
    load: Load,
    /// Load job with the log of the model switched on.
    logging: Load,
    /// Failures without a message of the model, by reason, with the messages that a repeated simulation
    /// logged.
    explained: Mutex<BTreeMap<String, Option<String>>>,
    comparisons: Comparisons,
    /// Frames for reuse.
    frames: Mutex<Vec<(Frame, Frame)>>,
}

impl Processes {
    /// Prepares the processes for this load job.
    pub(super) fn new(
        fmu: &Fmu,
        limits: WorkerLimits,
        load: Job,
        lender: Option<&Load>,
    ) -> Result<Self, FmiError> {
        let workers = workers_of(fmu, limits)?;
        let job = Arc::new(load);
        let plain = Arc::clone(&job);
        let is_kept = matches!(*job, Job::Open(..));
        let load = Load::new(move || Frame::of(&*plain));
        let logging = Load::new(move || {
            let mut job: Job = Frame::of(&*job)?.head()?;
            job.switch_log_on();
            Frame::of(&job)
        });
        let load = lender.into_iter().fold(load, Load::in_processes_of);
        let load = if is_kept { load.kept() } else { load };
        fmu.note_needed_tool();
        workers.prepare(&load);
        Ok(Self {
            fmu: fmu.clone(),
            workers,
            load,
            logging,
            explained: Mutex::default(),
            comparisons: Comparisons::default(),
            frames: Mutex::default(),
        })
    }

    /// Sends a request to a worker. `accept` reads its answer and leaves the numbers in the frame.
    pub(super) fn ask<T>(
        &self,
        job: &Job,
        process: ProcessChoice,
        limits: AnswerLimits,
        context: &RunContext<'_>,
        accept: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
    ) -> Result<T, FmiError> {
        let _held = self.workers.hold();
        let frames = || self.frames.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut requested, mut answer) = frames().pop().unwrap_or_default();
        requested.set_head(job).map_err(unsaid)?;
        let reuse = self.fmu.reuse();
        let whom = match process {
            _ if reuse == Reuse::NewProcess => Some(RequestedProcess::FreshOnce),
            ProcessChoice::Fresh => Some(RequestedProcess::Fresh),
            ProcessChoice::LongestIdle => Some(RequestedProcess::LongestIdle),
            ProcessChoice::ComparedFirst | ProcessChoice::Compared
                if self.comparisons.is_due(reuse, process) =>
            {
                None
            }
            _ => Some(RequestedProcess::Any),
        };
        requested.needs_new_instance =
            reuse != Reuse::Reset || (process == ProcessChoice::Any && !self.comparisons.has_passed(reuse));
        let question = Question { requested: &requested, context, limits, is_repetition: false };
        let accepted = match whom {
            Some(whom) => self.call(&question, &mut answer, accept, whom, None),
            None => self.ask_compared(job, &question, &mut answer, accept),
        };
        frames().push((requested, answer));
        accepted
    }

    /// Repeats a failed request with the log of the model switched on if the model did not report the reason
    /// of the failure. Returns the failure with the logged messages, or `None` if the model had reported a
    /// reason or still does not.
    fn explain(
        &self,
        reported: &ReportedError,
        job: &Job,
        limits: AnswerLimits,
        context: &RunContext<'_>,
        failure_of: impl FnOnce(Result<Frame, FmiError>) -> Option<ReportedError>,
    ) -> Option<ReportedError> {
        if reported.status.is_none() || !reported.log.is_empty() || self.fmu.options().logging.requested {
            return None;
        }
        let (requested, mut answer) = (Frame::of(job).ok()?, Frame::default());
        let question = Question { requested: &requested, context, limits, is_repetition: false };
        let whom = RequestedProcess::FreshOnce;
        let called = self.workers.call(&self.logging, &question, &mut answer, &mut |_| Ok(()), whom, None);
        failure_of(called.map(|_| answer)).filter(|reported| !reported.log.is_empty())
    }

    fn call<T>(
        &self,
        question: &Question<'_>,
        answer: &mut Frame,
        accept: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
        whom: RequestedProcess,
        repeat: Option<&mut Repeat<'_>>,
    ) -> Result<T, FmiError> {
        let called = self.workers.call(&self.load, question, answer, accept, whom, repeat);
        let (accepted, quirks) = called.map_err(|error| with_hint(&self.fmu, error))?;
        self.fmu.add_quirks(quirks);
        Ok(accepted)
    }

    /// Sends a request to a worker. If a used process answers, repeats the very first question and compares
    /// the answer with the answer of a fresh process. If they differ, switches to the next way of resetting
    /// the model and answers from a fresh process.
    fn ask_compared<T>(
        &self,
        job: &Job,
        question: &Question<'_>,
        answer: &mut Frame,
        accept: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
    ) -> Result<T, FmiError> {
        let reuse = self.fmu.reuse();
        let first = || self.comparisons.first.lock().unwrap_or_else(PoisonError::into_inner);
        let n_changes = self.workers.n_changes();
        let Ok(shape) = job.without_values() else {
            return self.call(question, answer, accept, RequestedProcess::Any, None);
        };
        let mut first_question =
            first().clone().filter(|first| first.n_changes == n_changes && first.shape == shape);
        if let Some(first_question) = &mut first_question {
            first_question.requested.needs_new_instance = question.requested.needs_new_instance;
        }
        let is_first = first_question
            .as_ref()
            .is_some_and(|first_question| first_question.requested == *question.requested);
        let mut repeat = first_question.as_ref().filter(|_| !is_first).map(|first_question| Repeat {
            question: first_question.during(question),
            answer: Frame::default(),
            outcome: None,
        });
        let reported = self.call(question, answer, accept, RequestedProcess::Any, repeat.as_mut());
        let Some(current_bits) = bits_of(&reported, answer, question) else { return reported };
        let again = match repeat {
            Some(Repeat { question, answer, outcome }) => {
                outcome.and_then(|outcome| bits_of(&outcome, &answer, &question))
            }
            None => Some(current_bits.clone()),
        };
        let first_question = match first_question {
            Some(first_question) => first_question,
            None => {
                let (requested, limits) = (question.requested.clone(), question.limits);
                let mut new = FirstQuestion { requested, limits, shape, n_changes, bits: Vec::new() };
                let is_fresh = !answer.is_of_used_process;
                let bits = if is_fresh { Some(current_bits) } else { self.bits_in_fresh(&new, question) };
                let Some(bits) = bits else { return reported };
                new.bits = bits;
                first().insert(new).clone()
            }
        };
        if !answer.is_of_used_process {
            return reported;
        }
        let Some(again) = again else {
            // An answer that could not be compared does not count.
            return match question.context.is_over() {
                true => Err(FmiError::Cancelled),
                false => self.call(question, answer, accept, RequestedProcess::Fresh, None),
            };
        };
        if again == first_question.bits {
            self.comparisons.note_passed(reuse);
            return reported;
        }
        match self.bits_in_fresh(&first_question, question) {
            Some(fresh) if fresh != first_question.bits => {
                if !self.comparisons.is_random.swap(true, Ordering::Relaxed) {
                    log::warn!("{}: {NOT_REPRODUCED}", self.fmu.description().model_name);
                }
            }
            // This also applies if the question was cancelled before the model could be found to be random.
            _ => self.give_up(reuse),
        }
        self.call(question, answer, accept, RequestedProcess::Fresh, None)
    }

    /// Returns the bits of a fresh process's answer to the first question, during another question.
    fn bits_in_fresh(&self, first: &FirstQuestion, during: &Question<'_>) -> Option<Vec<u64>> {
        let (question, mut answer) = (first.during(during), Frame::default());
        let reported = self.call(&question, &mut answer, &mut |_| Ok(()), RequestedProcess::FreshOnce, None);
        bits_of(&reported, &answer, &question)
    }

    /// Switches to the next way of resetting the model, because answers of used processes differ from answers
    /// of fresh processes.
    fn give_up(&self, reuse: Reuse) {
        self.workers.forget(&self.load);
        self.fmu.give_up(reuse, self.comparisons.has_passed(reuse));
    }
}

impl Processes {
    /// Returns a recorded simulation. `n_columns` is the expected number of columns, if known.
    pub(super) fn trajectory(
        &self,
        job: &Job,
        limits: AnswerLimits,
        n_columns: Option<usize>,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, FmiError> {
        let mut accept = |answer: &mut Frame| {
            let trajectory = trajectory_of(answer)?;
            match n_columns.filter(|n| trajectory.columns.len() != *n) {
                Some(n) => Err(wrong(format!("{} columns instead of {n}", trajectory.columns.len()))),
                None => Ok(trajectory),
            }
        };
        // A user-defined function may change between calls, so its simulation is not repeated.
        let is_driven = matches!(job, Job::Simulate(options) if options.has_input_functions());
        let process = if is_driven { ProcessChoice::Any } else { ProcessChoice::Compared };
        self.ask(job, process, limits, context, &mut accept).map_err(|error| {
            let FmiError::ReportedError(reported) = error else { return error };
            let failure_of = |called| match called {
                Err(FmiError::ReportedError(reported)) => Some(*reported),
                _ => None,
            };
            let explained = self.explain(&reported, job, limits, context, failure_of);
            FmiError::ReportedError(explained.map_or(reported, Box::new))
        })
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        self.workers.forget(&self.load);
    }
}

/// Worker processes of a calibration.
#[derive(Debug)]
pub(crate) struct Remote {
    processes: Processes,
    /// Time limit of a single simulation.
    run_limit: Option<Duration>,
    /// Number of simulations per evaluation.
    n_experiments: u32,
}

impl Remote {
    /// Returns the processes for a problem, shared with `lender` if possible. The error is the reason why the
    /// model runs in this process. It is `None` if the user requested it.
    pub(crate) fn of(fmu: &Fmu, problem: &Problem, lender: Option<&Self>) -> Result<Self, Option<String>> {
        let settings = &problem.settings;
        if settings.isolation == Isolation::None || fmu.is_absent() {
            return Err(None);
        }
        let limits = settings.worker_limits();
        // The worker must not start further processes, so the model runs in the worker itself.
        let model = ModelFile::of(fmu).map_err(|error| Some(error.to_string()))?;
        let settings = SimulationSettings { isolation: Isolation::None, sandbox: false, ..settings.clone() };
        let n_experiments = problem.experiments.len().try_into().unwrap_or(u32::MAX);
        let problem = Problem { model, settings, ..problem.clone() };
        let run_limit = problem.settings.run.timeout;
        let load = Job::Load(Box::new(Loaded { problem, options: fmu.options().clone() }));
        let lender = lender.map(|lender| &lender.processes.load);
        let processes = Processes::new(fmu, limits, load, lender).map_err(|error| match error {
            FmiError::NoWorker { reason } | FmiError::NoSandbox { reason } => Some(reason),
            error => Some(error.to_string()),
        })?;
        Ok(Self { processes, run_limit, n_experiments })
    }

    /// True if a comparison has shown that the model can be reset between two simulations.
    pub(crate) fn is_reset_tested(&self) -> bool {
        let reuse = self.processes.fmu.reuse();
        reuse != Reuse::NewProcess && self.processes.comparisons.has_passed(reuse)
    }

    /// True if answers of fresh processes differ from each other.
    pub(crate) fn is_random(&self) -> bool {
        self.processes.comparisons.is_random.load(Ordering::Relaxed)
    }

    /// Evaluates the best point of a search again and compares the answers. Uses a fresh process and at most
    /// `most_used` processes of the search. If the answers differ, switches to the next way of resetting the
    /// model. Returns the statistics of these simulations.
    pub(crate) fn compare_best(
        &self,
        best: &BestPoint,
        loss: RobustLoss,
        most_used: usize,
        context: &RunContext<'_>,
    ) -> Stats {
        let stats = Mutex::new(Stats::default());
        let evaluate = |process: ProcessChoice, context: &RunContext<'_>| {
            let (mut values, mut taken) = (vec![0.0; best.n_values], Stats::default());
            let (evaluation, rule) = (Evaluation::whole(process), CostRule::whole(loss, context));
            let cost = self.evaluate(&best.x, evaluation, rule, (&mut values, best.n_residuals), &mut taken);
            *stats.lock().unwrap_or_else(PoisonError::into_inner) += taken;
            let bits = values.iter().map(|value| value.to_bits()).collect::<Vec<u64>>();
            match cost {
                Ok(cost) => Some((cost.to_bits(), bits)),
                Err(CostFailure::Failed { kind: FailureKind::TimedOut, .. }) => None,
                Err(CostFailure::Failed { .. }) => Some((f64::INFINITY.to_bits(), Vec::new())),
                Err(_) => None,
            }
        };
        let reuse = self.processes.fmu.reuse();
        let n = self.processes.workers.n_idle(&self.processes.load).min(most_used);
        let used = map(n, n, context, &|_, context| evaluate(ProcessChoice::LongestIdle, context));
        if let Some(fresh) = evaluate(ProcessChoice::Fresh, context) {
            let has_cost = best.cost.is_none_or(|cost| cost.to_bits() == fresh.0);
            let has_residuals = best.residuals.as_ref().is_none_or(|residuals| {
                residuals.iter().map(|r| r.to_bits()).eq(fresh.1.iter().copied().take(best.n_residuals))
            });
            if !has_cost || !has_residuals || used.into_iter().flatten().flatten().any(|used| used != fresh) {
                match evaluate(ProcessChoice::Fresh, context) {
                    Some(again) if again != fresh => {
                        self.processes.comparisons.is_random.store(true, Ordering::Relaxed);
                    }
                    // This also applies if the search was cancelled before the model could be identified as random.
                    _ => {
                        self.processes.comparisons.note_passed(reuse);
                        self.processes.give_up(reuse);
                    }
                }
            }
        }
        stats.into_inner().unwrap_or_else(PoisonError::into_inner)
    }

    /// Fixes the working folder and the environment variables of all processes until the guard is dropped.
    pub(crate) fn hold(&self) -> Held {
        self.processes.workers.hold()
    }

    /// Starts a process that a fit will need in addition to the searching process, or at its end.
    pub(crate) fn prepare_second(&self) {
        self.processes.workers.prepare_second(&self.processes.load);
    }

    fn limits(&self, runs: u32, size: FrameSize) -> AnswerLimits {
        AnswerLimits { run: self.run_limit, runs, size }
    }

    /// Returns the cost at a point. Writes its residuals, whose number is given, and its criteria to `out`;
    /// see [`LoadedProblem::evaluate`](crate::cost::loaded_problem::LoadedProblem::evaluate).
    pub(crate) fn evaluate(
        &self,
        x: &[f64],
        evaluation: Evaluation,
        rule: CostRule<'_>,
        (out, n_residuals): (&mut [f64], usize),
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        let CostRule { loss, cutoff, context } = rule;
        let Evaluation { accuracy, process, recording } = evaluation;
        let job = Job::Evaluate { x: x.to_vec(), loss, cutoff, accuracy, recording };
        let n = out.len();
        let mut accept = |answer: &mut Frame| {
            let Evaluated { cost, stats } = evaluated(answer, n_residuals, n, cutoff)?;
            if cost.is_ok() {
                out.copy_from_slice(&answer.numbers);
            }
            Ok((cost, stats))
        };
        // A simulation that a cutoff has ended may be repeated without the cutoff.
        let n_runs = recording.map_or(self.n_experiments, |_| 1);
        let runs = if cutoff.is_finite() { n_runs.saturating_mul(2) } else { n_runs };
        let limits = self.limits(runs, FrameSize::of_numbers(n as u64));
        let mut evaluated = self.processes.ask(&job, process, limits, &context, &mut accept);
        if process != ProcessChoice::Fresh
            && matches!(&evaluated, Ok((Err(reported), _)) if reported.is_of_process())
        {
            // A used process may have lost resources that it needs.
            let again = self.processes.ask(&job, ProcessChoice::Fresh, limits, &context, &mut accept);
            if let Ok((Ok(cost), stats)) = again {
                evaluated = Ok((Ok(cost), stats));
            }
        }
        let (cost, taken) = evaluated.map_err(CostFailure::of_worker)?;
        *stats += taken;
        cost.map_err(|failure| self.explained(failure, &job, process, limits, &context).into())
    }

    /// Returns a failure with the reason of the model. In a search, the reasons must not depend on the order
    /// of the evaluations. The message of the model is therefore only logged, once for each reason.
    fn explained(
        &self,
        failure: ReportedCostFailure,
        job: &Job,
        process: ProcessChoice,
        limits: AnswerLimits,
        context: &RunContext<'_>,
    ) -> ReportedCostFailure {
        let ReportedCostFailure::Failed { reason, source: Some(reported), .. } = &failure else {
            return failure;
        };
        let is_alone = process == ProcessChoice::Compared;
        if !is_alone {
            let mut explained = self.processes.explained.lock().unwrap_or_else(PoisonError::into_inner);
            if explained.contains_key(reason) {
                return failure;
            }
            explained.insert(reason.clone(), None);
        }
        let mut explained = None;
        let failure_of = |called: Result<Frame, FmiError>| {
            let answer: Evaluated = called.ok()?.head().ok()?;
            explained = answer.cost.err();
            match &explained {
                Some(ReportedCostFailure::Failed { source, .. }) => source.clone(),
                _ => None,
            }
        };
        let reported = self.processes.explain(reported, job, limits, context, failure_of);
        match (reported, explained) {
            (Some(_), Some(explained)) if is_alone => explained,
            (Some(reported), _) => {
                let model = &self.processes.fmu.description().model_name;
                log::warn!("{model}: {reason} without a message; {LOG_ON}: {}", reported.message);
                let mut explained = self.processes.explained.lock().unwrap_or_else(PoisonError::into_inner);
                explained.insert(reason.clone(), Some(reported.message));
                failure
            }
            _ => failure,
        }
    }

    /// Adds the message that the model logged about one of the failures to their reason.
    pub(crate) fn explain_reason(&self, reason: &mut String) {
        let explained = self.processes.explained.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(Some(message)) = explained.get(reason) {
            *reason = format!("{reason} ({LOG_ON}: {message})");
        }
    }

    /// Returns a recorded simulation. `n_columns` is the expected number of columns, if known.
    pub(crate) fn trajectory(
        &self,
        job: &Job,
        n_columns: Option<usize>,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, CalibrationError> {
        let limits = self.limits(1, self.processes.workers.limits().answer_size());
        let trajectory = self.processes.trajectory(job, limits, n_columns, context);
        trajectory.map_err(|error| match error {
            FmiError::Cancelled => CalibrationError::Cancelled,
            error => error.into(),
        })
    }
}

/// Adds a possible cause to the error if a process of this model has ended.
pub(crate) fn with_hint(fmu: &Fmu, error: FmiError) -> FmiError {
    match error {
        FmiError::WorkerEnded(mut end) => {
            end.hint = end.hint.or_else(|| fmu.hint());
            FmiError::WorkerEnded(end)
        }
        error => error,
    }
}

/// Returns the worker processes of a model.
pub(crate) fn workers_of(fmu: &Fmu, limits: WorkerLimits) -> Result<Arc<Workers>, FmiError> {
    if limits.sandbox {
        check_sandbox()?;
    }
    fmu.workers(limits)?.ok_or_else(|| match limits.sandbox {
        true => FmiError::NoSandbox { reason: NO_LAUNCHER.to_owned() },
        false => FmiError::NoWorker { reason: NO_LAUNCHER.to_owned() },
    })
}

const NO_LAUNCHER: &str =
    "this program cannot start worker processes (worker::serve_if_worker is not called)";
