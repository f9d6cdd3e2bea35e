//! The only loop: ask -> evaluate -> tell -> observe -> stop?

use crate::checkpoint::Writer;
use crate::error::Error;
use crate::gateway::batch_ledger::{BatchLedger, Replay};
use crate::gateway::ledger::Ledger;
use crate::gateway::{Gateway, StopCause};
use crate::method::{Batch, Details, Method, Status};
use crate::observe::Progress;
use crate::report::{self, Report};
use crate::termination::{Termination, UNBOUNDED};
use crate::tolerances::Limits;
use std::ops::ControlFlow;

pub(crate) type Observer<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// A run between two batches.
pub(crate) struct Drive<'a, M> {
    pub(crate) method: M,
    pub(crate) gateway: Gateway<'a>,
    pub(crate) limits: Limits,
    pub(crate) workers: usize,
    pub(crate) writer: Option<Writer>,
    /// The iteration that the observer saw last, and where the trace stood then.
    pub(crate) observed: Option<usize>,
    pub(crate) first_recent: usize,
    /// Why the checkpoint could not be written.
    pub(crate) unsaved: Option<String>,
}

impl<M: Method> Drive<'_, M> {
    /// Runs the method to its end and reports.
    pub(crate) fn run(mut self, observer: Option<&mut Observer<'_>>) -> Result<Report, Error> {
        let termination = self.until_over(observer)?;
        let seconds = self.gateway.elapsed();
        let Self { method, gateway, limits, workers, .. } = &mut self;
        let Gateway { batch_ledger, control, .. } = gateway;
        let mut interrupted = || control.check() == Some(StopCause::Interrupted);
        let ledger = &mut batch_ledger.ledger;
        report::conclude(method, ledger, limits, *workers, termination, seconds, &mut interrupted)
    }

    /// `None`: the method had nothing to start from.
    fn until_over(&mut self, mut observer: Option<&mut Observer<'_>>) -> Result<Option<Termination>, Error> {
        let mut batch = Batch::new();
        // A run that was resumed may be over already.
        if self.observed.is_some()
            && let Some(termination) = reached(&self.method, &self.gateway.batch_ledger, &self.limits)
        {
            return Ok(Some(termination));
        }
        loop {
            let mut cause = None;
            let control = &mut self.gateway.control;
            let mut cancelled = || {
                cause = cause.or_else(|| control.check());
                cause.is_some()
            };
            self.method.ask_unless(&mut cancelled, &mut batch);
            if let Some(cause) = cause.filter(|_| batch.is_empty() && self.method.status() == Status::Running)
            {
                self.save(&[]);
                let termination = match cause {
                    StopCause::Interrupted => Termination::Interrupted,
                    StopCause::OutOfTime => {
                        limited(&self.method, &self.gateway.batch_ledger, Termination::MaxTime)
                    }
                };
                return Ok(Some(self.unless_unsaved(termination)));
            }
            // What needs no evaluation needs no budget.
            if let Some(termination) = self.gateway.exhausted().filter(|_| !batch.is_empty()) {
                self.save(&[]);
                let termination = limited(&self.method, &self.gateway.batch_ledger, termination);
                return Ok(Some(self.unless_unsaved(termination)));
            }
            let stopped =
                if batch.is_empty() { None } else { self.gateway.evaluate(&batch, &mut self.method) };
            if stopped.is_some() && self.writer.is_some() {
                // The state before this batch, and what is known of the batch.
                let known = self.gateway.known(&batch);
                self.save(&known);
            }
            if !batch.is_empty() {
                self.gateway.close(&batch);
                self.method.tell(self.gateway.batch_ledger.told())?;
            }
            let broken = self.observe(observer.as_deref_mut());
            self.gateway.batch_ledger.ledger.trim(false);
            let end = end(&self.method, &self.gateway.batch_ledger, &self.limits, stopped.as_ref(), broken);
            if stopped.is_none() && (end.is_some() || self.writer.as_ref().is_some_and(Writer::is_due)) {
                self.save(&[]);
            }
            if let Some(end) = end {
                return Ok(end.map(|termination| self.unless_unsaved(termination)));
            }
        }
    }

    /// Tells the observer of a new iteration; whether it said stop.
    fn observe(&mut self, observer: Option<&mut Observer<'_>>) -> bool {
        let Self { method, gateway, .. } = self;
        let (ledger, details) = (&gateway.batch_ledger.ledger, method.details());
        let n_iterations = details.n_iterations;
        let (Some(operation), Some((x, fun))) = (details.operation, ledger.best.get()) else { return false };
        if self.observed.is_some_and(|n| n >= n_iterations) {
            return false;
        }
        self.observed = Some(n_iterations);
        let first_recent = std::mem::replace(&mut self.first_recent, ledger.trace.end());
        let Some(observer) = observer else { return false };
        let progress = Progress {
            n_iterations,
            n_evaluations: ledger.n_evaluations,
            n_speculative: ledger.speculative.n_speculative(),
            n_failed: ledger.n_failed,
            x,
            fun,
            operation,
            simplex: details.simplex,
            population: details.population,
            tests: details.tests,
            seconds: gateway.elapsed(),
            trace: &ledger.trace,
            first_recent,
        };
        observer(&progress).is_break()
    }

    /// A file that cannot be written, on a full disk for example, is said once and tried again; where the last one fails, the run says so at
    /// its end.
    fn save(&mut self, replay: &[Replay]) {
        let seconds = self.gateway.elapsed();
        let Some(writer) = &mut self.writer else { return };
        let observed = (self.observed, self.first_recent);
        let written = writer.write(&self.method, &self.gateway.batch_ledger, replay, observed, seconds);
        if let (Err(error), None) = (&written, &self.unsaved) {
            log::warn!("the run goes on without a checkpoint, which is tried again: {error}");
        }
        self.unsaved = written.err().map(|error| error.to_string());
    }

    /// What ends the run: an interrupt or an abort, else a checkpoint that could not be written, else this.
    fn unless_unsaved(&mut self, termination: Termination) -> Termination {
        match (termination, self.unsaved.take()) {
            (hard @ (Termination::Aborted(_) | Termination::Interrupted), _) => hard,
            (_, Some(message)) => Termination::NotSaved(message),
            (termination, None) => termination,
        }
    }
}

/// Limits that hold between two batches, besides those of the gateway.
pub(crate) fn reached<M: Method + ?Sized>(
    method: &M,
    batch_ledger: &BatchLedger,
    limits: &Limits,
) -> Option<Termination> {
    if batch_ledger.target_reached(limits) {
        return Some(Termination::Target);
    }
    let most = limits.max_iterations?;
    let details = method.details();
    let over =
        details.n_iterations >= most && details.operation.is_some() && method.status() == Status::Running;
    over.then(|| limited(method, batch_ledger, Termination::MaxIterations))
}

/// What it means that a limit ends a run: nothing where the tests have passed for the best point already.
pub(crate) fn limited<M: Method + ?Sized>(
    method: &M,
    batch_ledger: &BatchLedger,
    limit: Termination,
) -> Termination {
    let Details { settled, tests, .. } = method.details();
    let best = batch_ledger.ledger.best.cost();
    let tested = matches!((tests, best), (Some(tests), Some(best)) if best >= tests.f_best);
    if settled && tested { meaning(Termination::Converged, batch_ledger) } else { limit }
}

/// What it means that a method came to its own end.
fn meaning(termination: Termination, batch_ledger: &BatchLedger) -> Termination {
    let Ledger { trace, best, .. } = &batch_ledger.ledger;
    let first = trace.iter().find_map(|entry| entry.outcome.value());
    match (best.cost(), first) {
        (Some(best), Some(first)) if best < UNBOUNDED && best < -2.0 * first.abs() => Termination::Unbounded,
        _ if termination == Termination::Converged && trace.constant().is_some() => Termination::ConstantCost,
        _ => termination,
    }
}

/// Whether a run is over after a batch, and why; `Some(None)`: the method had nothing to start from.
pub(crate) fn end<M: Method + ?Sized>(
    method: &M,
    batch_ledger: &BatchLedger,
    limits: &Limits,
    stopped: Option<&Termination>,
    broken: bool,
) -> Option<Option<Termination>> {
    // An interrupt outranks a result that came at the same moment; a result outranks a limit.
    if let Some(hard @ (Termination::Aborted(_) | Termination::Interrupted)) = stopped {
        return Some(Some(hard.clone()));
    }
    if batch_ledger.target_reached(limits) {
        return Some(Some(Termination::Target));
    }
    match method.status() {
        Status::Ended(termination) => return Some(Some(meaning(termination, batch_ledger))),
        Status::NoStart => return Some(None),
        Status::Running if broken => return Some(Some(Termination::StoppedByObserver)),
        Status::Running => {}
    }
    if let Some(stopped) = stopped {
        return Some(Some(limited(method, batch_ledger, stopped.clone())));
    }
    if batch_ledger.is_stale() {
        // Among whole numbers nothing is left to try then, and the tests measure what there is.
        let passed = method.details().tests.is_some_and(|tests| tests.passed);
        return Some(Some(if passed { Termination::Converged } else { Termination::Stalled }));
    }
    reached(method, batch_ledger, limits).map(Some)
}
