//! A plan with an instance, a driver and buffers, for any number of runs.

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

/// Runs one plan any number of times, each time from the start of the model.
///
/// The same parameters give bit-for-bit identical results, independent of previous runs. One thread at a time
/// can use a simulator ([`Send`], not `Sync`). After warm-up, a run does not allocate memory.
///
/// The loaded libraries of an [`Fmu`](crate::Fmu) and its clones are private copies of its file. Simulators
/// that set the same variables share a copy. One thread at a time runs code of these copies. A run waits
/// until other runs have finished, and polls its observer meanwhile.
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
    /// Instance of the last run after a reset.
    pub(super) was_reset: Option<RawInstance>,
    pub(super) is_resetting: bool,
    pub(super) reset_fails: bool,
    /// True if values are read after a run, so the instance must stay at the end of the run.
    pub(super) keeps_end: bool,
    pub(super) buffers: ReadBackBuffers,
    /// Time at which the start of the current run began.
    pub(super) began: Instant,
    /// Library of the instances, loaded by the first run.
    pub(super) library: Option<Arc<LoadedLibrary>>,
    /// Prevents `Sync`, because calls must come from one thread at a time.
    _not_sync: PhantomData<Cell<()>>,
}

impl Simulator {
    /// Creates a simulator. It does not load or run the model.
    ///
    /// # Errors
    /// Returns an error if the method options are invalid.
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

    /// Resets the instance after each run with the FMU's reset function, instead of creating a new one. Use
    /// this if creating an instance takes long and the model's reset restores the complete state. This
    /// function does not check the reset.
    #[must_use]
    pub fn resetting(mut self) -> Self {
        self.is_resetting = true;
        self
    }

    /// Leaves the instance at the end of each run, so that values can be read there. Without this setting, a
    /// worker process returns the instance to its start as part of the run.
    #[must_use]
    pub(crate) fn keeping_end(mut self) -> Self {
        self.keeps_end = true;
        self
    }

    /// Returns the plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Continues with another plan. A plan made from the current one by [`SimulationPlan::with_rows`] keeps
    /// the instance.
    ///
    /// # Errors
    /// Returns the errors of [`new`](Self::new).
    pub fn set_plan(&mut self, plan: Arc<SimulationPlan>) -> Result<(), FmiError> {
        if self.plan.fits(&plan) {
            self.use_plan(&plan);
        } else {
            *self = Self::new(plan)?;
        }
        Ok(())
    }

    /// Continues with another plan that fits.
    pub(super) fn use_plan(&mut self, plan: &Arc<SimulationPlan>) {
        self.plan = Arc::clone(plan);
        self.engine.running().set_plan(Arc::clone(plan));
    }

    /// Simulates once with these values of the plan's parameters, and passes the samples to `observer`.
    ///
    /// If another thread is running a simulation of the same [`Fmu`](crate::Fmu), this function waits for it
    /// to end. It polls `observer` meanwhile, and waits no longer than the time limit of the simulation.
    ///
    /// The run time in the report starts with the reset of the model. Loading and waiting do not count. The
    /// time inside the model covers calls of the FMU, without input functions
    /// ([`Inputs::function`](crate::Inputs::function)). Only some of the calls that take less than 1 us are
    /// timed.
    ///
    /// # Errors
    /// Returns an error in these cases:
    /// - A value is not finite, or the number of values differs from the number of parameters.
    /// - The FMU cannot be loaded or instantiated.
    /// - The FMU or the integration fails.
    ///
    /// The simulator can be used again after an error. A broken instance is replaced. After `Fatal`, a new
    /// copy of the library is loaded.
    pub fn run(&mut self, parameters: &[f64], observer: &mut dyn Observer) -> Result<Report, FmiError> {
        self.plan.values.check_parameters(parameters)?;
        self.run_checked(parameters, observer)
    }

    /// Simulates once and records all samples.
    ///
    /// # Errors
    /// Returns the errors of [`run`](Self::run).
    pub fn trajectory(&mut self, parameters: &[f64]) -> Result<Trajectory, FmiError> {
        self.trajectory_with(parameters, &mut || ControlFlow::Continue(()))
    }

    /// Simulates and records as [`trajectory`](Self::trajectory) does. Calls `poll` before every step;
    /// `Break` ends the simulation there.
    ///
    /// # Errors
    /// Returns the errors of [`run`](Self::run).
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

    /// Returns the value of a variable or an array element (`name[2,1]`) at the end of the last run. If the
    /// run was stopped inside a step, the value is from the end of the previous step.
    ///
    /// # Errors
    /// Returns an error if there is no such variable, no run has taken place, the run failed, or the FMU
    /// returns an error.
    pub fn value(&mut self, name: &str) -> Result<Value, FmiError> {
        let plan = Arc::clone(&self.plan);
        let description = plan.fmu().description();
        let place = VariableElement::of_name(description, plan.structure(), name)?;
        let value = self.engine.value(&description.variables[place.variable])?;
        Ok(element_value(value, place.element))
    }

    /// Returns a value as [`value`](Self::value) does, converted to a number. Integers and Booleans are also
    /// converted.
    ///
    /// # Errors
    /// Returns the errors of [`value`](Self::value). Also returns an error if the variable is not a single
    /// number.
    pub fn get(&mut self, name: &str) -> Result<f64, FmiError> {
        self.value(name)?.as_number().ok_or_else(|| FmiError::NotAnOutput {
            name: name.to_owned(),
            reason: "it is not a scalar number",
        })
    }

    /// Initializes the FMU without simulating. Afterwards [`value`](Self::value) returns initial values.
    pub(crate) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.plan.values.check_parameters(parameters)?;
        self.initialize_checked(parameters)
    }
}
