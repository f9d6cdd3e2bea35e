//! Co-simulation: the loop over communication points, which delivers the same samples as the integration of a model.
//! Which points these are says [`Communication`].
//!
//! At each point the row is read first; the inputs of the next step are set just before the step. So rows are limits from
//! the left, and those at the start are read after the initialization with the inputs of that time. Limits from the right
//! exist in event mode only (FMI 3.0): at a point with events or jumps of inputs the row is read behind them, and a time
//! listed twice has both.

mod run;
mod samples;

use crate::beginning::StartValues;
use crate::description::Variable;
use crate::error::FmiError;
use crate::plan::SimulationPlan;
use crate::running::{Phase, Running, no_instance};
use crate::sys::RawInstance;
use ode::{ErrorKind, EventOutcome, Limits, Observer, Report, Seconds, SimulationError, Stats, Stopwatch};
use run::{Call, Exit, Run};
use std::sync::Arc;
use std::time::Instant;

/// One worker's co-simulation: the instance and everything that is written during a run.
#[derive(Debug)]
pub(crate) struct Stepping {
    pub(crate) running: Running,
    /// Rows of outputs at the beginning and the end of a step, and one in between.
    before: Vec<f64>,
    after: Vec<f64>,
    between: Vec<f64>,
    slopes: Vec<f64>,
    /// Derivatives of outputs at the end of a step, where there are some.
    ends: Vec<f64>,
    /// Inputs on their way during a step.
    intermediate: Vec<f64>,
    /// What the initial events told.
    initial: EventOutcome,
    stopwatch: Stopwatch<{ Call::KINDS }>,
}

impl Stepping {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        let row = || vec![0.0; plan.outputs().len()];
        Self {
            before: row(),
            after: row(),
            between: row(),
            slopes: vec![0.0; plan.inputs.continuous.start.len()],
            ends: Vec::with_capacity(plan.outputs().smooth.0.len()),
            intermediate: Vec::with_capacity(plan.inputs.intermediate.0.len()),
            initial: EventOutcome::default(),
            stopwatch: Stopwatch::new(),
            running: Running::new(plan),
        }
    }

    /// Brings a fresh instance to its first communication point: values, inputs, initialization.
    pub(crate) fn initialize(
        &mut self,
        raw: RawInstance,
        start_values: &StartValues,
        parameters: &[f64],
    ) -> Result<(), FmiError> {
        let plan = &self.running.plan;
        let ends_exactly = plan.communication.as_ref().is_some_and(|c| c.ends_exactly);
        let stop = ends_exactly.then_some(plan.end);
        let instance = self.running.begin(raw, start_values, parameters, stop)?;
        let Running { plan, current, clocks, buffers, .. } = &mut self.running;
        let (instance, outcome) = instance.begin_steps(|core, time| {
            let recorded = &plan.outputs().clocks;
            clocks.settle(&plan.clocks, core, time, (recorded, buffers)).map(|(outcome, _)| outcome)
        })?;
        self.initial = outcome;
        current.phase = Phase::Stepping(instance);
        Ok(())
    }

    /// Value of a variable at the last communication point.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<crate::Value, FmiError> {
        self.running.current.trusted()?.value(variable)
    }

    /// Runs from the start to the end.
    ///
    /// # Errors
    /// [`FmiError::Simulation`] says why, where and with which numbers; samples delivered before it stay valid.
    pub(crate) fn run(&mut self, limits: &Limits, observer: &mut dyn Observer) -> Result<Report, FmiError> {
        let plan = Arc::clone(&self.running.plan);
        let Some(communication) = &plan.communication else { return Err(no_instance()) };
        self.stopwatch.reset();
        let mut run = Run {
            stepping: self,
            plan: &plan,
            communication,
            limits,
            observer,
            t: plan.start,
            origin: plan.start,
            passed: 0,
            on_grid: true,
            next_row: 0,
            lengths: [f64::NAN; _],
            longest: f64::INFINITY,
            next_event: None,
            discards: 0,
            tried: 0.0,
            stats: Stats::default(),
            began: Instant::now(),
        };
        let exit = match run.start() {
            Ok(()) => loop {
                if let Err(exit) = run.advance() {
                    break exit;
                }
            },
            Err(exit) => exit,
        };
        let seconds = run.began.elapsed().as_secs_f64();
        run.stats.seconds = Seconds::new(seconds);
        run.stats.seconds_in_model = Seconds::new(run.stepping.stopwatch.seconds().min(seconds));
        let (time, step, stats) = (run.t.min(plan.end), run.tried, run.stats);
        match exit {
            Exit::Normal(termination) => Ok(Report { termination, time, stats }),
            Exit::Error(kind) => {
                self.running.current.broken |= matches!(kind, ErrorKind::Model(_));
                let error = SimulationError {
                    kind,
                    time,
                    step,
                    worst_state: None,
                    last_event: None,
                    not_finite: None,
                    undetermined: None,
                    refusal: None,
                    stats,
                };
                Err(FmiError::Simulation(Box::new(error)))
            }
        }
    }
}
