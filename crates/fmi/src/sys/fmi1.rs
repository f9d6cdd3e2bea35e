//! The functions of an FMI 1.0 library (Model Exchange 1.0, chapter 2; Co-Simulation 1.0, chapter 3), bound by name.
//!
//! FMI 1.0 has no initialization mode, no event mode and no environment for callbacks; a component here is therefore a
//! box around the FMU's, with what has to be remembered between calls. Names carry the model identifier as prefix.

use super::callbacks::{Current, Environment, fmufit_allocate, fmufit_fmi1_log, fmufit_free};
use super::library::Symbols;
use super::packed;
use super::{
    Binding, Call, Component, Created, EventInfo, Experiment, InterfaceKind, Request, Status, StepInfo,
    file_uri, status,
};
use crate::description::VariableKind;
use crate::error::FmiError;
use std::ffi::{c_char, c_int, c_uint, c_void};
use std::sync::Arc;

/// `fmiBoolean`.
type Boolean = c_char;
/// `fmiComponent`.
type Slave = *mut c_void;
/// `fmiLastSuccessfulTime` of `fmiStatusKind`.
const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmiDoStepStatus` of `fmiStatusKind`.
const DO_STEP_STATUS: c_int = 0;

type Logger = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);
type StepFinished = unsafe extern "C" fn(*mut c_void, c_int);

/// `fmiCallbackFunctions` of model exchange, passed by value.
#[repr(C)]
#[derive(Clone, Copy)]
struct ModelCallbacks {
    logger: Logger,
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
}

/// `fmiCallbackFunctions` of co-simulation, passed by value.
#[repr(C)]
#[derive(Clone, Copy)]
struct SlaveCallbacks {
    common: ModelCallbacks,
    /// Only for asynchronous steps.
    step_finished: Option<StepFinished>,
}

const CALLBACKS: ModelCallbacks =
    ModelCallbacks { logger: fmufit_fmi1_log, allocate_memory: fmufit_allocate, free_memory: fmufit_free };

/// `fmiEventInfo`.
#[repr(C)]
#[derive(Default)]
struct RawEventInfo {
    iteration_converged: Boolean,
    state_value_references_changed: Boolean,
    state_values_changed: Boolean,
    terminate_simulation: Boolean,
    upcoming_time_event: Boolean,
    next_event_time: f64,
}

impl RawEventInfo {
    fn in_house_words(&self) -> EventInfo {
        EventInfo {
            new_discrete_states_needed: self.iteration_converged == 0,
            terminate: self.terminate_simulation != 0,
            // Other states have other nominals.
            nominals_changed: self.state_value_references_changed != 0,
            values_changed: self.state_values_changed != 0 || self.state_value_references_changed != 0,
            next_event_time: (self.upcoming_time_event != 0).then_some(self.next_event_time),
        }
    }
}

type InstantiateModel = unsafe extern "C" fn(*const c_char, *const c_char, ModelCallbacks, Boolean) -> Slave;
type InstantiateSlave = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    *const c_char,
    f64,
    Boolean,
    Boolean,
    SlaveCallbacks,
    Boolean,
) -> Slave;
type Plain = unsafe extern "C" fn(Slave) -> c_int;
type Free = unsafe extern "C" fn(Slave);
type SetDebugLogging = unsafe extern "C" fn(Slave, Boolean) -> c_int;
type Get<T> = unsafe extern "C" fn(Slave, *const c_uint, usize, *mut T) -> c_int;
type Set<T> = unsafe extern "C" fn(Slave, *const c_uint, usize, *const T) -> c_int;
type SetTime = unsafe extern "C" fn(Slave, f64) -> c_int;
type GetVector = unsafe extern "C" fn(Slave, *mut f64, usize) -> c_int;
type SetVector = unsafe extern "C" fn(Slave, *const f64, usize) -> c_int;
type CompletedStep = unsafe extern "C" fn(Slave, *mut Boolean) -> c_int;
type Initialize = unsafe extern "C" fn(Slave, Boolean, f64, *mut RawEventInfo) -> c_int;
type EventUpdate = unsafe extern "C" fn(Slave, Boolean, *mut RawEventInfo) -> c_int;
type InitializeSlave = unsafe extern "C" fn(Slave, f64, Boolean, f64) -> c_int;
type DoStep = unsafe extern "C" fn(Slave, f64, f64, Boolean) -> c_int;
type StepStatus<T> = unsafe extern "C" fn(Slave, c_int, *mut T) -> c_int;
type SetInputDerivatives =
    unsafe extern "C" fn(Slave, *const c_uint, usize, *const c_int, *const f64) -> c_int;

/// The function table.
pub(super) struct Fmi1 {
    get_real: Get<f64>,
    get_integer: Option<Get<c_int>>,
    get_boolean: Option<Get<Boolean>>,
    get_string: Option<Get<*const c_char>>,
    set_real: Set<f64>,
    set_integer: Option<Set<c_int>>,
    set_boolean: Option<Set<Boolean>>,
    set_string: Option<Set<*const c_char>>,
    set_debug_logging: Option<SetDebugLogging>,
    interface: Interface,
}

enum Interface {
    ModelExchange(ModelExchange),
    CoSimulation(CoSimulation),
}

struct ModelExchange {
    instantiate: InstantiateModel,
    free: Free,
    set_time: SetTime,
    initialize: Initialize,
    terminate: Plain,
    set_continuous_states: SetVector,
    completed_integrator_step: CompletedStep,
    get_derivatives: GetVector,
    get_event_indicators: GetVector,
    event_update: EventUpdate,
    get_continuous_states: GetVector,
    get_nominals: GetVector,
}

struct CoSimulation {
    instantiate: InstantiateSlave,
    free: Free,
    initialize: InitializeSlave,
    terminate: Plain,
    do_step: DoStep,
    reset: Option<Plain>,
    cancel_step: Option<Plain>,
    get_status: Option<StepStatus<c_int>>,
    get_real_status: Option<StepStatus<f64>>,
    set_input_derivatives: Option<SetInputDerivatives>,
}

/// What a component is here.
struct Boxed {
    slave: Slave,
    environment: *const Environment,
    experiment: Experiment,
    /// What the initialization said about events; told at the first event iteration.
    announced: Option<EventInfo>,
    /// The step under way is a new one, not one tried again.
    made_progress: bool,
}

/// Looks functions up by the prefixed name, or by the plain one, which some tools export.
struct Prefixed<'a> {
    symbols: &'a Symbols<'a>,
    prefix: &'a str,
}

impl Prefixed<'_> {
    /// # Safety
    /// As for [`Symbols::optional`].
    unsafe fn optional<T: Copy>(&self, name: &'static str) -> Option<T> {
        let full = format!("{}_{name}", self.prefix);
        // SAFETY: handed on to the caller.
        unsafe { self.symbols.optional(&full).or_else(|| self.symbols.optional(name)) }
    }

    /// # Safety
    /// As for [`Symbols::required`].
    unsafe fn required<T: Copy>(&self, name: &'static str) -> Result<T, FmiError> {
        // SAFETY: handed on to the caller.
        unsafe { self.optional(name) }.ok_or_else(|| self.symbols.missing(name))
    }
}

impl Fmi1 {
    /// Looks the functions of one interface up.
    ///
    /// # Safety
    /// The library follows FMI 1.0: a symbol of a name has the type the standard gives it.
    pub(super) unsafe fn load(
        symbols: &Symbols<'_>,
        kind: InterfaceKind,
        model_identifier: &str,
    ) -> Result<Self, FmiError> {
        let symbols = Prefixed { symbols, prefix: model_identifier };
        // SAFETY: each name is paired with the signature of the standard's fmiModelFunctions.h and fmiFunctions.h; the
        // caller vouches that the library does the same. The pointers stay valid while the `Library` that owns this
        // table is open.
        unsafe {
            let interface = match kind {
                InterfaceKind::ModelExchange => Interface::ModelExchange(ModelExchange {
                    instantiate: symbols.required("fmiInstantiateModel")?,
                    free: symbols.required("fmiFreeModelInstance")?,
                    set_time: symbols.required("fmiSetTime")?,
                    initialize: symbols.required("fmiInitialize")?,
                    terminate: symbols.required("fmiTerminate")?,
                    set_continuous_states: symbols.required("fmiSetContinuousStates")?,
                    completed_integrator_step: symbols.required("fmiCompletedIntegratorStep")?,
                    get_derivatives: symbols.required("fmiGetDerivatives")?,
                    get_event_indicators: symbols.required("fmiGetEventIndicators")?,
                    event_update: symbols.required("fmiEventUpdate")?,
                    get_continuous_states: symbols.required("fmiGetContinuousStates")?,
                    get_nominals: symbols.required("fmiGetNominalContinuousStates")?,
                }),
                InterfaceKind::CoSimulation => Interface::CoSimulation(CoSimulation {
                    instantiate: symbols.required("fmiInstantiateSlave")?,
                    free: symbols.required("fmiFreeSlaveInstance")?,
                    initialize: symbols.required("fmiInitializeSlave")?,
                    terminate: symbols.required("fmiTerminateSlave")?,
                    do_step: symbols.required("fmiDoStep")?,
                    reset: symbols.optional("fmiResetSlave"),
                    cancel_step: symbols.optional("fmiCancelStep"),
                    get_status: symbols.optional("fmiGetStatus"),
                    get_real_status: symbols.optional("fmiGetRealStatus"),
                    set_input_derivatives: symbols.optional("fmiSetRealInputDerivatives"),
                }),
            };
            Ok(Self {
                interface,
                get_real: symbols.required("fmiGetReal")?,
                get_integer: symbols.optional("fmiGetInteger"),
                get_boolean: symbols.optional("fmiGetBoolean"),
                get_string: symbols.optional("fmiGetString"),
                set_real: symbols.required("fmiSetReal")?,
                set_integer: symbols.optional("fmiSetInteger"),
                set_boolean: symbols.optional("fmiSetBoolean"),
                set_string: symbols.optional("fmiSetString"),
                set_debug_logging: symbols.optional("fmiSetDebugLogging"),
            })
        }
    }
}

impl Boxed {
    /// The box behind a component.
    ///
    /// # Safety
    /// The component was made by [`Fmi1::instantiate`](Binding::instantiate) and is not freed; no other reference to
    /// the box is alive (calls on one component do not overlap).
    unsafe fn of<'a>(component: Component) -> &'a mut Boxed {
        // SAFETY: `instantiate` made it of a box of this type.
        unsafe { &mut *component.cast() }
    }

    /// The FMU's component, with its messages going to this instance while the guard lives.
    fn enter(&self) -> (Slave, Current) {
        // SAFETY: the environment is kept until the component is gone (invariant 3).
        (self.slave, unsafe { Current::set(self.environment) })
    }
}

/// Calls a function of the FMU with the component first.
macro_rules! call {
    ($component:expr, $function:expr $(, $argument:expr)*) => {{
        // SAFETY: the caller's promises are those of the trait.
        let (slave, _current) = unsafe { Boxed::of($component) }.enter();
        // SAFETY: the same.
        status(unsafe { ($function)(slave $(, $argument)*) })
    }};
}

/// Calls an optional function, or says that it is missing.
macro_rules! optional {
    ($component:expr, $function:expr $(, $argument:expr)*) => {
        match $function {
            Some(function) => call!($component, function $(, $argument)*),
            None => Status::Missing,
        }
    };
}

/// Calls a function of model exchange.
macro_rules! model {
    ($self:ident, $component:expr, $function:ident $(, $argument:expr)*) => {
        match &$self.interface {
            Interface::ModelExchange(functions) => call!($component, functions.$function $(, $argument)*),
            Interface::CoSimulation(_) => Status::Missing,
        }
    };
}

impl CoSimulation {
    /// Asks what became of a step that was not completed.
    ///
    /// # Safety
    /// As for the methods of [`Binding`].
    unsafe fn explain(&self, component: Component, status: Status, info: &mut StepInfo) {
        info.pending = status == Status::Pending;
        if status == Status::Discard {
            let mut reached = f64::NAN;
            let known = optional!(component, self.get_real_status, LAST_SUCCESSFUL_TIME, &raw mut reached);
            info.reached = (known == Status::Ok && reached.is_finite()).then_some(reached);
            info.may_have_ended = info.reached.is_some();
        }
    }
}

impl Binding for Fmi1 {
    fn name(&self, call: Call) -> &'static str {
        let is_me = matches!(self.interface, Interface::ModelExchange(_));
        let of = |me, cs| if is_me { me } else { cs };
        match call {
            Call::Instantiate => of("fmiInstantiateModel", "fmiInstantiateSlave"),
            Call::SetDebugLogging => "fmiSetDebugLogging",
            Call::EnterInitialization => of("fmiSetTime", "fmiInitializeSlave"),
            Call::ExitInitialization => of("fmiInitialize", "fmiInitializeSlave"),
            Call::Terminate => of("fmiTerminate", "fmiTerminateSlave"),
            Call::Reset => of("fmiReset", "fmiResetSlave"),
            Call::Get(VariableKind::Real) => "fmiGetReal",
            Call::Get(VariableKind::Boolean) => "fmiGetBoolean",
            Call::Get(VariableKind::String) => "fmiGetString",
            Call::Get(_) => "fmiGetInteger",
            Call::Set(VariableKind::Real) => "fmiSetReal",
            Call::Set(VariableKind::Boolean) => "fmiSetBoolean",
            Call::Set(VariableKind::String) => "fmiSetString",
            Call::Set(_) => "fmiSetInteger",
            Call::NewDiscreteStates => "fmiEventUpdate",
            Call::CompletedIntegratorStep => "fmiCompletedIntegratorStep",
            Call::SetTime => "fmiSetTime",
            Call::SetContinuousStates => "fmiSetContinuousStates",
            Call::GetContinuousStates => "fmiGetContinuousStates",
            Call::GetDerivatives => "fmiGetDerivatives",
            Call::GetEventIndicators => "fmiGetEventIndicators",
            Call::GetNominals => "fmiGetNominalContinuousStates",
            Call::DoStep => "fmiDoStep",
            Call::StepStatus => "fmiGetStatus",
            Call::CancelStep => "fmiCancelStep",
            Call::SetInputDerivatives => "fmiSetRealInputDerivatives",
            // What later versions have: never called, or answered with "missing".
            Call::SetupExperiment => "(experiment)",
            Call::SaveState | Call::RestoreState => "(saved states)",
            Call::SerializedSize | Call::Serialize | Call::Deserialize => "(serialized states)",
            Call::DirectionalDerivative => "(directional derivatives)",
            Call::EnterEventMode | Call::EnterContinuousTimeMode | Call::EnterStepMode => "(modes)",
            Call::EnterConfiguration | Call::ExitConfiguration => "(configuration mode)",
            Call::CountStates | Call::CountIndicators => "(number of states)",
        }
    }

    unsafe fn instantiate(&self, request: &Request<'_>, environment: &Environment) -> Option<Created> {
        // SAFETY: the caller keeps the environment until the component is gone.
        let current = unsafe { Current::set(environment) };
        let slave = match &self.interface {
            // SAFETY: the strings end in NUL; the callbacks are passed by value.
            Interface::ModelExchange(functions) => unsafe {
                (functions.instantiate)(
                    request.name.as_ptr(),
                    request.guid.as_ptr(),
                    CALLBACKS,
                    request.logging.into(),
                )
            },
            Interface::CoSimulation(functions) => {
                // The location is that of the unpacked FMU, above its resources.
                let root = request.resources.parent().unwrap_or(request.resources);
                let location = file_uri(root);
                // SAFETY: as above.
                unsafe {
                    (functions.instantiate)(
                        request.name.as_ptr(),
                        request.guid.as_ptr(),
                        location.as_ptr(),
                        c"application/x-fmu-sharedlibrary".as_ptr(),
                        0.0,
                        request.visible.into(),
                        0,
                        SlaveCallbacks { common: CALLBACKS, step_finished: None },
                        request.logging.into(),
                    )
                }
            }
        };
        drop(current);
        if slave.is_null() {
            return None;
        }
        let boxed = Boxed {
            slave,
            environment: std::ptr::from_ref(environment),
            experiment: Experiment::default(),
            announced: None,
            made_progress: true,
        };
        Some(Created { component: Box::into_raw(Box::new(boxed)).cast(), keep: Arc::new(()) })
    }

    unsafe fn free_instance(&self, component: Component) {
        // SAFETY: the box was made by `instantiate` and is given up here, once.
        let boxed = unsafe { Box::from_raw(component.cast::<Boxed>()) };
        let (slave, _current) = boxed.enter();
        let free = match &self.interface {
            Interface::ModelExchange(functions) => functions.free,
            Interface::CoSimulation(functions) => functions.free,
        };
        // SAFETY: the FMU's component is alive, and gone after this.
        unsafe { free(slave) }
    }

    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status {
        optional!(component, self.set_debug_logging, on.into())
    }

    unsafe fn enter_initialization(&self, component: Component, experiment: &Experiment) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        unsafe { Boxed::of(component) }.experiment = *experiment;
        match &self.interface {
            Interface::ModelExchange(functions) => call!(component, functions.set_time, experiment.start),
            Interface::CoSimulation(_) => Status::Ok,
        }
    }

    unsafe fn exit_initialization(&self, component: Component) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        let Experiment { tolerance, start, stop } = unsafe { Boxed::of(component) }.experiment;
        match &self.interface {
            Interface::ModelExchange(functions) => {
                let mut info = RawEventInfo::default();
                let status = call!(
                    component,
                    functions.initialize,
                    tolerance.is_some().into(),
                    tolerance.unwrap_or(0.0),
                    &raw mut info
                );
                // SAFETY: as above.
                unsafe { Boxed::of(component) }.announced = Some(info.in_house_words());
                status
            }
            Interface::CoSimulation(functions) => {
                call!(component, functions.initialize, start, stop.is_some().into(), stop.unwrap_or(0.0))
            }
        }
    }

    unsafe fn terminate(&self, component: Component) -> Status {
        match &self.interface {
            Interface::ModelExchange(functions) => call!(component, functions.terminate),
            Interface::CoSimulation(functions) => call!(component, functions.terminate),
        }
    }

    unsafe fn reset(&self, component: Component) -> Status {
        match &self.interface {
            Interface::ModelExchange(_) => Status::Missing,
            Interface::CoSimulation(functions) => {
                // SAFETY: the caller's promises are those of the trait.
                unsafe { Boxed::of(component) }.made_progress = true;
                optional!(component, functions.reset)
            }
        }
    }

    unsafe fn get_real(&self, component: Component, references: &[u32], values: &mut [f64]) -> Status {
        call!(component, self.get_real, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Status {
        call!(component, self.set_real, references.as_ptr(), values.len(), values.as_ptr())
    }

    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        let (list, n) = (references.as_ptr(), references.len());
        // SAFETY: the caller's promises are those of the trait.
        let (slave, _current) = unsafe { Boxed::of(component) }.enter();
        match (kind, self.get_integer, self.get_boolean) {
            (VariableKind::Integer | VariableKind::Enumeration, Some(function), _) => {
                // SAFETY: the same; there are as many lanes as references.
                status(packed::get::<c_int>(lanes, |values| unsafe { function(slave, list, n, values) }))
            }
            (VariableKind::Boolean, _, Some(function)) => {
                // SAFETY: the same.
                let code =
                    packed::get::<Boolean>(lanes, |values| unsafe { function(slave, list, n, values) });
                packed::normalize(lanes);
                status(code)
            }
            _ => Status::Missing,
        }
    }

    unsafe fn set_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        let (list, n) = (references.as_ptr(), references.len());
        // SAFETY: the caller's promises are those of the trait.
        let (slave, _current) = unsafe { Boxed::of(component) }.enter();
        match (kind, self.set_integer, self.set_boolean) {
            (VariableKind::Integer | VariableKind::Enumeration, Some(function), _) => {
                // SAFETY: the same; there are as many lanes as references.
                status(packed::set::<c_int>(lanes, |values| unsafe { function(slave, list, n, values) }))
            }
            (VariableKind::Boolean, _, Some(function)) => {
                // SAFETY: the same.
                status(packed::set::<Boolean>(lanes, |values| unsafe { function(slave, list, n, values) }))
            }
            _ => Status::Missing,
        }
    }

    unsafe fn get_string(
        &self,
        component: Component,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Status {
        optional!(component, self.get_string, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_string(
        &self,
        component: Component,
        references: &[u32],
        values: &[*const c_char],
    ) -> Status {
        optional!(component, self.set_string, references.as_ptr(), values.len(), values.as_ptr())
    }

    /// There is no event mode: events happen in `fmiEventUpdate`.
    unsafe fn enter_event_mode(&self, _: Component) -> Status {
        Status::Ok
    }

    unsafe fn new_discrete_states(&self, component: Component, info: &mut EventInfo) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        if let Some(announced) = unsafe { Boxed::of(component) }.announced.take() {
            *info = announced;
            return Status::Ok;
        }
        let mut raw = RawEventInfo::default();
        // fmiFalse: the FMU iterates by itself and returns when it is done. That is what every other importer asks for;
        // one that returns before is asked again.
        let status = model!(self, component, event_update, 0, &raw mut raw);
        *info = raw.in_house_words();
        status
    }

    unsafe fn enter_continuous_time_mode(&self, _: Component) -> Status {
        Status::Ok
    }

    unsafe fn completed_integrator_step(
        &self,
        component: Component,
        _: bool,
        event: &mut bool,
        terminate: &mut bool,
    ) -> Status {
        let mut raw: Boolean = 0;
        let status = model!(self, component, completed_integrator_step, &raw mut raw);
        *event = raw != 0;
        *terminate = false;
        status
    }

    unsafe fn set_time(&self, component: Component, time: f64) -> Status {
        model!(self, component, set_time, time)
    }

    unsafe fn set_continuous_states(&self, component: Component, states: &[f64]) -> Status {
        model!(self, component, set_continuous_states, states.as_ptr(), states.len())
    }

    unsafe fn get_continuous_states(&self, component: Component, states: &mut [f64]) -> Status {
        model!(self, component, get_continuous_states, states.as_mut_ptr(), states.len())
    }

    unsafe fn get_derivatives(&self, component: Component, derivatives: &mut [f64]) -> Status {
        model!(self, component, get_derivatives, derivatives.as_mut_ptr(), derivatives.len())
    }

    unsafe fn get_event_indicators(&self, component: Component, indicators: &mut [f64]) -> Status {
        model!(self, component, get_event_indicators, indicators.as_mut_ptr(), indicators.len())
    }

    unsafe fn get_nominals(&self, component: Component, nominals: &mut [f64]) -> Status {
        model!(self, component, get_nominals, nominals.as_mut_ptr(), nominals.len())
    }

    unsafe fn do_step(&self, component: Component, time: f64, step: f64, info: &mut StepInfo) -> Status {
        let Interface::CoSimulation(functions) = &self.interface else { return Status::Missing };
        // SAFETY: the caller's promises are those of the trait.
        let new_step = unsafe { Boxed::of(component) }.made_progress;
        let status = call!(component, functions.do_step, time, step, new_step.into());
        // SAFETY: the same.
        unsafe { functions.explain(component, status, info) };
        // A step of which nothing was computed will be tried again.
        let stuck = status == Status::Discard && !info.reached.is_some_and(|reached| reached > time);
        // SAFETY: the same.
        unsafe { Boxed::of(component) }.made_progress = !stuck;
        status
    }

    unsafe fn step_status(&self, component: Component, info: &mut StepInfo) -> Status {
        let Interface::CoSimulation(functions) = &self.interface else { return Status::Missing };
        let mut code = 0;
        let asked = optional!(component, functions.get_status, DO_STEP_STATUS, &raw mut code);
        let status = if asked == Status::Ok { status(code) } else { asked };
        // SAFETY: the caller's promises are those of the trait.
        unsafe { functions.explain(component, status, info) };
        status
    }

    unsafe fn cancel_step(&self, component: Component) -> Status {
        let Interface::CoSimulation(functions) = &self.interface else { return Status::Missing };
        optional!(component, functions.cancel_step)
    }

    unsafe fn set_input_derivatives(
        &self,
        component: Component,
        references: &[u32],
        orders: &[c_int],
        values: &[f64],
    ) -> Status {
        let Interface::CoSimulation(functions) = &self.interface else { return Status::Missing };
        optional!(
            component,
            functions.set_input_derivatives,
            references.as_ptr(),
            references.len(),
            orders.as_ptr(),
            values.as_ptr()
        )
    }
}
