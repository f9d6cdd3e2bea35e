//! Functions of an FMI 1.0 library (Model Exchange 1.0, chapter 2; Co-Simulation 1.0, chapter 3), bound by
//! name.
//!
//! FMI 1.0 has no initialization mode, no event mode and no environment for callbacks. The model identifier
//! is the prefix of all names.

use super::callbacks::{Callbacks, fmufit_allocate, fmufit_free, fmufit_log};
use super::function::{Answer, call};
use super::functions::Functions;
use super::symbols::table;
use super::types::{Component, Direction, EventInfo, Experiment, InterfaceKind, Request, StepInfo, file_uri};
use super::versioned_functions::{Step, Version};
use crate::error::Status;
use std::ffi::{c_char, c_int, c_void};

/// `fmiBoolean`.
pub(super) type Boolean = c_char;
type Logger = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);
type StepFinished = unsafe extern "C" fn(*mut c_void, c_int);

/// `fmiCallbackFunctions` of model exchange, passed by value.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct ModelCallbacks {
    logger: Logger,
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
}

/// `fmiCallbackFunctions` of co-simulation, passed by value.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct SlaveCallbacks {
    common: ModelCallbacks,
    /// Used only for asynchronous steps.
    step_finished: Option<StepFinished>,
}

const CALLBACKS: ModelCallbacks =
    ModelCallbacks { logger: fmufit_log, allocate_memory: fmufit_allocate, free_memory: fmufit_free };

/// `fmiEventInfo`.
#[repr(C)]
#[derive(Default)]
pub(super) struct RawEventInfo {
    iteration_converged: Boolean,
    state_value_references_changed: Boolean,
    state_values_changed: Boolean,
    terminate_simulation: Boolean,
    upcoming_time_event: Boolean,
    next_event_time: f64,
}

impl RawEventInfo {
    fn info(&self) -> EventInfo {
        EventInfo {
            new_discrete_states_needed: self.iteration_converged == 0,
            terminate: self.terminate_simulation != 0,
            // Different states have different nominals.
            nominals_changed: self.state_value_references_changed != 0,
            values_changed: self.state_values_changed != 0 || self.state_value_references_changed != 0,
            next_event_time: (self.upcoming_time_event != 0).then_some(self.next_event_time),
        }
    }
}

type InstantiateModel =
    unsafe extern "C" fn(*const c_char, *const c_char, ModelCallbacks, Boolean) -> Component;
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
) -> Component;

table! {
    /// Functions of one library whose types are specific to FMI 1.0.
    pub(super) struct Fmi1 {
        both {
            set_debug_logging(Boolean) = optional "fmiSetDebugLogging";
        }
        model_exchange {
            instantiate_model[InstantiateModel] = required "fmiInstantiateModel";
            initialize_model(Boolean, f64, *mut RawEventInfo) = required "fmiInitialize";
            completed_integrator_step(*mut Boolean) = required "fmiCompletedIntegratorStep";
            event_update(Boolean, *mut RawEventInfo) = required "fmiEventUpdate";
        }
        co_simulation {
            instantiate_slave[InstantiateSlave] = required "fmiInstantiateSlave";
            initialize_slave(f64, Boolean, f64) = required "fmiInitializeSlave";
            do_step(f64, f64, Boolean) = required "fmiDoStep";
        }
    }
}

impl Fmi1 {
    fn kind(&self) -> InterfaceKind {
        match self.do_step.pointer {
            Some(_) => InterfaceKind::CoSimulation,
            None => InterfaceKind::ModelExchange,
        }
    }
}

impl Version for Fmi1 {
    unsafe fn instantiate(&self, request: &Request<'_>, _: &Callbacks) -> (Component, &'static str) {
        let (name, guid, logging) = (request.name.as_ptr(), request.guid.as_ptr(), request.logging.into());
        // SAFETY: the strings are NUL-terminated; the callbacks are passed by value and use the environment
        // of the thread.
        match self.kind() {
            InterfaceKind::ModelExchange => self
                .instantiate_model
                .make(|instantiate| unsafe { instantiate(name, guid, CALLBACKS, logging) }),
            InterfaceKind::CoSimulation => self.instantiate_slave.make(|instantiate| {
                // The location is the root of the unpacked FMU, the parent folder of its resources.
                let root = file_uri(request.resources.parent().unwrap_or(request.resources));
                let (location, mime_type) = (root.as_ptr(), c"application/x-fmu-sharedlibrary".as_ptr());
                let callbacks = SlaveCallbacks { common: CALLBACKS, step_finished: None };
                let visible = request.visible.into();
                // SAFETY: as above.
                unsafe { instantiate(name, guid, location, mime_type, 0.0, visible, 0, callbacks, logging) }
            }),
        }
    }

    unsafe fn set_debug_logging(&self, c: Component, on: bool, _: &[*const c_char]) -> Answer {
        call!(self.set_debug_logging, c, on.into())
    }

    /// Sets the time for model exchange. Co-simulation has no separate initialization mode.
    unsafe fn enter_initialization(&self, f: &Functions, c: Component, experiment: &Experiment) -> Answer {
        match self.kind() {
            InterfaceKind::ModelExchange => call!(f.set_time, c, experiment.start),
            InterfaceKind::CoSimulation => Answer { function: "fmiInitializeSlave", status: Status::Ok },
        }
    }

    unsafe fn exit_initialization(
        &self,
        _: &Functions,
        c: Component,
        experiment: &Experiment,
        announced: &mut Option<EventInfo>,
    ) -> Answer {
        let Experiment { tolerance, start, stop } = *experiment;
        match self.kind() {
            InterfaceKind::ModelExchange => {
                let mut info = RawEventInfo::default();
                let (is_controlled, tolerance) = (tolerance.is_some().into(), tolerance.unwrap_or(0.0));
                let answer = call!(self.initialize_model, c, is_controlled, tolerance, &raw mut info);
                *announced = Some(info.info());
                answer
            }
            InterfaceKind::CoSimulation => {
                call!(self.initialize_slave, c, start, stop.is_some().into(), stop.unwrap_or(0.0))
            }
        }
    }

    unsafe fn directional_derivative(&self, _: Component, _: Direction<'_>, _: &mut [f64]) -> Answer {
        Answer { function: "(directional derivatives)", status: Status::Missing }
    }

    unsafe fn new_discrete_states(&self, c: Component, info: &mut EventInfo) -> Answer {
        let mut raw = RawEventInfo::default();
        // fmiFalse: the FMU iterates internally and returns when it has converged. Every other importer
        // requests this. An FMU that returns earlier is called again.
        let answer = call!(self.event_update, c, 0, &raw mut raw);
        *info = raw.info();
        answer
    }

    unsafe fn completed_integrator_step(&self, c: Component, _: bool, info: &mut StepInfo) -> Answer {
        let mut raw: Boolean = 0;
        let answer = call!(self.completed_integrator_step, c, &raw mut raw);
        (info.event, info.terminate) = (raw != 0, false);
        answer
    }

    unsafe fn do_step(&self, f: &Functions, c: Component, step: Step, info: &mut StepInfo) -> Answer {
        let answer = call!(self.do_step, c, step.time, step.size, step.is_new.into());
        // SAFETY: as for this call.
        unsafe { f.explain_step(c, answer.status, info) };
        answer
    }

    fn step_function(&self) -> &'static str {
        self.do_step.name
    }
}
