//! The only loop: ask -> evaluate -> tell -> observe -> stop?

use crate::error::Error;
use crate::evaluate::Gateway;
use crate::method::{Batch, Method, Status};
use crate::observe::Progress;
use crate::report::Report;
use crate::termination::{Limits, Termination};
use std::ops::ControlFlow;

pub(crate) type Observer<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// Runs a method to its end and reports.
pub(crate) fn drive<M: Method + ?Sized>(
    method: &mut M,
    mut gateway: Gateway<'_>,
    limits: &Limits,
    workers: usize,
    observer: Option<&mut Observer<'_>>,
) -> Result<Report, Error> {
    match run(method, &mut gateway, limits, observer)? {
        None => Err(Error::AllStartsFailed(gateway.nothing_found())),
        Some(termination) => report(method, gateway, limits, workers, termination),
    }
}

/// `None`: the method had nothing to start from.
fn run<M: Method + ?Sized>(
    method: &mut M,
    gateway: &mut Gateway<'_>,
    limits: &Limits,
    mut observer: Option<&mut Observer<'_>>,
) -> Result<Option<Termination>, Error> {
    let mut batch = Batch::new();
    let mut observed: Option<usize> = None;
    let mut first_recent = 0;
    loop {
        method.ask(&mut batch);
        // What needs no evaluation needs no budget.
        if let Some(termination) = gateway.exhausted().filter(|_| !batch.is_empty()) {
            return Ok(Some(termination));
        }
        let stopped = if batch.is_empty() { None } else { gateway.evaluate(&batch) };
        if !batch.is_empty() {
            method.tell(gateway.outcomes())?;
            gateway.settle(method.used());
        } else if method.status() == Status::Running {
            // What comes next was seen ahead; points of the last batch turn out to be used.
            method.tell(&[])?;
            gateway.settle(method.used());
        }
        let mut broken = false;
        let n_iterations = method.n_iterations();
        if let (Some(operation), Some((x, fun))) = (method.operation(), &gateway.best)
            && observed.is_none_or(|n| n < n_iterations)
        {
            observed = Some(n_iterations);
            let progress = Progress {
                n_iterations,
                n_evaluations: gateway.n_evaluations,
                n_failed: gateway.n_failed,
                x,
                fun: *fun,
                operation,
                simplex: method.simplex(),
                population: method.population(),
                tests: method.tests(),
                seconds: gateway.elapsed(),
                trace: &gateway.trace,
                first_recent,
            };
            broken = observer.as_deref_mut().is_some_and(|o| o(&progress).is_break());
            first_recent = gateway.trace.len();
        }
        // An interrupt outranks a result that came at the same moment; a result outranks a limit.
        if let Some(hard @ (Termination::Aborted(_) | Termination::Interrupted)) = stopped {
            return Ok(Some(hard));
        }
        if gateway.target_reached() {
            return Ok(Some(Termination::Target));
        }
        match method.status() {
            Status::Ended(termination) => return Ok(Some(termination)),
            Status::NoStart => return Ok(None),
            Status::Running if broken => return Ok(Some(Termination::StoppedByObserver)),
            Status::Running => {}
        }
        if stopped.is_some() {
            return Ok(stopped);
        }
        if observed.is_some() && limits.max_iterations.is_some_and(|m| n_iterations >= m) {
            return Ok(Some(Termination::MaxIterations));
        }
    }
}

fn report<M: Method + ?Sized>(
    method: &M,
    mut gateway: Gateway<'_>,
    limits: &Limits,
    workers: usize,
    termination: Termination,
) -> Result<Report, Error> {
    let seconds = gateway.elapsed();
    let Some((x, fun)) = gateway.best.take() else {
        return Err(Error::EndedWithoutPoint { termination, found: gateway.nothing_found() });
    };
    Ok(Report {
        message: message(method, &gateway, limits, &termination, fun, seconds),
        x,
        fun,
        n_evaluations: gateway.n_evaluations,
        n_iterations: method.n_iterations(),
        n_batches: gateway.n_batches,
        n_failed: gateway.n_failed,
        n_speculative: gateway.n_speculative(),
        termination,
        tests: method.tests(),
        failures: gateway.failures(),
        trace: std::mem::take(&mut gateway.trace),
        final_simplex: method.simplex().map(|s| s.to_owned()),
        final_population: method.population().map(|s| s.to_owned()),
        schedule: method.schedule().to_vec(),
        seed: method.seed(),
        method: method.name(),
        batch: method.plan(),
        workers,
        seconds,
    })
}

fn message<M: Method + ?Sized>(
    method: &M,
    gateway: &Gateway<'_>,
    limits: &Limits,
    termination: &Termination,
    fun: f64,
    seconds: f64,
) -> String {
    let tests = method.tests().map_or_else(String::new, |t| t.to_string());
    let with_tests = |text: String| if tests.is_empty() { text } else { format!("{text}; {tests}") };
    match termination {
        Termination::Converged => format!("converged; {tests}"),
        Termination::Target => {
            format!("target reached: cost {fun:e} <= {:e}", limits.target.unwrap_or(f64::NAN))
        }
        Termination::Collapsed => {
            with_tests("the search has no extent left that floating-point numbers resolve".to_owned())
        }
        Termination::Stalled => with_tests("nothing new was found for long".to_owned()),
        Termination::AllFixed => "all parameters are fixed: their one point was evaluated".to_owned(),
        Termination::MaxEvaluations => {
            with_tests(format!("stopped at the limit of {} evaluations", gateway.n_evaluations))
        }
        Termination::MaxIterations => {
            with_tests(format!("stopped at the limit of {} iterations", method.n_iterations()))
        }
        Termination::MaxTime => {
            let limit = limits.max_time.map_or(seconds, |t| t.as_secs_f64());
            with_tests(format!("stopped at the time limit of {limit} s"))
        }
        Termination::StoppedByObserver => with_tests("stopped by the observer".to_owned()),
        Termination::Interrupted => with_tests("interrupted".to_owned()),
        Termination::Aborted(reason) => format!("aborted by the objective: {reason}"),
    }
}
