//! The main loop of a run: ask, evaluate, tell, observe, check for the end. It processes answers as they come
//! and continues when all answers that the path needs are available.

use crate::error::Error;
use crate::evaluation::counted_batch::{CountedBatch, reset};
use crate::evaluation::ledger::Ledger;
use crate::evaluation::store::{EarlyOutcome, FIRST_ID};
use crate::evaluation::{
    ContextPoller, CutoffUse, Evaluator, PollResult, Reached, SpeculativeEvaluations, StopCause,
};
use crate::method_interface::interface::{Batch, Method, MethodDetails, Status};
use crate::method_interface::tolerances::{Limits, ToleranceTests};
use crate::methods::BoxedMethod;
use crate::outcome::answer::{Answer, EvaluationKind, Failure, Outcome};
use crate::outcome::pareto_front::ParetoFront;
use crate::outcome::termination::{Termination, UNBOUNDED};
use crate::run::checkpoint::Writer;
use crate::run::progress::Progress;
use crate::run::report::{self, Report, Resumed};
use crate::run::start::StartedRun;
use base::RunContext;
use std::cell::Cell;
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::time::Instant;

/// Number of losses of one point that ends the run. Before that, a lost point is evaluated again. Dask
/// abandons a task after the same number of worker deaths (`distributed.scheduler.allowed-failures`).
const MOST_LOSSES: u32 = 3;

pub(crate) type Observer<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// Participants of a run other than its method.
pub(crate) struct Around<'a, 'b, 'c> {
    pub(crate) evaluator: &'a mut dyn Evaluator,
    pub(crate) control: &'a ContextPoller<'b>,
    pub(crate) observer: Option<&'a mut Observer<'c>>,
}

/// Stage of a run.
#[derive(Debug, Clone, PartialEq)]
enum Stage {
    /// The next step is to ask the method.
    Ask,
    /// Requested points are being evaluated.
    Evaluate,
    /// The run has ended. `None`: all starting points of the method failed.
    Over(Option<Termination>),
}

/// A run.
#[derive(Debug)]
pub(crate) struct Drive {
    pub(crate) method: BoxedMethod,
    pub(crate) round: CountedBatch,
    pub(crate) limits: Limits,
    pub(crate) workers: usize,
    writer: Option<Writer>,
    /// Last iteration that the observer saw. The next field is the length of the trace at that time.
    observed: Option<usize>,
    first_recent: usize,
    start: Instant,
    /// Seconds of the run before it was resumed.
    before: f64,
    by_hand: bool,
    method_reason: Option<String>,
    options: Vec<(String, String)>,
    resumed: Option<Resumed>,
    /// Error of the last attempt to write the checkpoint.
    pub(crate) unsaved: Option<Error>,
    stage: Stage,
    /// Requested points, the answers to the points that are evaluated, and the number of missing answers.
    batch: Batch,
    answers: Vec<Answer>,
    n_missing: usize,
    /// Index of the first point that is known to end the run. The run does not wait for later points.
    end: usize,
    /// Number of points of the path still being evaluated elsewhere when the run had to end.
    n_left: usize,
    /// Number of losses of each point of this batch that the engine lost, by id.
    losses: HashMap<u64, u32>,
    /// Number of answers since the checkpoint was written.
    n_unsaved: usize,
    guesses: SpeculativeEvaluations,
    answer: Answer,
    cause: Option<StopCause>,
}

impl Drive {
    /// Creates the driver of a started run. `by_hand` is true if the caller supplies the answers.
    pub(crate) fn new(started: StartedRun, by_hand: bool) -> Self {
        let StartedRun { method, round, limits, workers, writer, observed, first_recent, before, .. } =
            started;
        // A resumed run may already be over, for any reason.
        let over = started.resumed.as_ref().and_then(|_| end(&method, &round, &limits, None, false));
        Self {
            method,
            round,
            limits,
            workers,
            writer,
            observed,
            first_recent,
            start: Instant::now(),
            before,
            by_hand,
            method_reason: started.method_reason,
            options: started.options,
            resumed: started.resumed,
            unsaved: None,
            stage: over.map_or(Stage::Ask, Stage::Over),
            batch: Batch::new(),
            answers: Vec::new(),
            n_missing: 0,
            end: usize::MAX,
            n_left: 0,
            losses: HashMap::new(),
            n_unsaved: 0,
            guesses: SpeculativeEvaluations::default(),
            answer: Answer::default(),
            cause: None,
        }
    }

    /// Returns the duration of the run in seconds, including the time before it was resumed.
    pub(crate) fn elapsed(&self) -> f64 {
        self.before + self.start.elapsed().as_secs_f64()
    }

    /// Returns the reason why the run has ended; `None` while it is not. `Some(None)`: all starting points of
    /// the method failed.
    pub(crate) fn ended(&self) -> Option<Option<Termination>> {
        match &self.stage {
            Stage::Over(termination) => Some(termination.clone()),
            Stage::Ask | Stage::Evaluate => None,
        }
    }

    /// True if the next step is to ask the method, for example because the last `ask` was interrupted.
    pub(crate) fn is_put_off(&self) -> bool {
        self.stage == Stage::Ask
    }

    /// Drives the run to its end and returns the report.
    pub(crate) fn run(mut self, mut around: Around<'_, '_, '_>) -> Result<Report, Error> {
        while !self.advance(&mut around)? {}
        self.guesses.cancel(around.evaluator);
        let is_left = around.evaluator.leave();
        self.take_the_rest(&mut around, is_left);
        self.round.ledger.n_lost += around.evaluator.n_lost();
        let termination = self.ended().unwrap_or(Some(Termination::Interrupted));
        let control = around.control;
        let is_interrupted = || control.check() == Some(StopCause::Interrupted);
        self.report(termination, &RunContext::new().polling(&is_interrupted))
    }

    /// Records the answers to cancelled evaluations that still finish. Waits for these evaluations unless
    /// `is_left` is true.
    fn take_the_rest(&mut self, around: &mut Around<'_, '_, '_>, is_left: bool) {
        let mut answer = Answer::default();
        loop {
            let mut wait = around.control.wait(true);
            if is_left {
                wait.until = Instant::now();
            }
            match around.evaluator.poll(&wait, &mut answer) {
                PollResult::Answered(_) if answer.outcome.is_lost() => self.round.ledger.n_lost += 1,
                PollResult::Answered(id) => {
                    let answer = std::mem::take(&mut answer);
                    let cutoff_use = around.evaluator.cutoff_use();
                    if id >= FIRST_ID {
                        self.guesses.answered(id, answer, &mut self.round, cutoff_use);
                    } else if let Some(k) = self.round.work.place_of(id) {
                        self.round.keep_unneeded(k, &answer);
                    }
                }
                PollResult::Waiting if is_left => return,
                PollResult::Waiting => _ = around.control.check(),
                PollResult::Idle => return,
            }
        }
    }

    /// Builds the report and consumes the run.
    fn report(mut self, termination: Option<Termination>, context: &RunContext<'_>) -> Result<Report, Error> {
        let (seconds, n_left) = (self.elapsed(), self.n_left);
        self.round.finish();
        let Self { method, round, limits, workers, method_reason, options, resumed, .. } = self;
        let mut ledger = round.ledger;
        let mut report =
            report::conclude(&method, &mut ledger, &limits, workers, termination, seconds, context)?;
        if n_left > 0 {
            let left = format!("; {n_left} evaluations were still running elsewhere when the run ended");
            report.message.push_str(&left);
        }
        Ok(Report { method_reason, options, resumed, ..report })
    }

    /// Builds the report of the run so far, as if it was interrupted.
    pub(crate) fn report_so_far(&self) -> Result<Report, Error> {
        let termination = self.ended().unwrap_or(Some(Termination::Interrupted));
        let (seconds, mut round) = (self.elapsed(), self.round.clone());
        round.finish();
        let (method, ledger, limits) = (&self.method, &mut round.ledger, &self.limits);
        let report =
            report::conclude(method, ledger, limits, self.workers, termination, seconds, &RunContext::new())?;
        let (method_reason, options) = (self.method_reason.clone(), self.options.clone());
        Ok(Report { method_reason, options, resumed: self.resumed.clone(), ..report })
    }

    /// Advances the run as far as the available answers allow. Returns true if the run has ended. Otherwise,
    /// the run waits for answers that only the caller can supply.
    pub(crate) fn advance(&mut self, around: &mut Around<'_, '_, '_>) -> Result<bool, Error> {
        loop {
            match self.stage {
                Stage::Over(_) => return Ok(true),
                Stage::Ask => {
                    if self.ask(around)? {
                        return Ok(false);
                    }
                }
                Stage::Evaluate if self.n_missing == 0 && !around.evaluator.is_ready() => {
                    self.close(around)?
                }
                Stage::Evaluate => {
                    if self.take_answer(around) {
                        return Ok(false);
                    }
                }
            }
        }
    }

    /// Asks the method. Returns true if a run by hand must ask again later: the method has no points yet, and
    /// the caller does not wait longer.
    fn ask(&mut self, around: &mut Around<'_, '_, '_>) -> Result<bool, Error> {
        let cause = Cell::new(None);
        let is_over = || {
            cause.set(cause.get().or_else(|| around.control.check()));
            cause.get().is_some()
        };
        self.method.ask_unless(&RunContext::new().polling(&is_over), &mut self.batch);
        if !self.round.ledger.constraints.nonlinear.is_empty() {
            // The cost of an infeasible point says nothing about its rank.
            self.batch.remove_cutoffs();
        }
        let is_running = self.method.status() == Status::Running;
        let limit = match cause.get() {
            Some(StopCause::Interrupted) if self.batch.is_empty() && is_running => {
                if self.by_hand {
                    return Ok(true);
                }
                Some(Termination::Interrupted)
            }
            Some(StopCause::OutOfTime) if self.batch.is_empty() && is_running => {
                Some(limited(&self.method, &self.round, Termination::MaxTime))
            }
            // A batch without evaluations needs no budget.
            _ if self.batch.is_empty() => None,
            _ => self.exhausted(around.control).map(|limit| limited(&self.method, &self.round, limit)),
        };
        if let Some(limit) = limit {
            self.save(&[]);
            self.stage = Stage::Over(Some(self.unless_unsaved(limit)));
            return Ok(false);
        }
        self.cause = None;
        if self.batch.is_empty() {
            self.observe_and_end(None, around)?;
        } else {
            self.open(around);
        }
        Ok(false)
    }

    /// Returns the limit that forbids another evaluation, if any.
    fn exhausted(&self, control: &ContextPoller<'_>) -> Option<Termination> {
        if self.round.store.has_replays() {
            // Evaluations made before the run was resumed are already known.
            return None;
        }
        if self.limits.max_evaluations.is_some_and(|m| self.round.ledger.n_evaluations >= m) {
            return Some(Termination::MaxEvaluations);
        }
        control.signals().is_late().then_some(Termination::MaxTime)
    }

    /// Submits the points of the batch that are not already being evaluated, in request order. Then submits
    /// points that may be needed next.
    fn open(&mut self, around: &mut Around<'_, '_, '_>) {
        let Self { round, guesses, batch, answers, limits, .. } = self;
        round.cutoff_use = around.evaluator.cutoff_use();
        round.open(batch, limits);
        let n_work = round.work.len();
        reset(answers, n_work);
        (self.n_missing, self.n_unsaved, self.stage) = (n_work, 0, Stage::Evaluate);
        self.end = usize::MAX;
        self.losses.clear();
        // If the caller makes the evaluations, the run continues after an interrupt; only the caller stops
        // it.
        self.cause = around.control.check().filter(|cause| !self.by_hand || *cause != StopCause::Interrupted);
        if self.cause.is_some() {
            self.n_missing = 0;
            return;
        }
        for k in 0..n_work {
            if guesses.adopt(round.work.point(k), k) {
                round.begun(k);
            } else {
                around.evaluator.submit(round.work.point(k), round.work.query(k));
            }
        }
        self.look_ahead(around);
    }

    /// Submits speculative points to workers that the path does not use.
    fn look_ahead(&mut self, around: &mut Around<'_, '_, '_>) {
        if self.cause.is_none() && self.n_missing > 0 && self.end == usize::MAX {
            let left = self.round.left_after(&self.limits);
            self.guesses.renew(
                &mut self.method,
                &mut self.round,
                &self.answers,
                self.n_missing,
                left,
                around.evaluator,
            );
        }
    }

    /// Processes the next answer. Returns true if there is none and waiting will not produce one.
    fn take_answer(&mut self, around: &mut Around<'_, '_, '_>) -> bool {
        let Around { evaluator, control, .. } = around;
        let mut answer = std::mem::take(&mut self.answer);
        let mut wait = control.wait(self.cause.is_some());
        // A run that is out of time does not wait for external evaluations, which may never answer.
        let is_left = self.cause == Some(StopCause::OutOfTime) && evaluator.leave();
        if is_left {
            wait.until = Instant::now();
        }
        let polled = evaluator.poll(&wait, &mut answer);
        match polled {
            PollResult::Answered(id) => {
                if !self.is_evaluated_again(id, &mut answer, &mut **evaluator) {
                    self.answered(id, &mut answer, &mut **evaluator);
                    self.n_unsaved += 1;
                }
            }
            PollResult::Waiting if is_left => {
                self.n_left = self.n_missing;
                self.n_missing = 0;
            }
            PollResult::Waiting => {}
            // Submitted points without an answer were not evaluated.
            PollResult::Idle => self.n_missing = 0,
        }
        self.answer = answer;
        if polled == PollResult::Waiting && self.by_hand {
            return true;
        }
        if self.cause.is_none() && !self.by_hand {
            self.cause = control.check();
            if self.cause.is_some() {
                self.cancel(&mut **evaluator);
            }
        }
        if matches!(polled, PollResult::Answered(_)) && !around.evaluator.is_ready() {
            self.look_ahead(around);
        }
        if self.n_unsaved > 0 && self.n_missing > 0 && self.writer.as_ref().is_some_and(Writer::is_due) {
            self.save_now();
            self.n_unsaved = 0;
        }
        false
    }

    /// Submits a lost point again. Returns true if this answer is a loss and the path waits for the point.
    /// Otherwise, a loss becomes [`Outcome::Skipped`]. After [`MOST_LOSSES`] losses of one point, the run
    /// ends. A loss does not affect any decision.
    fn is_evaluated_again(&mut self, id: u64, answer: &mut Answer, evaluator: &mut dyn Evaluator) -> bool {
        if !answer.outcome.is_lost() {
            return false;
        }
        self.round.ledger.n_lost += 1;
        let why = std::mem::replace(&mut answer.outcome, Outcome::Skipped);
        let place = self.round.work.place_of(id).filter(|&k| id < FIRST_ID && k <= self.end);
        let (Some(k), None) = (place, self.cause) else { return false };
        let n = self.losses.entry(id).or_default();
        *n += 1;
        if *n < MOST_LOSSES {
            evaluator.submit(self.round.work.point(k), self.round.work.query(k));
            return true;
        }
        if let Outcome::Failed(Failure { message, .. }) = why {
            let message =
                format!("the engine lost the same point {n} times ({message}), so the point has no cost");
            answer.outcome = Outcome::Abort(message);
        }
        false
    }

    /// Cancels all evaluations in progress.
    fn cancel(&mut self, evaluator: &mut dyn Evaluator) {
        let missing = |k: &usize| self.answers[*k].outcome == Outcome::Skipped;
        (0..self.answers.len()).filter(missing).for_each(|k| evaluator.cancel(self.round.work.id(k)));
        self.guesses.cancel(evaluator);
    }

    /// Processes one answer to a point of the path or to a speculative point.
    fn answered(&mut self, id: u64, answer: &mut Answer, evaluator: &mut dyn Evaluator) {
        if id >= FIRST_ID {
            let cutoff_use = evaluator.cutoff_use();
            let reached = self.guesses.answered(id, std::mem::take(answer), &mut self.round, cutoff_use);
            match reached {
                Some(Reached::Answer(k, answer)) => self.fill(k, answer, evaluator),
                // No evaluation is restarted while the run is ending.
                Some(Reached::Again(k)) if self.cause.is_some() => self.fill(k, Answer::default(), evaluator),
                Some(Reached::Again(k)) => {
                    evaluator.submit(self.round.work.point(k), self.round.work.query(k))
                }
                Some(Reached::Kept) | None => {}
            }
        } else if let Some(k) = self.round.work.place_of(id).filter(|&k| k < self.answers.len()) {
            if answer.outcome != Outcome::Skipped {
                let cutoff = self.round.work.query(k).cutoff;
                answer.outcome = match std::mem::replace(&mut answer.outcome, Outcome::Skipped) {
                    // An evaluation above its cutoff counts as abandoned, because another worker might have
                    // abandoned it.
                    Outcome::Value(v)
                        if v > cutoff && v.is_finite() && self.round.cutoff_use == CutoffUse::Yes =>
                    {
                        Outcome::Above(cutoff)
                    }
                    outcome => outcome.checked(cutoff),
                };
            }
            let filled = std::mem::take(answer);
            self.fill(k, filled, evaluator);
        }
    }

    /// Stores an answer. If it ends the run, later points are cancelled, and the run waits only for earlier
    /// points.
    fn fill(&mut self, k: usize, answer: Answer, evaluator: &mut dyn Evaluator) {
        self.answers[k] = answer;
        if k > self.end {
            return;
        }
        self.n_missing = self.n_missing.saturating_sub(1);
        if self.round.is_last(k, &self.answers[k]) {
            let is_missing = |j: &usize| self.answers[*j].outcome == Outcome::Skipped;
            let after = (k + 1..self.answers.len()).filter(is_missing);
            after.for_each(|j| evaluator.cancel(self.round.work.id(j)));
            self.guesses.cancel_after(k, evaluator);
            self.end = k;
            self.n_missing = (0..k).filter(is_missing).count();
        }
    }

    /// Closes the batch with the answers so far.
    fn close(&mut self, around: &mut Around<'_, '_, '_>) -> Result<(), Error> {
        let stopped = self.verdict(around.control);
        if stopped.is_some() && self.writer.is_some() {
            // Saves the state before this batch, and the known outcomes of the batch.
            let finished = self.round.finished_evaluations(&self.batch, &self.answers);
            self.save(&finished);
        }
        if let Err(error) = self.round.close(&self.batch, &mut self.answers) {
            self.stage = Stage::Over(Some(Termination::Aborted(error.to_string())));
            return Err(error);
        }
        // After an interrupt, residuals are no longer used, and processing many of them is slow. Criteria are few,
        // and the front contains their points.
        let is_left = stopped == Some(Termination::Interrupted)
            && self.batch.kind() == EvaluationKind::Residuals
            && self.method.front().is_none();
        if !is_left {
            self.method.tell_last(self.round.reported(&self.batch))?;
        }
        self.observe_and_end(stopped, around)
    }

    /// Returns the reason why the run must end after the points that the path needs were evaluated.
    fn verdict(&self, control: &ContextPoller<'_>) -> Option<Termination> {
        let last = self.round.last(&self.answers);
        let stopped = self.round.stopped(last);
        if matches!(stopped, Some(Termination::Aborted(_))) {
            return stopped;
        }
        match self.cause {
            Some(StopCause::Interrupted) => return Some(Termination::Interrupted),
            Some(StopCause::OutOfTime) => return Some(Termination::MaxTime),
            None => {}
        }
        let n_needed = last.map_or(self.answers.len(), |(place, _)| self.round.n_before(place));
        if self.answers[..n_needed].iter().any(|answer| !answer.outcome.is_conclusive()) {
            // An evaluation stopped early for a reason unknown to the run: the deadline passed during the
            // evaluation, or the objective was cancelled elsewhere.
            let is_late = control.signals().is_late();
            return Some(if is_late { Termination::MaxTime } else { Termination::Interrupted });
        }
        stopped
    }

    /// Informs the observer, saves the state if a write is due, and ends or continues the run.
    fn observe_and_end(
        &mut self,
        stopped: Option<Termination>,
        around: &mut Around<'_, '_, '_>,
    ) -> Result<(), Error> {
        let broken = self.observe(around.observer.as_deref_mut());
        self.round.ledger.trim(false);
        let end = end(&self.method, &self.round, &self.limits, stopped.as_ref(), broken);
        if stopped.is_none() && (end.is_some() || self.writer.as_ref().is_some_and(Writer::is_due)) {
            self.save(&[]);
        }
        self.stage = match end {
            Some(end) => Stage::Over(end.map(|termination| self.unless_unsaved(termination))),
            None => Stage::Ask,
        };
        Ok(())
    }

    /// Ends the run as if it was interrupted. Known outcomes of the current batch are recorded.
    pub(crate) fn interrupt(&mut self, around: &mut Around<'_, '_, '_>) -> Result<(), Error> {
        match self.stage {
            Stage::Over(_) => return Ok(()),
            Stage::Evaluate if self.n_missing < self.answers.len() => {
                self.cause = Some(StopCause::Interrupted);
                self.cancel(around.evaluator);
                self.close(around)?;
            }
            Stage::Ask | Stage::Evaluate => self.save_now(),
        }
        self.stage = Stage::Over(Some(Termination::Interrupted));
        Ok(())
    }

    /// Closes the batch with the available answers.
    pub(crate) fn abandon(&mut self, around: &mut Around<'_, '_, '_>) -> Result<(), Error> {
        self.cancel(around.evaluator);
        self.close(around)
    }

    /// Informs the observer of a new iteration. Returns true if the observer requests a stop.
    fn observe(&mut self, observer: Option<&mut Observer<'_>>) -> bool {
        let seconds = self.elapsed();
        let (ledger, details) = (&self.round.ledger, self.method.details());
        let n_iterations = details.n_iterations;
        let (Some(operation), Some((x, fun))) = (details.operation, ledger.best.get()) else { return false };
        if self.observed.is_some_and(|n| n >= n_iterations) {
            return false;
        }
        self.observed = Some(n_iterations);
        let first_recent = std::mem::replace(&mut self.first_recent, ledger.trace.end());
        let Some(observer) = observer else { return false };
        let front = self.method.front();
        let compromise = front.as_ref().and_then(ParetoFront::compromise);
        let (x, fun) = compromise.map_or((x, fun), |(point, distance)| (&point.x[..], distance));
        let progress = Progress {
            n_iterations,
            n_evaluations: ledger.n_evaluations,
            n_speculative: ledger.n_speculative(),
            n_failed: ledger.n_failed,
            x,
            fun,
            operation,
            simplex: details.simplex,
            population: details.population,
            front: front.as_ref(),
            tests: details.tests,
            seconds,
            trace: &ledger.trace,
            first_recent,
        };
        observer(&progress).is_break()
    }

    /// Writes the state, including the known outcomes of the current batch.
    pub(crate) fn save_now(&mut self) {
        let finished = match self.stage {
            Stage::Evaluate => self.round.finished_evaluations(&self.batch, &self.answers),
            Stage::Ask | Stage::Over(_) => Vec::new(),
        };
        self.save(&finished);
    }

    /// Writes the state. A failure, for example on a full disk, is logged once, and the write is tried again
    /// later. If the last write fails, the result reports the failure.
    fn save(&mut self, finished: &[EarlyOutcome]) {
        let seconds = self.elapsed();
        let Some(writer) = &mut self.writer else { return };
        let written =
            writer.write(&self.method, &self.round, finished, self.observed, self.first_recent, seconds);
        if let (Err(error), None) = (&written, &self.unsaved) {
            log::warn!("the checkpoint was not written; the run continues and will try again: {error}");
        }
        self.unsaved = written.err();
    }

    /// Returns the termination of the run. Interrupts and aborts take precedence, then a checkpoint that
    /// could not be written, then `termination`.
    fn unless_unsaved(&self, termination: Termination) -> Termination {
        match (termination, &self.unsaved) {
            (hard @ (Termination::Aborted(_) | Termination::Interrupted), _) => hard,
            (termination, Some(error)) if !self.by_hand => {
                Termination::NotSaved { reason: error.to_string(), ended: Box::new(termination) }
            }
            (termination, _) => termination,
        }
    }
}

/// Minimum number of evaluations before the fraction of failures is checked.
const FEWEST_EVALUATIONS: usize = 20;

/// True if the fraction of failed evaluations exceeds its limit.
fn too_many_failed(round: &CountedBatch, limits: &Limits) -> bool {
    let (n, failed) = (round.ledger.n_evaluations, round.ledger.n_failed);
    n >= FEWEST_EVALUATIONS && limits.max_failed.is_some_and(|share| failed as f64 > share * n as f64)
}

/// Checks the limits between two batches, in addition to the limits within a batch.
fn reached(method: &dyn Method, round: &CountedBatch, limits: &Limits) -> Option<Termination> {
    if round.target_reached(limits) {
        return Some(Termination::Target);
    }
    if too_many_failed(round, limits) {
        return Some(Termination::TooManyFailed);
    }
    let most = limits.max_iterations?;
    let details = method.details();
    let over =
        details.n_iterations >= most && details.operation.is_some() && method.status() == Status::Running;
    over.then(|| limited(method, round, Termination::MaxIterations))
}

/// Returns the termination of a run at a limit. It is the limit, unless the tests have already passed for the
/// best point.
pub(crate) fn limited(method: &dyn Method, round: &CountedBatch, limit: Termination) -> Termination {
    let MethodDetails { settled, tests, .. } = method.details();
    let best = round.ledger.best.cost();
    let is_tested = |tests: ToleranceTests, best: f64| !tests.is_of_squares && best >= tests.f_best;
    let tested = tests.zip(best).is_some_and(|(tests, best)| is_tested(tests, best));
    if settled && tested { meaning(Termination::Converged, round) } else { limit }
}

/// Refines the termination of a method that ended by itself: `Unbounded` or `ConstantCost` if the costs
/// indicate it.
fn meaning(termination: Termination, round: &CountedBatch) -> Termination {
    let Ledger { trace, best, .. } = &round.ledger;
    let first = trace.iter().find_map(|entry| entry.outcome.value());
    match (best.cost(), first) {
        (Some(best), Some(first)) if best < UNBOUNDED && best < -2.0 * first.abs() => Termination::Unbounded,
        // A search for a feasible point may have a constant cost.
        _ if termination == Termination::Converged
            && round.ledger.constraints.nonlinear.is_empty()
            && trace.constant().is_some() =>
        {
            Termination::ConstantCost
        }
        _ => termination,
    }
}

/// Returns the termination of a run that ends after a batch; `None` if the run continues. `Some(None)`: all
/// starting points of the method failed.
pub(crate) fn end(
    method: &dyn Method,
    round: &CountedBatch,
    limits: &Limits,
    stopped: Option<&Termination>,
    broken: bool,
) -> Option<Option<Termination>> {
    // An interrupt takes precedence over a simultaneous result. A result takes precedence over a limit.
    if let Some(hard @ (Termination::Aborted(_) | Termination::Interrupted)) = stopped {
        return Some(Some(hard.clone()));
    }
    if round.target_reached(limits) {
        return Some(Some(Termination::Target));
    }
    match method.status() {
        Status::Ended(termination) => return Some(Some(meaning(termination, round))),
        Status::NoStart => return Some(None),
        Status::Running if broken => return Some(Some(Termination::StoppedByObserver)),
        Status::Running => {}
    }
    if let Some(stopped) = stopped {
        return Some(Some(limited(method, round, stopped.clone())));
    }
    if round.is_stale() {
        // With integers, no untested points may be left. The tests then measure the remaining points.
        let passed = method.details().tests.is_some_and(|tests| tests.passed);
        return Some(Some(if passed { Termination::Converged } else { Termination::Stalled }));
    }
    reached(method, round, limits).map(Some)
}
