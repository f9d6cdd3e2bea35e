//! The functions of an FMI 2.0 library (FMI 2.0.x, sections 2.1, 3.2 and 4.2), bound by name.

use super::callbacks::{Environment, fmufit_allocate, fmufit_fmi2_log, fmufit_free};
use super::library::Symbols;
use super::packed;
use super::{
    Binding, Call, Component, Created, EventInfo, Experiment, InterfaceKind, Request, StatePointer, Status,
    StepInfo, file_uri, status,
};
use crate::description::VariableKind;
use crate::error::FmiError;
use std::ffi::{c_char, c_int, c_void};
use std::sync::Arc;

/// `fmi2Boolean`.
type Boolean = c_int;
/// `fmi2Type`.
const MODEL_EXCHANGE: c_int = 0;
const CO_SIMULATION: c_int = 1;
/// `fmi2StatusKind`.
const DO_STEP_STATUS: c_int = 0;
const LAST_SUCCESSFUL_TIME: c_int = 2;
const TERMINATED: c_int = 3;

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
type Plain = unsafe extern "C" fn(Component) -> c_int;
type SetupExperiment = unsafe extern "C" fn(Component, Boolean, f64, f64, Boolean, f64) -> c_int;
type SetDebugLogging = unsafe extern "C" fn(Component, Boolean, usize, *const *const c_char) -> c_int;
type Get<T> = unsafe extern "C" fn(Component, *const u32, usize, *mut T) -> c_int;
type Set<T> = unsafe extern "C" fn(Component, *const u32, usize, *const T) -> c_int;
type GetState = unsafe extern "C" fn(Component, *mut StatePointer) -> c_int;
type SetState = unsafe extern "C" fn(Component, StatePointer) -> c_int;
type StateSize = unsafe extern "C" fn(Component, StatePointer, *mut usize) -> c_int;
type SerializeState = unsafe extern "C" fn(Component, StatePointer, *mut c_char, usize) -> c_int;
type DeserializeState = unsafe extern "C" fn(Component, *const c_char, usize, *mut StatePointer) -> c_int;
type DirectionalDerivative =
    unsafe extern "C" fn(Component, *const u32, usize, *const u32, usize, *const f64, *mut f64) -> c_int;
type NewDiscreteStates = unsafe extern "C" fn(Component, *mut RawEventInfo) -> c_int;
type CompletedStep = unsafe extern "C" fn(Component, Boolean, *mut Boolean, *mut Boolean) -> c_int;
type SetTime = unsafe extern "C" fn(Component, f64) -> c_int;
type GetVector = unsafe extern "C" fn(Component, *mut f64, usize) -> c_int;
type SetVector = unsafe extern "C" fn(Component, *const f64, usize) -> c_int;
type DoStep = unsafe extern "C" fn(Component, f64, f64, Boolean) -> c_int;
type StepStatus<T> = unsafe extern "C" fn(Component, c_int, *mut T) -> c_int;
type SetInputDerivatives =
    unsafe extern "C" fn(Component, *const u32, usize, *const c_int, *const f64) -> c_int;

/// Calls an optional function, or says that it is missing.
macro_rules! optional {
    ($function:expr, $($argument:expr),*) => {
        match $function {
            // SAFETY: the caller's promises are those of the trait.
            Some(function) => status(unsafe { function($($argument),*) }),
            None => Status::Missing,
        }
    };
}

/// Calls a mandatory function.
macro_rules! call {
    ($function:expr, $($argument:expr),*) => {
        // SAFETY: the caller's promises are those of the trait.
        status(unsafe { ($function)($($argument),*) })
    };
}

/// Calls a function of an interface that the instance may not have.
macro_rules! of {
    ($interface:expr, $function:ident, $($argument:expr),*) => {
        match &$interface {
            Some(functions) => call!(functions.$function, $($argument),*),
            None => Status::Missing,
        }
    };
}

/// The function table. What is an `Option` may be missing: the standard makes it optional, or FMUs that leave it out
/// are known and can be used all the same.
pub(super) struct Fmi2 {
    instantiate: Instantiate,
    free_instance: unsafe extern "C" fn(Component),
    setup_experiment: SetupExperiment,
    enter_initialization_mode: Plain,
    exit_initialization_mode: Plain,
    terminate: Plain,
    get_real: Get<f64>,
    get_integer: Get<i32>,
    get_boolean: Get<Boolean>,
    set_real: Set<f64>,
    set_integer: Set<i32>,
    set_boolean: Set<Boolean>,
    model_exchange: Option<ModelExchange>,
    co_simulation: Option<CoSimulation>,

    set_debug_logging: Option<SetDebugLogging>,
    reset: Option<Plain>,
    get_string: Option<Get<*const c_char>>,
    set_string: Option<Set<*const c_char>>,
    get_fmu_state: Option<GetState>,
    set_fmu_state: Option<SetState>,
    free_fmu_state: Option<GetState>,
    serialized_size: Option<StateSize>,
    serialize: Option<SerializeState>,
    deserialize: Option<DeserializeState>,
    directional_derivative: Option<DirectionalDerivative>,
}

/// The functions of model exchange.
struct ModelExchange {
    enter_event_mode: Plain,
    new_discrete_states: NewDiscreteStates,
    enter_continuous_time_mode: Plain,
    completed_integrator_step: CompletedStep,
    set_time: SetTime,
    set_continuous_states: SetVector,
    get_continuous_states: GetVector,
    get_derivatives: GetVector,
    get_event_indicators: GetVector,
    get_nominals: GetVector,
}

/// The functions of co-simulation.
struct CoSimulation {
    do_step: DoStep,
    cancel_step: Option<Plain>,
    get_status: Option<StepStatus<c_int>>,
    get_real_status: Option<StepStatus<f64>>,
    get_boolean_status: Option<StepStatus<Boolean>>,
    set_input_derivatives: Option<SetInputDerivatives>,
}

impl Fmi2 {
    /// Looks the functions of one interface up.
    ///
    /// # Safety
    /// The library follows FMI 2.0: a symbol of a name has the type the standard gives it.
    pub(super) unsafe fn load(symbols: &Symbols<'_>, kind: InterfaceKind) -> Result<Self, FmiError> {
        // SAFETY: each name is paired with the signature of the standard's fmi2FunctionTypes; the caller vouches that
        // the library does the same. The pointers stay valid while the `Library` that owns this table is open.
        unsafe {
            let is_me = kind == InterfaceKind::ModelExchange;
            let model_exchange = if is_me { Some(ModelExchange::load(symbols)?) } else { None };
            let co_simulation = if is_me { None } else { Some(CoSimulation::load(symbols)?) };
            Ok(Self {
                model_exchange,
                co_simulation,
                instantiate: symbols.required("fmi2Instantiate")?,
                free_instance: symbols.required("fmi2FreeInstance")?,
                setup_experiment: symbols.required("fmi2SetupExperiment")?,
                enter_initialization_mode: symbols.required("fmi2EnterInitializationMode")?,
                exit_initialization_mode: symbols.required("fmi2ExitInitializationMode")?,
                terminate: symbols.required("fmi2Terminate")?,
                get_real: symbols.required("fmi2GetReal")?,
                get_integer: symbols.required("fmi2GetInteger")?,
                get_boolean: symbols.required("fmi2GetBoolean")?,
                set_real: symbols.required("fmi2SetReal")?,
                set_integer: symbols.required("fmi2SetInteger")?,
                set_boolean: symbols.required("fmi2SetBoolean")?,
                set_debug_logging: symbols.optional("fmi2SetDebugLogging"),
                reset: symbols.optional("fmi2Reset"),
                get_string: symbols.optional("fmi2GetString"),
                set_string: symbols.optional("fmi2SetString"),
                get_fmu_state: symbols.optional("fmi2GetFMUstate"),
                set_fmu_state: symbols.optional("fmi2SetFMUstate"),
                free_fmu_state: symbols.optional("fmi2FreeFMUstate"),
                serialized_size: symbols.optional("fmi2SerializedFMUstateSize"),
                serialize: symbols.optional("fmi2SerializeFMUstate"),
                deserialize: symbols.optional("fmi2DeSerializeFMUstate"),
                directional_derivative: symbols.optional("fmi2GetDirectionalDerivative"),
            })
        }
    }
}

impl ModelExchange {
    /// # Safety
    /// As for [`Fmi2::load`].
    unsafe fn load(symbols: &Symbols<'_>) -> Result<Self, FmiError> {
        // SAFETY: as in `Fmi2::load`.
        unsafe {
            Ok(Self {
                enter_event_mode: symbols.required("fmi2EnterEventMode")?,
                new_discrete_states: symbols.required("fmi2NewDiscreteStates")?,
                enter_continuous_time_mode: symbols.required("fmi2EnterContinuousTimeMode")?,
                completed_integrator_step: symbols.required("fmi2CompletedIntegratorStep")?,
                set_time: symbols.required("fmi2SetTime")?,
                set_continuous_states: symbols.required("fmi2SetContinuousStates")?,
                get_continuous_states: symbols.required("fmi2GetContinuousStates")?,
                get_derivatives: symbols.required("fmi2GetDerivatives")?,
                get_event_indicators: symbols.required("fmi2GetEventIndicators")?,
                get_nominals: symbols.required("fmi2GetNominalsOfContinuousStates")?,
            })
        }
    }
}

impl CoSimulation {
    /// # Safety
    /// As for [`Fmi2::load`].
    unsafe fn load(symbols: &Symbols<'_>) -> Result<Self, FmiError> {
        // SAFETY: as in `Fmi2::load`.
        unsafe {
            Ok(Self {
                do_step: symbols.required("fmi2DoStep")?,
                cancel_step: symbols.optional("fmi2CancelStep"),
                get_status: symbols.optional("fmi2GetStatus"),
                get_real_status: symbols.optional("fmi2GetRealStatus"),
                get_boolean_status: symbols.optional("fmi2GetBooleanStatus"),
                set_input_derivatives: symbols.optional("fmi2SetRealInputDerivatives"),
            })
        }
    }

    /// Asks what became of a step that was not completed.
    ///
    /// # Safety
    /// As for the methods of [`Binding`].
    unsafe fn explain(&self, component: Component, status: Status, info: &mut StepInfo) {
        info.pending = status == Status::Pending;
        if status != Status::Discard {
            return;
        }
        let (mut reached, mut terminated) = (f64::NAN, 0);
        // Both questions may be answered with an error; then nothing is known.
        let known = optional!(self.get_real_status, component, LAST_SUCCESSFUL_TIME, &raw mut reached);
        info.reached = (known == Status::Ok && reached.is_finite()).then_some(reached);
        let known = optional!(self.get_boolean_status, component, TERMINATED, &raw mut terminated);
        info.terminate = known == Status::Ok && terminated != 0;
        info.may_have_ended = known != Status::Ok && info.reached.is_some();
    }
}

impl Binding for Fmi2 {
    fn name(&self, call: Call) -> &'static str {
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
            // Of FMI 3.0.
            Call::EnterConfiguration | Call::ExitConfiguration => "(configuration mode)",
            Call::CountStates | Call::CountIndicators => "(number of states)",
            Call::EnterStepMode => "(step mode)",
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
        }
    }

    unsafe fn instantiate(&self, request: &Request<'_>, environment: &Environment) -> Option<Created> {
        let callbacks = Arc::new(CallbackFunctions {
            logger: fmufit_fmi2_log,
            allocate_memory: fmufit_allocate,
            free_memory: fmufit_free,
            step_finished: None,
            component_environment: std::ptr::from_ref(environment).cast_mut().cast(),
        });
        let resources = file_uri(request.resources);
        // SAFETY: the strings end in NUL; the callbacks are on the heap and kept with the component, the environment by the
        // caller.
        let component = unsafe {
            (self.instantiate)(
                request.name.as_ptr(),
                if request.kind == InterfaceKind::ModelExchange { MODEL_EXCHANGE } else { CO_SIMULATION },
                request.guid.as_ptr(),
                resources.as_ptr(),
                Arc::as_ptr(&callbacks),
                request.visible.into(),
                request.logging.into(),
            )
        };
        if component.is_null() { None } else { Some(Created { component, keep: callbacks }) }
    }

    unsafe fn free_instance(&self, component: Component) {
        // SAFETY: the caller's promises are those of the trait.
        unsafe { (self.free_instance)(component) }
    }

    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status {
        optional!(self.set_debug_logging, component, on.into(), 0, std::ptr::null())
    }

    unsafe fn setup_experiment(&self, component: Component, experiment: &Experiment) -> Status {
        let Experiment { tolerance, start, stop } = *experiment;
        call!(
            self.setup_experiment,
            component,
            tolerance.is_some().into(),
            tolerance.unwrap_or(0.0),
            start,
            stop.is_some().into(),
            stop.unwrap_or(0.0)
        )
    }

    unsafe fn enter_initialization(&self, component: Component, _: &Experiment) -> Status {
        call!(self.enter_initialization_mode, component)
    }

    unsafe fn exit_initialization(&self, component: Component) -> Status {
        call!(self.exit_initialization_mode, component)
    }

    unsafe fn terminate(&self, component: Component) -> Status {
        call!(self.terminate, component)
    }

    unsafe fn reset(&self, component: Component) -> Status {
        optional!(self.reset, component)
    }

    unsafe fn get_real(&self, component: Component, references: &[u32], values: &mut [f64]) -> Status {
        call!(self.get_real, component, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        let (list, n) = (references.as_ptr(), references.len());
        let function = match kind {
            VariableKind::Integer | VariableKind::Enumeration => self.get_integer,
            VariableKind::Boolean => self.get_boolean,
            _ => return Status::Missing,
        };
        // SAFETY: the caller's promises are those of the trait; there are as many lanes as references.
        let code = packed::get::<c_int>(lanes, |values| unsafe { function(component, list, n, values) });
        if kind == VariableKind::Boolean {
            packed::normalize(lanes);
        }
        status(code)
    }

    unsafe fn set_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        let (list, n) = (references.as_ptr(), references.len());
        let function = match kind {
            VariableKind::Integer | VariableKind::Enumeration => self.set_integer,
            VariableKind::Boolean => self.set_boolean,
            _ => return Status::Missing,
        };
        // SAFETY: as for getting.
        status(packed::set::<c_int>(lanes, |values| unsafe { function(component, list, n, values) }))
    }

    unsafe fn get_string(
        &self,
        component: Component,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Status {
        optional!(self.get_string, component, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Status {
        call!(self.set_real, component, references.as_ptr(), values.len(), values.as_ptr())
    }

    unsafe fn set_string(
        &self,
        component: Component,
        references: &[u32],
        values: &[*const c_char],
    ) -> Status {
        optional!(self.set_string, component, references.as_ptr(), values.len(), values.as_ptr())
    }

    unsafe fn save_state(&self, component: Component, state: &mut StatePointer) -> Status {
        optional!(self.get_fmu_state, component, state)
    }

    unsafe fn restore_state(&self, component: Component, state: StatePointer) -> Status {
        optional!(self.set_fmu_state, component, state)
    }

    unsafe fn free_state(&self, component: Component, state: &mut StatePointer) -> Status {
        optional!(self.free_fmu_state, component, state)
    }

    unsafe fn serialized_size(&self, component: Component, state: StatePointer, size: &mut usize) -> Status {
        optional!(self.serialized_size, component, state, size)
    }

    unsafe fn serialize(&self, component: Component, state: StatePointer, bytes: &mut [u8]) -> Status {
        optional!(self.serialize, component, state, bytes.as_mut_ptr().cast(), bytes.len())
    }

    unsafe fn deserialize(&self, component: Component, bytes: &[u8], state: &mut StatePointer) -> Status {
        optional!(self.deserialize, component, bytes.as_ptr().cast(), bytes.len(), state)
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
            self.directional_derivative,
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
        of!(self.model_exchange, enter_event_mode, component)
    }

    unsafe fn new_discrete_states(&self, component: Component, info: &mut EventInfo) -> Status {
        let mut raw = RawEventInfo::default();
        let status = of!(self.model_exchange, new_discrete_states, component, &raw mut raw);
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
        of!(self.model_exchange, enter_continuous_time_mode, component)
    }

    unsafe fn completed_integrator_step(
        &self,
        component: Component,
        no_set_state_prior: bool,
        event: &mut bool,
        terminate: &mut bool,
    ) -> Status {
        let (mut raw_event, mut raw_terminate): (Boolean, Boolean) = (0, 0);
        let status = of!(
            self.model_exchange,
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

    unsafe fn set_time(&self, component: Component, time: f64) -> Status {
        of!(self.model_exchange, set_time, component, time)
    }

    unsafe fn set_continuous_states(&self, component: Component, states: &[f64]) -> Status {
        of!(self.model_exchange, set_continuous_states, component, states.as_ptr(), states.len())
    }

    unsafe fn get_continuous_states(&self, component: Component, states: &mut [f64]) -> Status {
        of!(self.model_exchange, get_continuous_states, component, states.as_mut_ptr(), states.len())
    }

    unsafe fn get_derivatives(&self, component: Component, derivatives: &mut [f64]) -> Status {
        of!(self.model_exchange, get_derivatives, component, derivatives.as_mut_ptr(), derivatives.len())
    }

    unsafe fn get_event_indicators(&self, component: Component, indicators: &mut [f64]) -> Status {
        of!(self.model_exchange, get_event_indicators, component, indicators.as_mut_ptr(), indicators.len())
    }

    unsafe fn get_nominals(&self, component: Component, nominals: &mut [f64]) -> Status {
        of!(self.model_exchange, get_nominals, component, nominals.as_mut_ptr(), nominals.len())
    }

    unsafe fn do_step(&self, component: Component, time: f64, step: f64, info: &mut StepInfo) -> Status {
        let Some(functions) = &self.co_simulation else { return Status::Missing };
        // The master never goes back behind a communication point.
        let status = call!(functions.do_step, component, time, step, 1);
        // SAFETY: as for this call.
        unsafe { functions.explain(component, status, info) };
        status
    }

    unsafe fn step_status(&self, component: Component, info: &mut StepInfo) -> Status {
        let Some(functions) = &self.co_simulation else { return Status::Missing };
        let mut code = 0;
        let asked = optional!(functions.get_status, component, DO_STEP_STATUS, &raw mut code);
        let status = if asked == Status::Ok { status(code) } else { asked };
        // SAFETY: as for this call.
        unsafe { functions.explain(component, status, info) };
        status
    }

    unsafe fn cancel_step(&self, component: Component) -> Status {
        let Some(functions) = &self.co_simulation else { return Status::Missing };
        optional!(functions.cancel_step, component)
    }

    unsafe fn set_input_derivatives(
        &self,
        component: Component,
        references: &[u32],
        orders: &[c_int],
        values: &[f64],
    ) -> Status {
        let Some(functions) = &self.co_simulation else { return Status::Missing };
        optional!(
            functions.set_input_derivatives,
            component,
            references.as_ptr(),
            references.len(),
            orders.as_ptr(),
            values.as_ptr()
        )
    }
}
