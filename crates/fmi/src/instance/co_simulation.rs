//! The running mode of co-simulation: communication steps from point to point.

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
    /// The model stands at the end of the step.
    pub complete: bool,
    /// The time of the model after the step, if it says so: in FMI 3.0 (`lastSuccessfulTime`) always, else
    /// where the step is not complete. After a complete step it may differ from the end of the step where the
    /// model has steps of its own.
    pub reached: Option<f64>,
    /// It stands there because it returned early (FMI 3.0): no more of the step is to be made.
    pub early: bool,
    /// The model wishes to end the simulation here.
    pub terminate: bool,
    /// The model wants its events handled here: see [`Instance::handle_events`](Instance::handle_events).
    pub event: bool,
    /// The step was cut short by a model that cannot say whether it wishes to end the simulation (FMI 1.0):
    /// if it makes no further step of whatever length, it does.
    pub may_have_ended: bool,
}

/// Time between two status queries of a step that is computed in the background.
const POLL: Duration = Duration::from_micros(100);

impl Core {
    /// One communication step from `time` on. A step that goes on in the background is waited for until
    /// `keep_waiting` gives an error, and then cancelled.
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
    /// Lets the events of this instant happen, in event mode, and goes back to step mode unless the model
    /// ends the simulation.
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

/// The events of a run by hand.
fn settle(core: &mut Core, time: f64) -> Result<EventOutcome> {
    core.settle_events(time, core.progress.time_tolerance(time), MAX_EVENT_ITERATIONS)
}

impl Instance<Initialization, CoSimulation> {
    /// Ends the initialization; the initial events happen.
    ///
    /// # Errors
    /// A clock would tick by itself, which takes an event mode, and there is none; the FMU refuses.
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
    /// Lets the model compute the step from `time`, where it stands, to `time + step`. Where the model has
    /// asked for event mode, inputs wait for it, or a clock is due, the events at `time` happen first, and so
    /// they do where a clock ticks within the step. Those at its end are for
    /// [`handle_events`](Self::handle_events), or the next step.
    ///
    /// # Errors
    /// The FMU refuses. A step that it computes in part or not at all is no error: see [`StepOutcome`].
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
            core.progress.is_event_asked = outcome.event && core.raw.has_event_mode();
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

    /// Lets the model's events at `time`, where it stands, happen; after a step whose outcome asks for it.
    ///
    /// # Errors
    /// The FMU has no event mode, or refuses.
    pub fn handle_events(&mut self, time: f64) -> Result<EventOutcome> {
        let core = self.core();
        core.call(RawInstance::enter_event_mode)?;
        core.run_event_mode(time, settle)
    }

    /// Sets the first derivatives of real inputs with respect to time, for the next step.
    ///
    /// # Errors
    /// The slices differ in length, a reference is not that of a variable of type Real; the FMU cannot, or
    /// refuses.
    pub fn set_input_derivatives(&mut self, references: &[u32], values: &[f64]) -> Result<()> {
        self.core().check_reals("set_input_derivatives", references, values.len())?;
        self.core().call(|raw| raw.set_input_derivatives(references, values))
    }

    /// Ends the simulation.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn terminate(self) -> Result<Instance<Terminated, CoSimulation>> {
        self.step_to(RawInstance::terminate)
    }
}
