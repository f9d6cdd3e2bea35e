//! One run of a simulator: waiting for the library, starting the instance, and the run itself.

use super::simulator::Simulator;
use crate::cancel_request::CancelRequest;
use crate::description::{Causality, QuirkKind};
use crate::error::FmiError;
use crate::sys::{Inside, InterfaceKind, forget_refusal, is_worker, note_run, refusal};
use base::Number;
use ode::{ErrorKind, Ignore, Observer, Report, Seconds, SimulationError, Stats};
use std::sync::Arc;
use std::time::Instant;

impl Simulator {
    /// True if a call of the library has returned `Fatal`.
    pub(super) fn is_fatal(&self) -> bool {
        self.library.as_ref().is_some_and(|library| library.is_fatal())
    }

    /// Loads the library, if it is not loaded yet or has returned `Fatal`.
    fn ensure_library(&mut self, wait: &mut dyn FnMut() -> bool) -> Result<(), FmiError> {
        if self.library.is_some() && !self.is_fatal() {
            return Ok(());
        }
        self.was_reset = None;
        drop(self.engine.running().retire());
        let cancel = CancelRequest::from(self.plan.options.cancel.clone());
        let library = self.plan.fmu().library(self.plan.kind, Some(&self.plan.settings), &cancel, wait);
        self.library = Some(library.map_err(|error| match error {
            FmiError::Cancelled => self.ended(ErrorKind::Cancelled),
            error => error,
        })?);
        Ok(())
    }

    /// Waits until no other thread is inside the library. Loads the library if necessary.
    ///
    /// # Errors
    /// Returns an error if the library cannot be loaded, or `observer`, the plan's flag or the time limit has
    /// ended the simulation.
    fn enter(&mut self, observer: &mut dyn Observer) -> Result<Inside, FmiError> {
        let cancel = CancelRequest::from(self.plan.options.cancel.clone());
        let mut goes_on = || !cancel.is_requested() && observer.poll().is_continue();
        loop {
            self.ensure_library(&mut goes_on)?;
            let Some(library) = &self.library else { continue };
            let (limit, began) = (self.plan.options.limits.timeout, Instant::now());
            let mut is_late = false;
            let mut wait = || {
                is_late = limit.is_some_and(|limit| began.elapsed() >= limit);
                !is_late && goes_on()
            };
            match (Inside::enter_while(library.lock(), &mut wait), limit) {
                (Some(inside), _) if !library.is_fatal() => return Ok(inside),
                (Some(_), _) => {}
                (None, Some(limit)) if is_late => return Err(self.ended(ErrorKind::TimedOut(limit))),
                (None, _) => return Err(self.ended(ErrorKind::Cancelled)),
            }
        }
    }

    /// Returns the error of a simulation that ended before it started.
    pub(super) fn ended(&self, kind: ErrorKind) -> FmiError {
        FmiError::Simulation(Box::new(SimulationError {
            kind,
            time: self.plan.start,
            step: 0.0,
            worst_state: None,
            last_event: None,
            not_finite: None,
            undetermined: None,
            refusal: None,
            stats: Stats::default(),
        }))
    }

    /// Runs the simulation with checked parameters.
    pub(super) fn run_checked(
        &mut self,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Report, FmiError> {
        let _inside = self.enter(observer)?;
        note_run();
        forget_refusal();
        self.start(parameters)?;
        let starting = self.began.elapsed().as_secs_f64();
        let mut outcome = self.engine.run(&self.plan, observer);
        let input_functions = self.engine.running().seconds_in_input_functions();
        self.engine.running().pass_log_on();
        if let Some(refusal) = refusal() {
            self.plan.fmu().note_quirk(QuirkKind::Promise, refusal);
        }
        if is_worker() && !self.keeps_end {
            // In a worker process, the effect of `retire` on the process is part of the result.
            self.retire();
        }
        let Some(stats) = stats_of(&mut outcome) else { return outcome };
        stats.seconds += Seconds::new(starting);
        // The start counts as time in the model. So do all calls of the run except the user's input
        // functions.
        let in_calls = starting + stats.seconds_in_model.get();
        stats.seconds_in_model = Seconds::new(in_calls.min(stats.seconds.get() - input_functions).max(0.0));
        outcome
    }

    /// Brings the FMU to its start with checked parameters.
    pub(super) fn initialize_checked(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        let _inside = self.enter(&mut Ignore)?;
        self.start(parameters)?;
        self.engine.run_initial_events()
    }

    /// Initializes an instance, and compares it with its start values and initial states.
    fn start(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.start_instance(parameters)?;
        let plan = Arc::clone(&self.plan);
        let core = self.engine.running().current.core()?;
        plan.values.initial.compare_guesses(core, plan.fmu(), parameters);
        match plan.kind {
            // Model exchange sets the initial states when the run begins.
            InterfaceKind::ModelExchange => Ok(()),
            InterfaceKind::CoSimulation => plan.values.initial.check_required(core, plan.fmu(), parameters),
        }
    }

    /// Initializes a new instance, or a reset instance if it has the specified values.
    fn start_instance(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.began = Instant::now();
        let (instance, is_used) = match self.fresh_instance() {
            // A failure to terminate or reset the last run's instance does not affect this run.
            Err(_) if self.is_fatal() => {
                self.ensure_library(&mut || true)?;
                self.fresh_instance()?
            }
            outcome => outcome?,
        };
        self.engine.initialize(instance, self.plan.values.input(parameters))?;
        // If the values cannot be read, a new instance is trusted and a reset one is not.
        if self.has_values(parameters).unwrap_or(!is_used) {
            return Ok(());
        }
        if !is_used {
            return self.check_taken(parameters);
        }
        // A reset instance that lost its values is replaced by a new one.
        self.start_new(parameters)?;
        match self.has_values(parameters) {
            Ok(true) => Ok(()),
            _ => self.check_taken(parameters),
        }
    }

    /// Checks a new instance that does not have all its specified values. Returns an error if the value of a
    /// parameter was ignored. A value that another variable determines is recorded as a quirk.
    fn check_taken(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        let plan = Arc::clone(&self.plan);
        let core = self.engine.running().current.core()?;
        let Ok(Some(lost)) = plan.values.first_lost(core, plan.fmu().description(), parameters) else {
            plan.values.read_back.set_overridden();
            return Ok(());
        };
        let (name, given, found) = (lost.variable.name.clone(), lost.given, lost.found);
        if lost.variable.causality == Causality::Parameter {
            return Err(FmiError::NotTaken { name, given, found });
        }
        let (given, found) = (Number(given), Number(found));
        let message = format!("{name} was set to {given}, but is {found} after the initialization");
        plan.fmu().note_quirk(QuirkKind::Promise, message);
        plan.values.read_back.set_overridden();
        Ok(())
    }

    fn start_new(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        let raw = self.new_instance()?;
        self.engine.initialize(raw, self.plan.values.input(parameters))
    }

    fn has_values(&mut self, parameters: &[f64]) -> Result<bool, FmiError> {
        let core = self.engine.running().current.core()?;
        self.plan.values.has_values(core, parameters, &mut self.buffers)
    }
}

/// Returns the statistics of a run that had started.
fn stats_of(outcome: &mut Result<Report, FmiError>) -> Option<&mut Stats> {
    match outcome {
        Ok(report) => Some(&mut report.stats),
        Err(FmiError::Simulation(error)) => Some(&mut error.stats),
        Err(_) => None,
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let Some(library) = self.library.take() else { return };
        let (was_reset, current) =
            (self.was_reset.take(), std::mem::take(&mut self.engine.running().current));
        // This does not wait, because the dropping thread may hold locks that the thread inside the library
        // needs.
        Arc::clone(library.lock()).when_free(move || {
            drop((was_reset, current.retire()));
            drop(library);
        });
    }
}
