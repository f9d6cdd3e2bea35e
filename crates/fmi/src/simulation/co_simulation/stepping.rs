//! What a co-simulation keeps from run to run: the instance and its buffers, and how it begins.

use crate::description::Variable;
use crate::error::FmiError;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::running::{Phase, Running};
use crate::simulation::variable_elements::RunInput;
use crate::sys::RawInstance;
use ode::{EventOutcome, Stopwatch};
use std::sync::Arc;

/// One worker's co-simulation: the instance and everything that is written during a run.
#[derive(Debug)]
pub(crate) struct Stepping {
    pub(crate) running: Running,
    /// Rows of outputs at the beginning and the end of a step, and one in between.
    pub(super) before: Vec<f64>,
    pub(super) after: Vec<f64>,
    pub(super) between: Vec<f64>,
    pub(super) slopes: Vec<f64>,
    /// Derivatives of outputs at the end of a step, where there are some.
    pub(super) ends: Vec<f64>,
    /// What the initial events told.
    pub(super) initial: EventOutcome,
    pub(super) stopwatch: Stopwatch<{ Call::KINDS }>,
}

impl Stepping {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        let row = || vec![0.0; plan.outputs().len()];
        Self {
            before: row(),
            after: row(),
            between: row(),
            slopes: vec![0.0; plan.inputs.continuous.start().len()],
            ends: Vec::with_capacity(plan.outputs().smooth.0.len()),
            initial: EventOutcome::default(),
            stopwatch: Stopwatch::new(),
            running: Running::new(plan),
        }
    }

    /// Brings a fresh instance to its first communication point: values, inputs, initialization.
    pub(crate) fn initialize(&mut self, raw: RawInstance, input: RunInput<'_>) -> Result<(), FmiError> {
        let plan = &self.running.plan;
        let ends_exactly = plan.communication.as_ref().is_some_and(|c| c.ends_exactly);
        let stop = ends_exactly.then_some(plan.end);
        let instance = self.running.begin(raw, input, stop)?;
        let Running { plan, current, clocks, buffers, .. } = &mut self.running;
        let (instance, outcome) = instance.begin_steps(|core, time| {
            let recorded = &plan.outputs().clocks;
            clocks.iterate_events(&plan.clocks, core, time, (recorded, buffers)).map(|(outcome, _)| outcome)
        })?;
        self.initial = outcome;
        current.phase = Phase::Stepping(instance);
        Ok(())
    }

    /// Value of a variable at the last communication point.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<crate::Value, FmiError> {
        self.running.current.trusted()?.value(variable)
    }
}

/// The calls into the model, by kinds for the stopwatch.
#[derive(Clone, Copy)]
pub(super) enum Call {
    /// A communication step.
    Step,
    /// Outputs and their derivatives.
    Outputs,
    /// Inputs, and what they are computed from.
    Inputs,
    /// A visit of event mode: timed each.
    Events,
}

impl Call {
    pub(super) const KINDS: usize = Self::Events as usize + 1;
}
