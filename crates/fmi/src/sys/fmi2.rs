//! Functions of an FMI 2.0 library (FMI 2.0.x, sections 2.1, 3.2 and 4.2), bound by name.

use super::callbacks::{Callbacks, fmufit_allocate, fmufit_free, fmufit_log};
use super::function::{Answer, call};
use super::functions::Functions;
use super::symbols::table;
use super::types::{Component, Direction, EventInfo, Experiment, InterfaceKind, Request, StepInfo, file_uri};
use super::versioned_functions::{Step, Version};
use std::ffi::{c_char, c_int, c_void};

/// `fmi2Boolean`.
pub(super) type Boolean = c_int;
/// `fmi2Type`.
const MODEL_EXCHANGE: c_int = 0;
const CO_SIMULATION: c_int = 1;

type Logger = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);
type StepFinished = unsafe extern "C" fn(*mut c_void, c_int);

/// `fmi2CallbackFunctions`.
#[repr(C)]
pub(super) struct CallbackFunctions {
    logger: Logger,
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
    /// Used only for asynchronous co-simulation.
    step_finished: Option<StepFinished>,
    component_environment: *mut c_void,
}

// SAFETY: not written after construction, and the environment points to a mutex (see `Environment`).
unsafe impl Send for CallbackFunctions {}
// SAFETY: as for `Send`.
unsafe impl Sync for CallbackFunctions {}

/// `fmi2EventInfo`.
#[repr(C)]
#[derive(Default)]
pub(super) struct RawEventInfo {
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

table! {
    /// Functions of one library whose types are specific to FMI 2.0. A function is optional if it is optional
    /// in the standard, or if there are usable FMUs that lack it.
    pub(super) struct Fmi2 {
        both {
            instantiate[Instantiate] = required "fmi2Instantiate";
            set_debug_logging(Boolean, usize, *const *const c_char) = optional "fmi2SetDebugLogging";
            enter_initialization() = required "fmi2EnterInitializationMode";
            directional_derivative(*const u32, usize, *const u32, usize, *const f64, *mut f64) =
                optional "fmi2GetDirectionalDerivative";
        }
        model_exchange {
            new_discrete_states(*mut RawEventInfo) = required "fmi2NewDiscreteStates";
            completed_integrator_step(Boolean, *mut Boolean, *mut Boolean) =
                required "fmi2CompletedIntegratorStep";
        }
        co_simulation {
            do_step(f64, f64, Boolean) = required "fmi2DoStep";
        }
    }
}

impl Version for Fmi2 {
    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> (Component, &'static str) {
        let functions = callbacks.keep(|environment| CallbackFunctions {
            logger: fmufit_log,
            allocate_memory: fmufit_allocate,
            free_memory: fmufit_free,
            step_finished: None,
            component_environment: std::ptr::from_ref(environment).cast_mut().cast(),
        });
        let resources = file_uri(request.resources);
        let kind = if request.kind == InterfaceKind::ModelExchange { MODEL_EXCHANGE } else { CO_SIMULATION };
        // SAFETY: the strings are NUL-terminated; the callbacks are on the heap and never freed.
        self.instantiate.make(|instantiate| unsafe {
            instantiate(
                request.name.as_ptr(),
                kind,
                request.guid.as_ptr(),
                resources.as_ptr(),
                functions,
                request.visible.into(),
                request.logging.into(),
            )
        })
    }

    unsafe fn set_debug_logging(&self, c: Component, on: bool, categories: &[*const c_char]) -> Answer {
        let (list, n) = (categories.as_ptr(), categories.len());
        call!(self.set_debug_logging, c, on.into(), n, list)
    }

    unsafe fn enter_initialization(&self, _: &Functions, c: Component, _: &Experiment) -> Answer {
        call!(self.enter_initialization, c)
    }

    unsafe fn directional_derivative(&self, c: Component, along: Direction<'_>, out: &mut [f64]) -> Answer {
        let Direction { unknowns, knowns, seed } = along;
        let (list, n) = (unknowns.as_ptr(), unknowns.len());
        let (knowns_pointer, n_knowns) = (knowns.as_ptr(), knowns.len());
        let function = &self.directional_derivative;
        call!(function, c, list, n, knowns_pointer, n_knowns, seed.as_ptr(), out.as_mut_ptr())
    }

    unsafe fn new_discrete_states(&self, c: Component, info: &mut EventInfo) -> Answer {
        let mut raw = RawEventInfo::default();
        let answer = call!(self.new_discrete_states, c, &raw mut raw);
        *info = EventInfo {
            new_discrete_states_needed: raw.new_discrete_states_needed != 0,
            terminate: raw.terminate_simulation != 0,
            nominals_changed: raw.nominals_of_continuous_states_changed != 0,
            values_changed: raw.values_of_continuous_states_changed != 0,
            next_event_time: (raw.next_event_time_defined != 0).then_some(raw.next_event_time),
        };
        answer
    }

    unsafe fn completed_integrator_step(&self, c: Component, no_prior: bool, info: &mut StepInfo) -> Answer {
        let (mut raw_event, mut raw_terminate): (Boolean, Boolean) = (0, 0);
        let answer = call!(
            self.completed_integrator_step,
            c,
            no_prior.into(),
            &raw mut raw_event,
            &raw mut raw_terminate
        );
        (info.event, info.terminate) = (raw_event != 0, raw_terminate != 0);
        answer
    }

    unsafe fn do_step(&self, f: &Functions, c: Component, step: Step, info: &mut StepInfo) -> Answer {
        let Step { time, size, no_set_state_prior, .. } = step;
        let answer = call!(self.do_step, c, time, size, no_set_state_prior.into());
        // SAFETY: as for this call.
        unsafe { f.explain_step(c, answer.status, info) };
        answer
    }

    fn step_function(&self) -> &'static str {
        self.do_step.name
    }
}
