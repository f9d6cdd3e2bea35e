//! A plan, a live instance, a driver and buffers, for any number of runs.

use crate::description::Value;
use crate::error::FmiError;
use crate::libraries::LoadedLibrary;
use crate::simulation::engine::Engine;
use crate::simulation::plan::{ReadBackBuffers, SimulationPlan};
use crate::simulation::trajectory::{Recorder, Trajectory};
use crate::simulation::variable_elements::{VariableElement, element_value};
use crate::sys::RawInstance;
use ode::{Observer, Report};
use std::cell::Cell;
use std::marker::PhantomData;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// Runs one plan over and over, each time from the start of the model: the same parameters give the same
/// bits, whatever was run before. One thread at a time uses it ([`Send`], not `Sync`); when warm, a run
/// allocates nothing.
///
/// All simulators and instances of an [`Fmu`](crate::Fmu) and its clones are in one loaded library, which
/// nobody else has; one thread at a time is inside of it. A run waits until others are over, and its observer
/// is polled meanwhile.
///
/// Each run has a new instance, unless the simulator is [`resetting`](Self::resetting) or in a worker process
/// (see [`Reuse`](crate::Reuse)). Parameters and start values are set again for every run and read back.
///
/// ```compile_fail
/// fn shared_between_threads<T: Sync>() {}
/// shared_between_threads::<fmi::Simulator>();
/// ```
#[derive(Debug)]
pub struct Simulator {
    pub(super) plan: Arc<SimulationPlan>,
    pub(super) engine: Engine,
    /// The last run's instance after a reset.
    pub(super) was_reset: Option<RawInstance>,
    pub(super) is_resetting: bool,
    pub(super) reset_fails: bool,
    /// The values at the end of a run are asked for after it.
    pub(super) keeps_end: bool,
    pub(super) buffers: ReadBackBuffers,
    /// When the start of the present run began.
    pub(super) began: Instant,
    /// In which its instances are, from the first run on.
    pub(super) library: Option<Arc<LoadedLibrary>>,
    /// Calls come from one thread at a time.
    _not_sync: PhantomData<Cell<()>>,
}

impl Simulator {
    /// Makes a simulator. Nothing is loaded or run yet.
    ///
    /// # Errors
    /// Options of the method that cannot be used.
    pub fn new(plan: Arc<SimulationPlan>) -> Result<Self, FmiError> {
        Ok(Self {
            engine: Engine::new(&plan)?,
            plan,
            was_reset: None,
            is_resetting: false,
            reset_fails: false,
            keeps_end: false,
            buffers: ReadBackBuffers::default(),
            began: Instant::now(),
            library: None,
            _not_sync: PhantomData,
        })
    }

    /// Resets the instance after each run by the FMU's reset function, instead of making a new one. Use it if
    /// making an instance takes long and the model's reset restores everything: nothing is compared here.
    #[must_use]
    pub fn resetting(mut self) -> Self {
        self.is_resetting = true;
        self
    }

    /// The same, with the instance left at the end of each run, so that values can be read there. In a worker
    /// process it is brought back to its start otherwise, as part of the run.
    #[must_use]
    pub(crate) fn keeping_end(mut self) -> Self {
        self.keeps_end = true;
        self
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Goes on with another plan. One that [`SimulationPlan::with_rows`] made of the present one takes over
    /// the instance and what is known of resetting it.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn set_plan(&mut self, plan: Arc<SimulationPlan>) -> Result<(), FmiError> {
        if self.plan.fits(&plan) {
            self.use_plan(&plan);
        } else {
            *self = Self::new(plan)?;
        }
        Ok(())
    }

    /// Goes on with a plan that fits.
    pub(super) fn use_plan(&mut self, plan: &Arc<SimulationPlan>) {
        self.plan = Arc::clone(plan);
        self.engine.running().set_plan(Arc::clone(plan));
    }

    /// Simulates once, with these values for the plan's parameters, and hands the samples to `observer`.
    ///
    /// Where another thread is in a simulation of the same [`Fmu`](crate::Fmu), waits for it to end;
    /// `observer` is polled meanwhile, and no longer than the time limit of the simulation.
    ///
    /// The seconds of the report count from resetting the model, and those of a test of the ways of that are
    /// among them; loading and waiting do not count. Those inside the model are in calls of the FMU (of calls
    /// that take less than 1 us only some are timed) and do not include input functions
    /// ([`Inputs::function`](crate::Inputs::function)).
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters; the FMU cannot be loaded or
    /// instantiated; the FMU or the integration fails. The simulator can be used again after an error: a
    /// broken instance is replaced, after `Fatal` in a newly loaded copy of the library.
    pub fn run(&mut self, parameters: &[f64], observer: &mut dyn Observer) -> Result<Report, FmiError> {
        self.plan.values.check_parameters(parameters)?;
        self.run_checked(parameters, observer)
    }

    /// Simulates once and records all samples.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn trajectory(&mut self, parameters: &[f64]) -> Result<Trajectory, FmiError> {
        self.trajectory_with(parameters, &mut || ControlFlow::Continue(()))
    }

    /// As [`trajectory`](Self::trajectory); `poll` is asked before every step, and `Break` ends the
    /// simulation there.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn trajectory_with(
        &mut self,
        parameters: &[f64],
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Trajectory, FmiError> {
        let plan = Arc::clone(&self.plan);
        plan.fmu().repeat_if_learned(|| {
            let mut recorder = Recorder::new(&plan, &mut *poll)?;
            let report = self.run(parameters, &mut recorder)?;
            let running = self.engine.running();
            let ticks = running.take_ticks();
            let table = std::mem::take(&mut running.buffers.table);
            Ok(recorder.finish(&plan, table, ticks, report))
        })
    }

    /// Value of a variable, or of an element of an array (`name[2,1]`), where the last run ended (after a
    /// step inside of which it was stopped: at the end of the step before).
    ///
    /// # Errors
    /// There is no such variable, nothing was run yet, the run failed, or the FMU refuses.
    pub fn value(&mut self, name: &str) -> Result<Value, FmiError> {
        let plan = Arc::clone(&self.plan);
        let description = plan.fmu().description();
        let place = VariableElement::of_name(description, plan.structure(), name)?;
        let value = self.engine.value(&description.variables[place.variable])?;
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

    /// Brings the FMU to its start without simulating: afterwards [`value`](Self::value) gives initial
    /// values.
    pub(crate) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.plan.values.check_parameters(parameters)?;
        self.initialize_checked(parameters)
    }
}
