//! State of a run, for both interfaces: the instance with its current mode, the buffers and the
//! initialization.

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

/// Mode of the instance of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Mode {
    /// Model exchange: initialized, or terminated by the model.
    #[default]
    Event,
    /// Model exchange, between two events.
    Continuous,
    /// Co-simulation, between two steps.
    Step,
}

/// Instance of a run, with a flag that marks it as unusable.
#[derive(Debug, Default)]
pub(crate) struct Current {
    /// `None` if no instance was created yet or the instance failed.
    pub(crate) core: Option<Box<Core>>,
    pub(crate) mode: Mode,
    /// True after an FMU call failed. The instance is then not used again.
    pub(crate) broken: bool,
    /// Last call that returned `Discard`.
    pub(crate) discarded: Option<&'static str>,
}

impl Current {
    /// Returns the running instance.
    ///
    /// # Errors
    /// Returns an error if there is no running instance.
    #[inline]
    pub(crate) fn core(&mut self) -> Result<&mut Core> {
        self.core.as_deref_mut().ok_or_else(no_instance)
    }

    /// Returns the running instance for reading values.
    ///
    /// # Errors
    /// Returns an error if there is no instance, or it failed.
    pub(crate) fn trusted(&mut self) -> Result<&mut Core> {
        if self.broken {
            return Err(no_instance());
        }
        self.core()
    }

    /// Returns the instance if it is in event mode (model exchange).
    ///
    /// # Errors
    /// Returns an error if the instance is not in event mode.
    pub(crate) fn in_event_mode(&mut self) -> Result<&mut Core> {
        if self.mode == Mode::Event { self.core() } else { Err(no_instance()) }
    }

    /// Makes a raw call. `Discard` has no consequences for the instance; after any other failure it is not
    /// used again.
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

    /// Returns the error of a failed call.
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

    /// Makes the call that enters another mode, unless the instance is already in that mode.
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

    /// Returns the call that rejected the last point, with its time and the FMU's log lines about it.
    pub(crate) fn refusal(&mut self) -> Option<String> {
        let call = self.discarded?;
        self.core().ok().map(|core| core.error(Fault::Discard(call)).to_string())
    }

    /// Terminates the instance and returns it, if there is one that can be used for another run.
    pub(crate) fn retire(self) -> Option<RawInstance> {
        let mut core = self.core.filter(|_| !self.broken)?;
        // Some FMUs free the memory of a run only when `terminate` is called.
        core.call(RawInstance::terminate).ok().map(|()| core.raw)
    }

    /// Marks the instance as unusable after a failed call or an interrupted event iteration.
    pub(crate) fn fail(&mut self, error: FmiError) -> CallError {
        self.broken = true;
        match error {
            FmiError::Stopped(stopped) => CallError::failed(stopped),
            error => CallError::failed(error),
        }
    }
}

/// State of a run. It is kept for the next run.
#[derive(Debug)]
pub(crate) struct Running {
    pub(crate) plan: Arc<SimulationPlan>,
    pub(crate) current: Current,
    pub(crate) inputs: InputState,
    /// Outputs as last read.
    pub(crate) buffers: OutputBuffers,
    pub(crate) clocks: ClockState,
    /// Buffer for parameter values with their signs applied.
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

    /// Continues with another plan that fits.
    pub(crate) fn set_plan(&mut self, plan: Arc<SimulationPlan>) {
        self.inputs = InputState::new(&plan.inputs);
        self.plan = plan;
    }

    /// Terminates the instance, removes it from this state, and returns it if it can be used for another run.
    pub(crate) fn retire(&mut self) -> Option<RawInstance> {
        std::mem::take(&mut self.current).retire()
    }

    /// Reads the outputs at the current point of the model.
    pub(crate) fn read_outputs(&mut self) -> CallResult<()> {
        let Self { plan, current, buffers, .. } = self;
        current.call(|raw| buffers.read(plan.outputs(), raw))
    }

    /// Forwards the FMU's log lines of a run to the program's logger.
    pub(crate) fn pass_log_on(&self) {
        if let Some(core) = &self.current.core {
            core.pass_log_on();
        }
    }

    /// Returns the seconds since the start spent in the user's input functions.
    pub(crate) fn seconds_in_input_functions(&self) -> f64 {
        self.inputs.seconds_in_functions()
    }

    /// Returns the ticks of all clocks in the last run.
    pub(crate) fn take_ticks(&mut self) -> Vec<Tick> {
        std::mem::take(&mut self.clocks.ticks)
    }
}

#[cold]
pub(crate) fn no_instance() -> FmiError {
    FmiError::BadSetting("no instance is running".to_owned())
}

impl Running {
    /// Initializes a new instance at the start time. Sets all values that can be set before and in
    /// initialization mode. The values are the plan's, or values in `input` for the same variables. `stop` is
    /// passed to the FMU as the stop time, which no step exceeds.
    ///
    /// # Errors
    /// Returns an error if the FMU returns an error, or an input function is not finite at the start time.
    /// There is no instance afterwards.
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
        // This call comes first because some models create their data in it.
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
            // Co-simulations made by Dymola extrapolate an input that changes in initialization mode, in the
            // wrong direction. Setting the inputs earlier avoids the change.
            is_refused = set_inputs(&mut core, signed).is_err();
        }
        if is_refused && core.call(RawInstance::reset).is_ok() {
            // Some models accept input values only in initialization mode, as FMI 2.0 specifies for inputs
            // without `initial`.
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

/// Returns an error if the plan has clocks and the instance has no event mode, because clocks tick in event
/// mode.
fn check_clocks(plan: &SimulationPlan, core: &mut Core) -> Result<()> {
    if plan.kind == InterfaceKind::ModelExchange || core.raw.has_event_mode() || plan.clocks.is_empty() {
        return Ok(());
    }
    let problem = "the clocks of the model tick in event mode, which its description declares, but the model \
                   cannot be instantiated with event mode";
    Err(FmiError::BadSetting(problem.to_owned()))
}
