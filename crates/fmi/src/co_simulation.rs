//! The running mode of co-simulation: communication steps from point to point.

use crate::error::FmiError;
use crate::instance::{CoSimulation, Core, Initialization, Instance, StepMode, Terminated};
use crate::sys::{RawInstance, StepInfo};
use std::thread;
use std::time::Duration;

/// What became of a communication step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct StepOutcome {
    /// The model stands at the end of the step.
    pub complete: bool,
    /// Where it stands otherwise, if it says so.
    pub reached: Option<f64>,
    /// The model wishes to end the simulation here.
    pub terminate: bool,
}

/// How often a step that is computed in the background is asked for.
const POLL: Duration = Duration::from_micros(100);

impl Core {
    /// One communication step. A step that goes on in the background is waited for as long as `keep_waiting` says so,
    /// and then cancelled (`None`).
    pub(crate) fn do_step(
        &mut self,
        time: f64,
        step: f64,
        keep_waiting: &mut dyn FnMut() -> bool,
    ) -> Result<Option<StepOutcome>, FmiError> {
        let mut info = StepInfo::default();
        let mut complete = self.call(|raw| raw.do_step(time, step, &mut info))?;
        while info.pending {
            if !keep_waiting() {
                self.raw.abandon_step();
                return Ok(None);
            }
            thread::sleep(POLL);
            info = StepInfo::default();
            complete = self.call(|raw| raw.step_status(&mut info))?;
        }
        Ok(Some(StepOutcome { complete, reached: info.reached, terminate: info.terminate }))
    }
}

impl Instance<Initialization, CoSimulation> {
    /// Ends the initialization.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn exit_initialization(self) -> Result<Instance<StepMode, CoSimulation>, FmiError> {
        self.step_to(RawInstance::exit_initialization)
    }
}

impl Instance<StepMode, CoSimulation> {
    /// Lets the model compute the step from `time`, where it stands, to `time + step`.
    ///
    /// # Errors
    /// The FMU refuses. A step that it computes in part or not at all is no error: see [`StepOutcome`].
    pub fn do_step(&mut self, time: f64, step: f64) -> Result<StepOutcome, FmiError> {
        Ok(self.core().do_step(time, step, &mut || true)?.unwrap_or_default())
    }

    /// Sets the first derivatives of real inputs with respect to time, for the next step.
    ///
    /// # Errors
    /// The slices differ in length; the FMU cannot, or refuses.
    pub fn set_input_derivatives(&mut self, references: &[u32], values: &[f64]) -> Result<(), FmiError> {
        self.core().call(|raw| raw.set_input_derivatives(references, values))
    }

    /// Ends the simulation.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn terminate(self) -> Result<Instance<Terminated, CoSimulation>, FmiError> {
        self.step_to(RawInstance::terminate)
    }
}
