//! State of a run, for both interfaces: an instance, in its current mode, the buffers written during the run,
//! and its start.

use crate::error::{FmiError, Result};
use crate::instance::Core;
use crate::simulation::clocks::{ClockState, Tick};
use crate::simulation::inputs::InputState;
use crate::simulation::outputs::OutputBuffers;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::variable_elements::RunInput;
use crate::sys::{Experiment, Fault, InterfaceKind, RawInstance};
use ode::{CallError, CallResult};
use std::sync::Arc;

/// Where the instance of a run is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Mode {
    /// Model exchange: initialized, or ended by the model.
    #[default]
    Event,
    /// Model exchange, between two events.
    Continuous,
    /// Co-simulation, between two steps.
    Step,
}

/// The instance of a run, and whether it can still be used.
#[derive(Debug, Default)]
pub(crate) struct Current {
    /// `None`: none was made yet, or it broke.
    pub(crate) core: Option<Box<Core>>,
    pub(crate) mode: Mode,
    /// An FMU call failed: the instance is not used again.
    pub(crate) broken: bool,
    /// The call that returned `Discard` last.
    pub(crate) discarded: Option<&'static str>,
}

impl Current {
    /// The running instance.
    ///
    /// # Errors
    /// There is none.
    #[inline]
    pub(crate) fn core(&mut self) -> Result<&mut Core> {
        self.core.as_deref_mut().ok_or_else(no_instance)
    }

    /// The running instance, to be asked for its values.
    ///
    /// # Errors
    /// There is none, or it broke.
    pub(crate) fn trusted(&mut self) -> Result<&mut Core> {
        if self.broken {
            return Err(no_instance());
        }
        self.core()
    }

    /// The instance, if it is in event mode (model exchange).
    ///
    /// # Errors
    /// It is not.
    pub(crate) fn in_event_mode(&mut self) -> Result<&mut Core> {
        if self.mode == Mode::Event { self.core() } else { Err(no_instance()) }
    }

    /// Makes a raw call; `Discard` costs nothing, everything worse ends the use of the instance.
    #[inline]
    pub(crate) fn call<T>(
        &mut self,
        body: impl FnOnce(&mut RawInstance) -> Result<T, Fault>,
    ) -> CallResult<T> {
        let Some(core) = &mut self.core else { return Err(CallError::failed(no_instance())) };
        match body(&mut core.raw) {
            Ok(value) => Ok(value),
            Err(fault) => Err(self.faulty(fault)),
        }
    }

    /// The error of a call that went wrong.
    #[cold]
    fn faulty(&mut self, fault: Fault) -> CallError {
        let error = match (fault, self.core()) {
            (Fault::Discard(call), _) => {
                self.discarded = Some(call);
                return CallError::Discard;
            }
            (fault, Ok(core)) => core.error(fault),
            (_, Err(error)) => error,
        };
        self.fail(error)
    }

    /// Makes the call that leads to another mode, unless the instance is in it.
    pub(crate) fn enter(
        &mut self,
        mode: Mode,
        call: impl FnOnce(&mut RawInstance) -> Result<(), Fault>,
    ) -> CallResult<()> {
        if self.mode != mode {
            let entered = self.core().and_then(|core| core.call(call));
            entered.map_err(|error| self.fail(error))?;
            self.mode = mode;
        }
        Ok(())
    }

    /// The call that has refused the last point, with its time and what the FMU logged about it.
    pub(crate) fn refusal(&mut self) -> Option<String> {
        let call = self.discarded?;
        self.core().ok().map(|core| core.error(Fault::Discard(call)).to_string())
    }

    /// Ends the run of the instance, if there is one that can be used for another run.
    pub(crate) fn retire(self) -> Option<RawInstance> {
        let mut core = self.core.filter(|_| !self.broken)?;
        // Some FMUs free what a run has allocated only when they are told that it is over.
        core.call(RawInstance::terminate).ok().map(|()| core.raw)
    }

    /// Notes that the instance is not to be used again: a call failed, or an event iteration was ended from
    /// outside.
    pub(crate) fn fail(&mut self, error: FmiError) -> CallError {
        self.broken = true;
        match error {
            FmiError::Stopped(stopped) => CallError::failed(stopped),
            error => CallError::failed(error),
        }
    }
}

/// State of a run, kept for the next one.
#[derive(Debug)]
pub(crate) struct Running {
    pub(crate) plan: Arc<SimulationPlan>,
    pub(crate) current: Current,
    pub(crate) inputs: InputState,
    /// The outputs as they were read last.
    pub(crate) buffers: OutputBuffers,
    pub(crate) clocks: ClockState,
    /// Values of parameters on their way.
    pub(super) signed: Vec<f64>,
}

impl Running {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        Self {
            current: Current::default(),
            inputs: InputState::new(&plan.inputs),
            buffers: OutputBuffers::new(plan.outputs()),
            clocks: ClockState::default(),
            signed: Vec::new(),
            plan,
        }
    }

    /// Goes on with a plan that fits.
    pub(crate) fn set_plan(&mut self, plan: Arc<SimulationPlan>) {
        self.inputs = InputState::new(&plan.inputs);
        self.plan = plan;
    }

    /// Ends the run of the instance, if there is one that can be used for another run, and gives it up.
    pub(crate) fn retire(&mut self) -> Option<RawInstance> {
        std::mem::take(&mut self.current).retire()
    }

    /// Reads the outputs where the model stands.
    pub(crate) fn read_outputs(&mut self) -> CallResult<()> {
        let Self { plan, current, buffers, .. } = self;
        current.call(|raw| buffers.read(plan.outputs(), raw))
    }

    /// Hands what the FMU has logged in a run to the program's logger.
    pub(crate) fn pass_log_on(&self) {
        if let Some(core) = &self.current.core {
            core.pass_log_on();
        }
    }

    /// Seconds since the start in input functions of the user.
    pub(crate) fn seconds_in_input_functions(&self) -> f64 {
        self.inputs.seconds_in_functions()
    }

    /// The ticks of all clocks in the last run.
    pub(crate) fn take_ticks(&mut self) -> Vec<Tick> {
        std::mem::take(&mut self.clocks.ticks)
    }
}

#[cold]
pub(crate) fn no_instance() -> FmiError {
    FmiError::BadSetting("there is no running instance".to_owned())
}

impl Running {
    /// Initializes a fresh instance at the start time, with all that can be set before and in initialization
    /// mode: the values of the plan or others for the same variables. `stop`: the FMU is told that no step
    /// leads beyond it.
    ///
    /// # Errors
    /// The FMU refuses; an input function is not finite at the start time. There is no instance then.
    pub(super) fn begin(
        &mut self,
        raw: RawInstance,
        input: RunInput<'_>,
        stop: Option<f64>,
    ) -> Result<Box<Core>> {
        self.current = Current::default();
        self.buffers.begin();
        let Self { plan, inputs, clocks, signed, .. } = self;
        let mut core = Box::new(Core::new(raw, plan.fmu().clone()));
        let experiment = Experiment { tolerance: plan.tolerance, start: plan.start, stop };
        // First, because some models make their data in this call.
        core.call(|raw| raw.setup_experiment(&experiment))?;
        inputs.begin(&plan.inputs, plan.start);
        if !inputs.continuous_at(&plan.inputs, plan.start) {
            return Err(inputs.bad_function_value(plan.start));
        }
        let set_up = |core: &mut Core, signed: &mut Vec<f64>| {
            plan.values.set_up(core, input, signed)?;
            inputs.set_parameters(core, &plan.inputs)
        };
        set_up(&mut core, signed)?;
        let mut is_refused = false;
        let set_inputs = |core: &mut Core, signed: &mut Vec<f64>| {
            plan.values.set_up_inputs(core, input, signed)?;
            inputs.set_held(core, &plan.inputs)?;
            plan.inputs.continuous.set(core, &inputs.continuous)
        };
        if plan.communication.as_ref().is_some_and(|communication| communication.extrapolates) {
            // Co-simulations of Dymola extrapolate an input that changes in initialization mode, against the direction of the
            // change.
            is_refused = set_inputs(&mut core, signed).is_err();
        }
        if is_refused && core.call(RawInstance::reset).is_ok() {
            // Models that take values of inputs in initialization mode only, as FMI 2.0 has it for those without `initial`.
            core.call(|raw| raw.setup_experiment(&experiment))?;
            set_up(&mut core, signed)?;
        }
        core.check_sizes()?;
        core.call(RawInstance::enter_initialization)?;
        set_inputs(&mut core, signed)?;
        check_clocks(plan, &mut core)?;
        clocks.begin(&plan.clocks, &mut core, plan.start)?;
        core.call(RawInstance::exit_initialization)?;
        Ok(core)
    }
}

/// Clocks tick in event mode: refuses a run with clocks on an instance that would not be made with one.
fn check_clocks(plan: &SimulationPlan, core: &mut Core) -> Result<()> {
    if plan.kind == InterfaceKind::ModelExchange || core.raw.has_event_mode() || plan.clocks.is_empty() {
        return Ok(());
    }
    let problem = "the model has clocks, which tick in event mode; its description promises that mode, and the model \
                   refuses to be instantiated with it";
    Err(FmiError::BadSetting(problem.to_owned()))
}
