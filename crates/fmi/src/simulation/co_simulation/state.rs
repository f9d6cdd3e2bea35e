//! State of a co-simulation that is kept between runs (the instance and its buffers), and its initialization.

use crate::description::Variable;
use crate::error::Result;
use crate::instance::Core;
use crate::simulation::plan::{Communication, SimulationPlan};
use crate::simulation::running::{Current, Mode, Running};
use crate::simulation::shared_observer::SharedObserver;
use crate::simulation::variable_elements::RunInput;
use crate::sys::RawInstance;
use ode::{EventOutcome, Stopwatch};
use std::sync::Arc;

/// Co-simulation of one worker: the instance and all data written during a run.
#[derive(Debug)]
pub(crate) struct CoSimulationState {
    pub(crate) running: Running,
    /// Rows of outputs at the start and the end of a step, and one row between them.
    pub(super) before: Vec<f64>,
    pub(super) after: Vec<f64>,
    pub(super) between: Vec<f64>,
    pub(super) slopes: Vec<f64>,
    /// Derivatives of outputs at the end of a step, if available.
    pub(super) ends: Vec<f64>,
    pub(super) stopwatch: Stopwatch<{ Call::KINDS }>,
    /// Stop time. `is_stop_time_passed` is true if it was passed to the model.
    pub(super) stop: f64,
    pub(super) is_stop_time_passed: bool,
}

impl CoSimulationState {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        let row = || vec![0.0; plan.outputs().len()];
        Self {
            before: row(),
            after: row(),
            between: row(),
            slopes: vec![0.0; plan.inputs.continuous.start().len()],
            ends: Vec::with_capacity(plan.outputs().smooth.0.len()),
            stopwatch: Stopwatch::new(),
            stop: plan.end,
            is_stop_time_passed: false,
            running: Running::new(plan),
        }
    }

    /// Brings a new instance to the start time. Sets values and inputs, and initializes.
    pub(crate) fn initialize(&mut self, raw: RawInstance, input: RunInput<'_>) -> Result<()> {
        let plan = &self.running.plan;
        let stop = |c: &Communication| c.stop_time(plan.start, plan.end, plan.time_tolerance);
        self.stop = plan.communication.as_ref().map_or(plan.end, stop);
        self.is_stop_time_passed = plan.fmu().reset_knowledge(plan.kind).stop_time.is_passed();
        let began = self.running.begin(raw, input, self.is_stop_time_passed.then_some(self.stop));
        let core = Some(began.inspect_err(|_| self.note_failure())?);
        self.running.current = Current { core, mode: Mode::Step, ..Current::default() };
        Ok(())
    }

    /// Records that the model failed.
    pub(super) fn note_failure(&self) {
        let plan = &self.running.plan;
        let mut knowledge = plan.fmu().reset_knowledge(plan.kind);
        knowledge.stop_time = knowledge.stop_time.after_failure(self.is_stop_time_passed);
    }

    /// Handles the initial events if there is an event mode.
    pub(crate) fn run_initial_events(&mut self, outside: &SharedObserver<'_>) -> Result<EventOutcome> {
        let start = self.running.plan.start;
        let has_event_mode = self.running.current.core()?.raw.has_event_mode();
        if has_event_mode { self.run_event_mode(start, outside) } else { Ok(EventOutcome::default()) }
    }

    /// Handles the events at one time in event mode, and returns to step mode.
    pub(super) fn run_event_mode(&mut self, time: f64, outside: &SharedObserver<'_>) -> Result<EventOutcome> {
        let Running { plan, current, clocks, buffers, .. } = &mut self.running;
        let events = |core: &mut Core, time| {
            let recorded = (&*plan.outputs().clocks, buffers);
            clocks.iterate_events(&plan.clocks, core, time, recorded, outside)
        };
        let outcome = current.core()?.run_event_mode(time, events);
        // Between two rounds, or after an error, the state of the model is undefined.
        current.broken |= outcome.is_err();
        outcome
    }

    /// Returns the value of a variable at the last communication point.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<crate::Value> {
        self.running.current.trusted()?.value(variable)
    }
}

/// Kinds of calls into the model, for the stopwatch.
#[derive(Clone, Copy)]
pub(super) enum Call {
    /// Communication step.
    Step,
    /// Outputs and their derivatives.
    Outputs,
    /// Inputs and their computation.
    Inputs,
    /// Visit of event mode; every visit is timed.
    Events,
}

impl Call {
    pub(super) const KINDS: usize = Self::Events as usize + 1;
}
