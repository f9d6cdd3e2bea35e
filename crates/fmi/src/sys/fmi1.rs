//! The functions of an FMI 1.0 library (Model Exchange 1.0, chapter 2; Co-Simulation 1.0, chapter 3), bound by name.
//!
//! FMI 1.0 has no initialization mode, no event mode and no environment for callbacks; a component here is therefore a
//! box around the FMU's, with what has to be remembered between calls. Names carry the model identifier as prefix.

use super::binding::Binding;
use super::call::{Call, Values};
use super::callbacks::{Callbacks, Current, Environment, fmufit_allocate, fmufit_fmi1_log, fmufit_free};
use super::functions::{
    Interface, LifeFunctions, PointFunctions, StepFunctions, Table, ValueFunctions, call, model, optional,
    table,
};
use super::symbols::Symbols;
use super::types::{Component, EventInfo, Experiment, InterfaceKind, Request, StepInfo, file_uri, status};
use crate::description::VariableKind;
use crate::error::{FmiError, Status};
use std::ffi::{c_char, c_int, c_void};

/// `fmiBoolean`.
type Boolean = c_char;
/// `fmiComponent`.
type Slave = *mut c_void;
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
type SetDebugLogging = unsafe extern "C" fn(Slave, Boolean) -> c_int;
type CompletedStep = unsafe extern "C" fn(Slave, *mut Boolean) -> c_int;
type Initialize = unsafe extern "C" fn(Slave, Boolean, f64, *mut RawEventInfo) -> c_int;
type EventUpdate = unsafe extern "C" fn(Slave, Boolean, *mut RawEventInfo) -> c_int;
type InitializeSlave = unsafe extern "C" fn(Slave, f64, Boolean, f64) -> c_int;
type DoStep = unsafe extern "C" fn(Slave, f64, f64, Boolean) -> c_int;

/// The functions of one library.
pub(super) struct Fmi1 {
    kind: InterfaceKind,
    life: LifeFunctions,
    values: ValueFunctions<Boolean>,
    set_debug_logging: Option<SetDebugLogging>,
    interface: Interface<ModelExchange, CoSimulation>,
}

table! {
    /// Model exchange.
    struct ModelExchange {
        required {
            instantiate: InstantiateModel = Call::Instantiate;
            initialize: Initialize = Call::ExitInitialization;
            completed_integrator_step: CompletedStep = Call::CompletedIntegratorStep;
            event_update: EventUpdate = Call::NewDiscreteStates;
        }
        optional {}
    }
}

table! {
    /// Co-simulation.
    struct CoSimulation {
        required {
            instantiate: InstantiateSlave = Call::Instantiate;
            initialize: InitializeSlave = Call::ExitInitialization;
            do_step: DoStep = Call::DoStep;
        }
        optional {}
    }
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
        let symbols = &symbols.with_prefix(model_identifier);
        let name = |call| name(kind, call);
        // SAFETY: the caller vouches for the library, and the names are those of FMI 1.0.
        unsafe {
            Ok(Self {
                interface: Interface::load(symbols, kind, name)?,
                kind,
                life: LifeFunctions::load(symbols, name)?,
                values: ValueFunctions::load(symbols, name)?,
                set_debug_logging: symbols.optional(name(Call::SetDebugLogging)),
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

/// Enters the component and does something with the FMU's own.
macro_rules! within {
    ($component:expr, |$slave:ident| $body:expr) => {{
        // SAFETY: the caller's promises are those of the trait.
        let ($slave, _current) = unsafe { Boxed::of($component) }.enter();
        $body
    }};
}

/// The standard's names.
pub(super) fn name(kind: InterfaceKind, call: Call) -> &'static str {
    let of = |me, cs| if kind == InterfaceKind::ModelExchange { me } else { cs };
    match call {
        Call::Instantiate => of("fmiInstantiateModel", "fmiInstantiateSlave"),
        Call::SetDebugLogging => "fmiSetDebugLogging",
        Call::EnterInitialization => of("fmiSetTime", "fmiInitializeSlave"),
        Call::ExitInitialization => of("fmiInitialize", "fmiInitializeSlave"),
        Call::Terminate => of("fmiTerminate", "fmiTerminateSlave"),
        Call::Reset if kind == InterfaceKind::CoSimulation => "fmiResetSlave",
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
        Call::FreeInstance => of("fmiFreeModelInstance", "fmiFreeSlaveInstance"),
        Call::StepRealStatus => "fmiGetRealStatus",
        Call::GetOutputDerivatives => "fmiGetRealOutputDerivatives",
        other => other.in_brackets(),
    }
}

impl Binding for Fmi1 {
    fn name(&self, call: Call) -> &'static str {
        name(self.kind, call)
    }

    unsafe fn enter(&self, component: Component) -> (Component, Option<Current>) {
        // SAFETY: the caller's promises are those of the trait.
        let (slave, current) = unsafe { Boxed::of(component) }.enter();
        (slave, Some(current))
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

    fn steps(&self) -> Option<&StepFunctions> {
        self.interface.steps()
    }

    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> Component {
        let environment = callbacks.environment();
        // SAFETY: the caller keeps the environment until the component is gone.
        let current = unsafe { Current::set(environment) };
        let slave = match &self.interface {
            // SAFETY: the strings end in NUL; the callbacks are passed by value.
            Interface::ModelExchange(functions, _) => unsafe {
                (functions.instantiate)(
                    request.name.as_ptr(),
                    request.guid.as_ptr(),
                    CALLBACKS,
                    request.logging.into(),
                )
            },
            Interface::CoSimulation(functions, _) => {
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
            return slave;
        }
        let boxed = Boxed {
            slave,
            environment: std::ptr::from_ref(environment),
            experiment: Experiment::default(),
            announced: None,
            made_progress: true,
        };
        Box::into_raw(Box::new(boxed)).cast()
    }

    unsafe fn free_instance(&self, component: Component) {
        // SAFETY: the box was made by `instantiate` and is given up here, once.
        let boxed = unsafe { Box::from_raw(component.cast::<Boxed>()) };
        let (slave, _current) = boxed.enter();
        // SAFETY: the FMU's component is alive, and gone after this.
        unsafe { (self.life.free)(slave) }
    }

    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status {
        within!(component, |slave| optional!(self.set_debug_logging, slave, on.into()))
    }

    unsafe fn enter_initialization(&self, component: Component, experiment: &Experiment) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        unsafe { Boxed::of(component) }.experiment = *experiment;
        match self.interface.point() {
            Some(point) => within!(component, |slave| call!(point.set_time, slave, experiment.start)),
            None => Status::Ok,
        }
    }

    unsafe fn exit_initialization(&self, component: Component) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        let Experiment { tolerance, start, stop } = unsafe { Boxed::of(component) }.experiment;
        match &self.interface {
            Interface::ModelExchange(functions, _) => {
                let mut info = RawEventInfo::default();
                let is_controlled = tolerance.is_some().into();
                let tolerance = tolerance.unwrap_or(0.0);
                let status = within!(component, |slave| {
                    call!(functions.initialize, slave, is_controlled, tolerance, &raw mut info)
                });
                // SAFETY: as above.
                unsafe { Boxed::of(component) }.announced = Some(info.in_house_words());
                status
            }
            Interface::CoSimulation(functions, _) => {
                let (is_defined, stop) = (stop.is_some().into(), stop.unwrap_or(0.0));
                within!(component, |slave| call!(functions.initialize, slave, start, is_defined, stop))
            }
        }
    }

    unsafe fn reset(&self, component: Component) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        unsafe { Boxed::of(component) }.made_progress = true;
        within!(component, |slave| optional!(self.life.reset, slave))
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
        let status = within!(component, |slave| model!(self, event_update, slave, 0, &raw mut raw));
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
        let status = within!(component, |slave| model!(self, completed_integrator_step, slave, &raw mut raw));
        *event = raw != 0;
        *terminate = false;
        status
    }

    unsafe fn do_step(
        &self,
        component: Component,
        (time, step): (f64, f64),
        _: bool,
        info: &mut StepInfo,
    ) -> Status {
        let Interface::CoSimulation(functions, steps) = &self.interface else { return Status::Missing };
        // SAFETY: the caller's promises are those of the trait.
        let new_step = unsafe { Boxed::of(component) }.made_progress;
        let status = within!(component, |slave| {
            let status = call!(functions.do_step, slave, time, step, new_step.into());
            // SAFETY: the same.
            unsafe { steps.explain(slave, status, info) };
            status
        });
        // A step of which nothing was computed will be tried again.
        let stuck = status == Status::Discard && !info.reached.is_some_and(|reached| reached > time);
        // SAFETY: the same.
        unsafe { Boxed::of(component) }.made_progress = !stuck;
        status
    }
}
