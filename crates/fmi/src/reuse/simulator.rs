//! One worker's simulator: a plan, a live instance, a driver and buffers, run as often as one likes.

use super::runner::{RunnerGuard, SharedRunner};
use crate::description::Value;
use crate::error::FmiError;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::trajectory::{Recorder, Trajectory};
use crate::simulation::variable_elements::{VariableElement, element_value};
use ode::{Observer, Report};
use std::cell::Cell;
use std::marker::PhantomData;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Runs one plan over and over, each time from a freshly reset instance: the same parameters give the same bits, whatever
/// was run before. One thread at a time uses it ([`Send`], not `Sync`); when warm, a run allocates nothing.
///
/// At the first run it gets a loaded copy of the FMU's library of its own (see [`Sharing`](crate::Sharing)); the copy goes on to others when the
/// simulator is dropped. Where there can be only one, it goes to whoever runs next, and the values of this simulator's
/// last run are gone then ([`FmiError::Disturbed`]).
///
/// Before an instance is used again, the way of resetting it is put to the test: the first steps
/// must have the same bits as on a new instance, also after a run with other values, or from then on the next way is taken
/// (see [`Reuse`](crate::Reuse): a saved state, the reset function, a new instance for every run). Parameters and start values are set
/// again for every run, and read back from an instance that was used before; so are variables that others have set in the
/// same copy of the library before, to what they are in a new one.
///
/// ```compile_fail
/// fn shared_between_threads<T: Sync>() {}
/// shared_between_threads::<fmi::Simulator>();
/// ```
#[derive(Debug)]
pub struct Simulator {
    plan: Arc<SimulationPlan>,
    shared: Arc<SharedRunner>,
    /// Calls come from one thread at a time.
    _not_sync: PhantomData<Cell<()>>,
}

impl Simulator {
    /// Makes a simulator. Nothing is loaded or run yet.
    ///
    /// # Errors
    /// Options of the method that cannot be used.
    pub fn new(plan: Arc<SimulationPlan>) -> Result<Self, FmiError> {
        let shared = SharedRunner::new(Arc::clone(&plan))?;
        Ok(Self { plan, shared, _not_sync: PhantomData })
    }

    /// Uses what runs the plan.
    pub(crate) fn runner(&mut self) -> RunnerGuard<'_> {
        self.shared.enter()
    }

    /// Keeps its copy of the library between runs, or lets others have it.
    pub(crate) fn pin(&mut self, pinned: bool) {
        self.shared.pin(pinned);
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Goes on with another plan. One that [`SimulationPlan::with_rows`] made of the present one takes over the instance and what
    /// is known of resetting it.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn set_plan(&mut self, plan: Arc<SimulationPlan>) -> Result<(), FmiError> {
        if self.plan.fits(&plan) {
            self.runner().set_plan(&plan);
        } else {
            self.shared = SharedRunner::new(Arc::clone(&plan))?;
        }
        self.plan = plan;
        Ok(())
    }

    /// Simulates once, with these values for the plan's parameters, and hands the samples to `observer`.
    ///
    /// Where all copies of the library that there can be are in simulations, waits for one of them to end; `observer` is
    /// polled meanwhile.
    ///
    /// The seconds of the report count from resetting the model; loading, waiting and the trial runs before a
    /// first use do not count. Those inside the model are in calls of the FMU (of calls that take less than 1 us only
    /// some are timed) and do not include input functions ([`Inputs::function`](crate::Inputs::function)).
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters; the FMU cannot be loaded or instantiated
    /// ([`FmiError::NoCopy`]: not any more, or not now); the FMU or the integration fails. The simulator can be used again
    /// after an error: a broken instance is replaced, after `Fatal` in a newly loaded copy of the library.
    /// [`FmiError::FailedByHistory`]: make the run again, with a new observer.
    pub fn run(&mut self, parameters: &[f64], observer: &mut dyn Observer) -> Result<Report, FmiError> {
        self.plan.values.check_parameters(parameters)?;
        self.runner().run(parameters, observer)
    }

    /// Simulates once and records all samples.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn trajectory(&mut self, parameters: &[f64]) -> Result<Trajectory, FmiError> {
        self.trajectory_with(parameters, &mut || ControlFlow::Continue(()))
    }

    /// As [`trajectory`](Self::trajectory); `poll` is asked before every step, and `Break` ends the simulation there.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn trajectory_with(
        &mut self,
        parameters: &[f64],
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Trajectory, FmiError> {
        self.plan.values.check_parameters(parameters)?;
        let plan = Arc::clone(&self.plan);
        let mut runner = self.runner();
        let (recorder, report) = loop {
            let mut recorder = Recorder::new(&plan, &mut *poll)?;
            match runner.run(parameters, &mut recorder) {
                Err(FmiError::FailedByHistory { .. }) => {}
                outcome => break (recorder, outcome?),
            }
        };
        let running = runner.engine.running();
        let ticks = running.take_ticks();
        let table = std::mem::take(&mut running.buffers.table);
        Ok(recorder.finish(&plan, table, ticks, report))
    }

    /// Value of a variable, or of an element of an array (`name[2,1]`), where the last run ended (after a step inside of which it was stopped: at the end of the
    /// step before).
    ///
    /// # Errors
    /// There is no such variable, nothing was run yet, the run failed, or the FMU refuses; [`FmiError::Disturbed`].
    pub fn value(&mut self, name: &str) -> Result<Value, FmiError> {
        let plan = Arc::clone(&self.plan);
        let description = plan.fmu().description();
        let place = VariableElement::of_name(description, plan.structure(), name)?;
        let value = self.runner().value(&description.variables[place.variable])?;
        Ok(element_value(value, place.element))
    }

    /// As [`value`](Self::value), as a number: integers and Booleans too.
    ///
    /// # Errors
    /// As [`value`](Self::value); the variable is a text.
    pub fn get(&mut self, name: &str) -> Result<f64, FmiError> {
        self.value(name)?
            .as_number()
            .ok_or_else(|| FmiError::NotAnOutput { name: name.to_owned(), reason: "it is no single number" })
    }

    /// Brings the FMU to its start without simulating: afterwards [`value`](Self::value) gives initial values.
    pub(crate) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.plan.values.check_parameters(parameters)?;
        self.runner().initialize_only(parameters)
    }
}
