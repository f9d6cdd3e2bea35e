//! The functions of an FMI 2.0 library (FMI 2.0.x, sections 2.1, 3.2 and 4.2), bound by name.

use super::callbacks::{Callbacks, fmufit_allocate, fmufit_fmi2_log, fmufit_free};
use super::function::{Answer, call};
use super::functions::{Functions, Plain};
use super::symbols::{Symbols, table};
use super::types::{Component, Direction, EventInfo, Experiment, InterfaceKind, Request, StepInfo, file_uri};
use super::version::{Step, Version};
use crate::error::FmiError;
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
type SetDebugLogging = unsafe extern "C" fn(Component, Boolean, usize, *const *const c_char) -> c_int;
type DirectionalDerivative =
    unsafe extern "C" fn(Component, *const u32, usize, *const u32, usize, *const f64, *mut f64) -> c_int;
type NewDiscreteStates = unsafe extern "C" fn(Component, *mut RawEventInfo) -> c_int;
type CompletedStep = unsafe extern "C" fn(Component, Boolean, *mut Boolean, *mut Boolean) -> c_int;
type DoStep = unsafe extern "C" fn(Component, f64, f64, Boolean) -> c_int;

table! {
    /// The functions of one library whose types are those of FMI 2.0, for both interfaces. What may be
    /// missing is optional in the standard, or FMUs that leave it out are known and can be used all the same.
    struct Common {
        instantiate: Instantiate = required "fmi2Instantiate";
        set_debug_logging: SetDebugLogging = optional "fmi2SetDebugLogging";
        enter_initialization: Plain = required "fmi2EnterInitializationMode";
        directional_derivative: DirectionalDerivative = optional "fmi2GetDirectionalDerivative";
    }
}

table! {
    /// For model exchange.
    struct ModelExchange {
        new_discrete_states: NewDiscreteStates = required "fmi2NewDiscreteStates";
        completed_integrator_step: CompletedStep = required "fmi2CompletedIntegratorStep";
    }
}

table! {
    /// For co-simulation.
    struct CoSimulation {
        do_step: DoStep = required "fmi2DoStep";
    }
}

/// The functions of one library.
pub(super) struct Fmi2 {
    common: Common,
    model_exchange: ModelExchange,
    co_simulation: CoSimulation,
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
                common: Common::load(symbols)?,
                model_exchange: ModelExchange::load(&symbols.used(kind == InterfaceKind::ModelExchange))?,
                co_simulation: CoSimulation::load(&symbols.used(kind == InterfaceKind::CoSimulation))?,
            })
        }
    }
}

impl Version for Fmi2 {
    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> (Component, &'static str) {
        let functions = callbacks.keep(|environment| CallbackFunctions {
            logger: fmufit_fmi2_log,
            allocate_memory: fmufit_allocate,
            free_memory: fmufit_free,
            step_finished: None,
            component_environment: std::ptr::from_ref(environment).cast_mut().cast(),
        });
        let resources = file_uri(request.resources);
        let kind = if request.kind == InterfaceKind::ModelExchange { MODEL_EXCHANGE } else { CO_SIMULATION };
        // SAFETY: the strings end in NUL; the callbacks are on the heap and never freed.
        self.common.instantiate.make(|instantiate| unsafe {
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
        call!(self.common.set_debug_logging, c, on.into(), n, list)
    }

    unsafe fn enter_initialization(&self, _: &Functions, c: Component, _: &Experiment) -> Answer {
        call!(self.common.enter_initialization, c)
    }

    unsafe fn directional_derivative(&self, c: Component, along: Direction<'_>, out: &mut [f64]) -> Answer {
        let Direction { unknowns, knowns, seed } = along;
        let (list, n) = (unknowns.as_ptr(), unknowns.len());
        let (known, n_known) = (knowns.as_ptr(), knowns.len());
        let function = &self.common.directional_derivative;
        call!(function, c, list, n, known, n_known, seed.as_ptr(), out.as_mut_ptr())
    }

    unsafe fn new_discrete_states(&self, c: Component, info: &mut EventInfo) -> Answer {
        let mut raw = RawEventInfo::default();
        let answer = call!(self.model_exchange.new_discrete_states, c, &raw mut raw);
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
            self.model_exchange.completed_integrator_step,
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
        let answer = call!(self.co_simulation.do_step, c, time, size, no_set_state_prior.into());
        // SAFETY: as for this call.
        unsafe { f.steps.explain(c, answer.status, info) };
        answer
    }

    fn step_function(&self) -> &'static str {
        self.co_simulation.do_step.name
    }
}

/// The names in its tables.
#[cfg(test)]
pub(super) const NAMES: [&[&[&str]]; 3] = [Common::NAMES, ModelExchange::NAMES, CoSimulation::NAMES];
