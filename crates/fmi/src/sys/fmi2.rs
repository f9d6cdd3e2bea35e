//! The functions of an FMI 2.0 library (FMI 2.0.x, sections 2.1, 3.2 and 4.2), bound by name.

use super::binding::Binding;
use super::call::{Call, Values};
use super::callbacks::{Callbacks, fmufit_allocate, fmufit_fmi2_log, fmufit_free};
use super::functions::{
    Interface, LifeFunctions, Plain, PointFunctions, StateFunctions, StepFunctions, Table, ValueFunctions,
    call, model, optional, table,
};
use super::symbols::Symbols;
use super::types::{Component, EventInfo, Experiment, InterfaceKind, Request, StepInfo, file_uri, status};
use crate::description::VariableKind;
use crate::error::{FmiError, Status};
use std::ffi::{c_char, c_int, c_void};

/// `fmi2Boolean`.
type Boolean = c_int;
/// `fmi2Type`.
const MODEL_EXCHANGE: c_int = 0;
const CO_SIMULATION: c_int = 1;

type Logger = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);
type StepFinished = unsafe extern "C" fn(*mut c_void, c_int);

/// `fmi2CallbackFunctions`.
#[repr(C)]
struct CallbackFunctions {
    logger: Logger,
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
    /// Only for asynchronous co-simulation.
    step_finished: Option<StepFinished>,
    component_environment: *mut c_void,
}

// SAFETY: never written after it was made, and what its environment leads to is a mutex (see `Environment`).
unsafe impl Send for CallbackFunctions {}
// SAFETY: as for `Send`.
unsafe impl Sync for CallbackFunctions {}

/// `fmi2EventInfo`.
#[repr(C)]
#[derive(Default)]
struct RawEventInfo {
    new_discrete_states_needed: Boolean,
    terminate_simulation: Boolean,
    nominals_of_continuous_states_changed: Boolean,
    values_of_continuous_states_changed: Boolean,
    next_event_time_defined: Boolean,
    next_event_time: f64,
}

type Instantiate = unsafe extern "C" fn(
    *const c_char,
    c_int,
    *const c_char,
    *const c_char,
    *const CallbackFunctions,
    Boolean,
    Boolean,
) -> Component;
type SetupExperiment = unsafe extern "C" fn(Component, Boolean, f64, f64, Boolean, f64) -> c_int;
type SetDebugLogging = unsafe extern "C" fn(Component, Boolean, usize, *const *const c_char) -> c_int;
type DirectionalDerivative =
    unsafe extern "C" fn(Component, *const u32, usize, *const u32, usize, *const f64, *mut f64) -> c_int;
type NewDiscreteStates = unsafe extern "C" fn(Component, *mut RawEventInfo) -> c_int;
type CompletedStep = unsafe extern "C" fn(Component, Boolean, *mut Boolean, *mut Boolean) -> c_int;
type DoStep = unsafe extern "C" fn(Component, f64, f64, Boolean) -> c_int;

/// The functions of one library.
pub(super) struct Fmi2 {
    common: Common,
    life: LifeFunctions,
    values: ValueFunctions<Boolean>,
    states: StateFunctions,
    interface: Interface<ModelExchange, CoSimulation>,
}

table! {
    /// What both interfaces have. What may be missing is optional in the standard, or FMUs that leave it out are known
    /// and can be used all the same.
    struct Common {
        required {
            instantiate: Instantiate = Call::Instantiate;
            setup_experiment: SetupExperiment = Call::SetupExperiment;
            enter_initialization_mode: Plain = Call::EnterInitialization;
            exit_initialization_mode: Plain = Call::ExitInitialization;
        }
        optional {
            set_debug_logging: SetDebugLogging = Call::SetDebugLogging;
            directional_derivative: DirectionalDerivative = Call::DirectionalDerivative;
        }
    }
}

table! {
    /// Model exchange.
    struct ModelExchange {
        required {
            enter_event_mode: Plain = Call::EnterEventMode;
            new_discrete_states: NewDiscreteStates = Call::NewDiscreteStates;
            enter_continuous_time_mode: Plain = Call::EnterContinuousTimeMode;
            completed_integrator_step: CompletedStep = Call::CompletedIntegratorStep;
        }
        optional {}
    }
}

table! {
    /// Co-simulation.
    struct CoSimulation {
        required {
            do_step: DoStep = Call::DoStep;
        }
        optional {}
    }
}

impl Fmi2 {
    /// Looks the functions of one interface up.
    ///
    /// # Safety
    /// The library follows FMI 2.0: a symbol of a name has the type the standard gives it.
    pub(super) unsafe fn load(symbols: &Symbols<'_>, kind: InterfaceKind) -> Result<Self, FmiError> {
        // SAFETY: the caller vouches for the library, and the names are those of FMI 2.0.
        unsafe {
            Ok(Self {
                interface: Interface::load(symbols, kind, name)?,
                common: Common::load(symbols, name)?,
                life: LifeFunctions::load(symbols, name)?,
                values: ValueFunctions::load(symbols, name)?,
                states: StateFunctions::load(symbols, name)?,
            })
        }
    }
}

/// The standard's names.
pub(super) fn name(call: Call) -> &'static str {
    match call {
        Call::Instantiate => "fmi2Instantiate",
        Call::SetDebugLogging => "fmi2SetDebugLogging",
        Call::SetupExperiment => "fmi2SetupExperiment",
        Call::EnterInitialization => "fmi2EnterInitializationMode",
        Call::ExitInitialization => "fmi2ExitInitializationMode",
        Call::Terminate => "fmi2Terminate",
        Call::Reset => "fmi2Reset",
        Call::Get(VariableKind::Real) => "fmi2GetReal",
        Call::Get(VariableKind::Boolean) => "fmi2GetBoolean",
        Call::Get(VariableKind::String) => "fmi2GetString",
        Call::Get(_) => "fmi2GetInteger",
        Call::Set(VariableKind::Real) => "fmi2SetReal",
        Call::Set(VariableKind::Boolean) => "fmi2SetBoolean",
        Call::Set(VariableKind::String) => "fmi2SetString",
        Call::Set(_) => "fmi2SetInteger",
        Call::GetOutputDerivatives => "fmi2GetRealOutputDerivatives",
        Call::SaveState => "fmi2GetFMUstate",
        Call::RestoreState => "fmi2SetFMUstate",
        Call::SerializedSize => "fmi2SerializedFMUstateSize",
        Call::Serialize => "fmi2SerializeFMUstate",
        Call::Deserialize => "fmi2DeSerializeFMUstate",
        Call::DirectionalDerivative => "fmi2GetDirectionalDerivative",
        Call::EnterEventMode => "fmi2EnterEventMode",
        Call::NewDiscreteStates => "fmi2NewDiscreteStates",
        Call::EnterContinuousTimeMode => "fmi2EnterContinuousTimeMode",
        Call::CompletedIntegratorStep => "fmi2CompletedIntegratorStep",
        Call::SetTime => "fmi2SetTime",
        Call::SetContinuousStates => "fmi2SetContinuousStates",
        Call::GetContinuousStates => "fmi2GetContinuousStates",
        Call::GetDerivatives => "fmi2GetDerivatives",
        Call::GetEventIndicators => "fmi2GetEventIndicators",
        Call::GetNominals => "fmi2GetNominalsOfContinuousStates",
        Call::DoStep => "fmi2DoStep",
        Call::StepStatus => "fmi2GetStatus",
        Call::CancelStep => "fmi2CancelStep",
        Call::SetInputDerivatives => "fmi2SetRealInputDerivatives",
        Call::FreeInstance => "fmi2FreeInstance",
        Call::FreeState => "fmi2FreeFMUstate",
        Call::StepRealStatus => "fmi2GetRealStatus",
        Call::StepBooleanStatus => "fmi2GetBooleanStatus",
        other => other.in_brackets(),
    }
}

impl Binding for Fmi2 {
    fn name(&self, call: Call) -> &'static str {
        name(call)
    }

    fn life(&self) -> &LifeFunctions {
        &self.life
    }

    fn values(&self) -> &dyn Values {
        &self.values
    }

    fn point(&self) -> Option<&PointFunctions> {
        self.interface.point()
    }

    fn states(&self) -> Option<&StateFunctions> {
        Some(&self.states)
    }

    fn steps(&self) -> Option<&StepFunctions> {
        self.interface.steps()
    }

    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> Component {
        let functions = callbacks.keep(|environment| CallbackFunctions {
            logger: fmufit_fmi2_log,
            allocate_memory: fmufit_allocate,
            free_memory: fmufit_free,
            step_finished: None,
            component_environment: std::ptr::from_ref(environment).cast_mut().cast(),
        });
        let resources = file_uri(request.resources);
        // SAFETY: the strings end in NUL; the callbacks are on the heap and never freed.
        unsafe {
            (self.common.instantiate)(
                request.name.as_ptr(),
                if request.kind == InterfaceKind::ModelExchange { MODEL_EXCHANGE } else { CO_SIMULATION },
                request.guid.as_ptr(),
                resources.as_ptr(),
                functions,
                request.visible.into(),
                request.logging.into(),
            )
        }
    }

    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status {
        optional!(self.common.set_debug_logging, component, on.into(), 0, std::ptr::null())
    }

    unsafe fn setup_experiment(&self, component: Component, experiment: &Experiment) -> Status {
        let Experiment { tolerance, start, stop } = *experiment;
        call!(
            self.common.setup_experiment,
            component,
            tolerance.is_some().into(),
            tolerance.unwrap_or(0.0),
            start,
            stop.is_some().into(),
            stop.unwrap_or(0.0)
        )
    }

    unsafe fn enter_initialization(&self, component: Component, _: &Experiment) -> Status {
        call!(self.common.enter_initialization_mode, component)
    }

    unsafe fn exit_initialization(&self, component: Component) -> Status {
        call!(self.common.exit_initialization_mode, component)
    }

    unsafe fn directional_derivative(
        &self,
        component: Component,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Status {
        optional!(
            self.common.directional_derivative,
            component,
            unknowns.as_ptr(),
            unknowns.len(),
            knowns.as_ptr(),
            knowns.len(),
            seed.as_ptr(),
            sensitivity.as_mut_ptr()
        )
    }

    unsafe fn enter_event_mode(&self, component: Component) -> Status {
        model!(self, enter_event_mode, component)
    }

    unsafe fn new_discrete_states(&self, component: Component, info: &mut EventInfo) -> Status {
        let mut raw = RawEventInfo::default();
        let status = model!(self, new_discrete_states, component, &raw mut raw);
        *info = EventInfo {
            new_discrete_states_needed: raw.new_discrete_states_needed != 0,
            terminate: raw.terminate_simulation != 0,
            nominals_changed: raw.nominals_of_continuous_states_changed != 0,
            values_changed: raw.values_of_continuous_states_changed != 0,
            next_event_time: (raw.next_event_time_defined != 0).then_some(raw.next_event_time),
        };
        status
    }

    unsafe fn enter_continuous_time_mode(&self, component: Component) -> Status {
        model!(self, enter_continuous_time_mode, component)
    }

    unsafe fn completed_integrator_step(
        &self,
        component: Component,
        no_set_state_prior: bool,
        event: &mut bool,
        terminate: &mut bool,
    ) -> Status {
        let (mut raw_event, mut raw_terminate): (Boolean, Boolean) = (0, 0);
        let status = model!(
            self,
            completed_integrator_step,
            component,
            no_set_state_prior.into(),
            &raw mut raw_event,
            &raw mut raw_terminate
        );
        *event = raw_event != 0;
        *terminate = raw_terminate != 0;
        status
    }

    unsafe fn do_step(
        &self,
        component: Component,
        (time, step): (f64, f64),
        no_set_state_prior: bool,
        info: &mut StepInfo,
    ) -> Status {
        let Interface::CoSimulation(functions, steps) = &self.interface else { return Status::Missing };
        let status = call!(functions.do_step, component, time, step, no_set_state_prior.into());
        // SAFETY: as for this call.
        unsafe { steps.explain(component, status, info) };
        status
    }
}
