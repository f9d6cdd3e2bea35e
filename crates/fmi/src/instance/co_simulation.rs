//! Step mode of co-simulation: communication steps.

use super::core::Core;
use super::model_exchange::MAX_EVENT_ITERATIONS;
use super::phases::{CoSimulation, Initialization, Instance, StepMode, Terminated};
use crate::error::Result;
use crate::sys::{RawInstance, StepInfo};
use ode::{EventOutcome, Stopped};
use serde::{Deserialize, Serialize};
use std::thread;
use std::time::Duration;

/// Outcome of a communication step.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct StepOutcome {
    /// True if the model is at the end of the step.
    pub complete: bool,
    /// Time of the model after the step, if the model reports it. FMI 3.0 always reports it
    /// (`lastSuccessfulTime`); earlier versions report it only for incomplete steps. After a complete step it
    /// may differ from the end of the step if the model has internal steps.
    pub reached: Option<f64>,
    /// True if the model returned early (FMI 3.0). The rest of the step must not be repeated.
    pub early: bool,
    /// True if the model requests the end of the simulation.
    pub terminate: bool,
    /// True if the model requests event handling at this point: see
    /// [`Instance::handle_events`](Instance::handle_events).
    pub event: bool,
    /// True if the step was incomplete and the model cannot report whether it requests the end of the
    /// simulation (FMI 1.0). If the model then rejects steps of any length, it has ended.
    pub may_have_ended: bool,
}

/// Time between two status queries of a step that is computed asynchronously.
const POLL: Duration = Duration::from_micros(100);

impl Core {
    /// Makes one communication step from `time`. Waits for an asynchronous step until `keep_waiting` returns
    /// an error, and then cancels the step.
    pub(crate) fn do_step(
        &mut self,
        time: f64,
        step: f64,
        keep_waiting: &dyn Fn() -> Result<(), Stopped>,
    ) -> Result<StepOutcome> {
        let mut info = StepInfo::default();
        let mut complete = self.call(|raw| raw.do_step(time, step, &mut info))?;
        while info.pending {
            if let Err(stopped) = keep_waiting() {
                self.raw.abandon_step();
                return Err(stopped.into());
            }
            thread::sleep(POLL);
            info = StepInfo::default();
            complete = self.call(|raw| raw.step_status(&mut info))?;
        }
        let StepInfo { reached, early, terminate, event, may_have_ended, .. } = info;
        Ok(StepOutcome { complete, reached, early, terminate, event, may_have_ended })
    }
}

impl Core {
    /// Handles the events at this time in event mode. Returns to step mode unless the model ends the
    /// simulation.
    pub(crate) fn run_event_mode(
        &mut self,
        time: f64,
        events: impl FnOnce(&mut Core, f64) -> Result<EventOutcome>,
    ) -> Result<EventOutcome> {
        let outcome = events(self, time)?;
        if !outcome.terminate {
            self.call(RawInstance::enter_step_mode)?;
        }
        Ok(outcome)
    }
}

/// Handles the events of a run that the user controls.
fn settle(core: &mut Core, time: f64) -> Result<EventOutcome> {
    core.settle_events(time, core.progress.time_tolerance(time), MAX_EVENT_ITERATIONS)
}

impl Instance<Initialization, CoSimulation> {
    /// Ends the initialization and handles the initial events.
    ///
    /// # Errors
    /// Returns an error if the model has a clock that ticks without being activated but no event mode, or if
    /// the FMU returns an error.
    pub fn exit_initialization(mut self) -> Result<Instance<StepMode, CoSimulation>> {
        let has_event_mode = self.core().raw.has_event_mode();
        self.core().begin_clocks(has_event_mode)?;
        let mut instance: Instance<StepMode, CoSimulation> =
            self.step_to(RawInstance::exit_initialization)?;
        let core = instance.core();
        let time = core.raw.time().unwrap_or(0.0);
        if has_event_mode {
            core.run_event_mode(time, settle)?;
        }
        Ok(instance)
    }
}

impl Instance<StepMode, CoSimulation> {
    /// Lets the model compute the step from `time`, its current time, to `time + step`.
    ///
    /// Events at `time` are handled first if the model has requested event mode, inputs wait for it, or a
    /// clock is due. Clock ticks within the step are handled as well. Events at the end of the step are
    /// handled by [`handle_events`](Self::handle_events) or the next step.
    ///
    /// # Errors
    /// Returns an error if the FMU does. A step that the FMU computes only partly or not at all is not an
    /// error: see [`StepOutcome`].
    pub fn do_step(&mut self, time: f64, step: f64) -> Result<StepOutcome> {
        let core = self.core();
        let tolerance = core.progress.time_tolerance(time + step);
        let (end, mut t, mut length) = (time + step, time, step);
        loop {
            if core.has_events_at(t, tolerance) {
                core.call(RawInstance::enter_event_mode)?;
                let events = |core: &mut Core, t| core.settle_events(t, tolerance, MAX_EVENT_ITERATIONS);
                if core.run_event_mode(t, events)?.terminate {
                    return Ok(StepOutcome { terminate: true, reached: Some(t), ..StepOutcome::default() });
                }
            }
            let tick = core.progress.next_tick().filter(|tick| *tick < end - tolerance);
            let outcome = core.do_step(t, tick.map_or(length, |tick| tick - t), &|| Ok(()))?;
            core.progress.needs_event = outcome.event && core.raw.has_event_mode();
            match tick {
                Some(tick) if outcome.complete && !outcome.early && !outcome.terminate => {
                    (t, length) = (tick, end - tick);
                }
                _ => {
                    let event = outcome.event || outcome.complete && core.has_events_at(end, tolerance);
                    return Ok(StepOutcome { event, ..outcome });
                }
            }
        }
    }

    /// Handles the model's events at `time`, its current time. Call this function after a step whose outcome
    /// requests it.
    ///
    /// # Errors
    /// Returns an error if the FMU has no event mode, or returns an error.
    pub fn handle_events(&mut self, time: f64) -> Result<EventOutcome> {
        let core = self.core();
        core.call(RawInstance::enter_event_mode)?;
        core.run_event_mode(time, settle)
    }

    /// Sets the first derivatives of real inputs with respect to time for the next step.
    ///
    /// # Errors
    /// Returns an error if the slices differ in length, or a reference does not belong to a variable of type
    /// Real. Also returns an error if the FMU does not support input derivatives, or returns an error.
    pub fn set_input_derivatives(&mut self, references: &[u32], values: &[f64]) -> Result<()> {
        self.core().check_reals("set_input_derivatives", references, values.len())?;
        self.core().call(|raw| raw.set_input_derivatives(references, values))
    }

    /// Ends the simulation.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn terminate(self) -> Result<Instance<Terminated, CoSimulation>> {
        self.step_to(RawInstance::terminate)
    }
}
