//! Table of the functions of an FMI 3.0 library (FMI 3.0.x, chapters 2, 3 and 4), bound by name.

use crate::error::Status;
use crate::sys::callbacks::{Callbacks, fmufit_fmi3_log};
use crate::sys::function::{Answer, call};
use crate::sys::functions::{Derivative, Functions, derivative};
use crate::sys::symbols::table;
use crate::sys::types::{Component, Direction, EventInfo, Experiment, InterfaceKind, Request, StepInfo};
use crate::sys::versioned_functions::{Step, Version};
use std::ffi::{CString, c_char, c_int, c_void};

/// A C `bool` as written by an FMU; any bits are tolerated.
pub(super) type Flag = u8;
type LogMessage = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);
type InstantiateModelExchange = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    *mut c_void,
    LogMessage,
) -> Component;
/// Never passed, because inputs are set and outputs read only between steps.
type IntermediateUpdate = unsafe extern "C" fn(*mut c_void, f64, Flag, Flag, Flag, Flag, *mut Flag, *mut f64);
type InstantiateCoSimulation = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    bool,
    bool,
    *const u32,
    usize,
    *mut c_void,
    LogMessage,
    Option<IntermediateUpdate>,
) -> Component;

table! {
    /// Functions of one library whose types are specific to FMI 3.0. The standard requires nearly all of
    /// them. Some FMUs omit functions they do not need, so only the functions needed by every simulation are
    /// required.
    pub(crate) struct Fmi3 {
        both {
            enter_initialization(bool, f64, f64, bool, f64) = required "fmi3EnterInitializationMode";
            set_debug_logging(bool, usize, *const *const c_char) = optional "fmi3SetDebugLogging";
            update_discrete_states(*mut Flag, *mut Flag, *mut Flag, *mut Flag, *mut Flag, *mut f64) =
                optional "fmi3UpdateDiscreteStates";
            directional_derivative[Derivative] = optional "fmi3GetDirectionalDerivative";
        }
        model_exchange {
            instantiate_model[InstantiateModelExchange] = required "fmi3InstantiateModelExchange";
            completed_integrator_step(bool, *mut Flag, *mut Flag) = required "fmi3CompletedIntegratorStep";
        }
        co_simulation {
            instantiate_slave[InstantiateCoSimulation] = required "fmi3InstantiateCoSimulation";
            do_step(f64, f64, bool, *mut Flag, *mut Flag, *mut Flag, *mut f64) = required "fmi3DoStep";
            get_output_derivatives(*const u32, usize, *const c_int, *mut f64, usize) =
                optional "fmi3GetOutputDerivatives";
        }
    }
}

impl Version for Fmi3 {
    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> (Component, &'static str) {
        // FMI 3.0 requires a path that ends in a separator, or NULL if there are no resources.
        let mut path = request.resources.to_string_lossy().into_owned();
        path.push(std::path::MAIN_SEPARATOR);
        let resources = CString::new(path).unwrap_or_default();
        let resources = if request.resources.is_dir() { resources.as_ptr() } else { std::ptr::null() };
        let environment: *mut c_void = std::ptr::from_ref(callbacks.environment()).cast_mut().cast();
        let (name, token) = (request.name.as_ptr(), request.guid.as_ptr());
        let (visible, logging) = (request.visible, request.logging);
        // SAFETY: the strings are NUL-terminated; the environment is on the heap and never freed.
        match request.kind {
            InterfaceKind::ModelExchange => self.instantiate_model.make(|instantiate| unsafe {
                instantiate(name, token, resources, visible, logging, environment, fmufit_fmi3_log)
            }),
            // SAFETY: as above; there are no variables for intermediate updates.
            InterfaceKind::CoSimulation => self.instantiate_slave.make(|instantiate| unsafe {
                instantiate(
                    name,
                    token,
                    resources,
                    visible,
                    logging,
                    request.event_mode,
                    request.early_return,
                    std::ptr::null(),
                    0,
                    environment,
                    fmufit_fmi3_log,
                    None,
                )
            }),
        }
    }

    unsafe fn set_debug_logging(&self, c: Component, on: bool, categories: &[*const c_char]) -> Answer {
        call!(self.set_debug_logging, c, on, categories.len(), categories.as_ptr())
    }

    unsafe fn enter_initialization(&self, _: &Functions, c: Component, experiment: &Experiment) -> Answer {
        let Experiment { tolerance, start, stop } = *experiment;
        call!(
            self.enter_initialization,
            c,
            tolerance.is_some(),
            tolerance.unwrap_or(0.0),
            start,
            stop.is_some(),
            stop.unwrap_or(0.0)
        )
    }

    unsafe fn directional_derivative(&self, c: Component, along: Direction<'_>, out: &mut [f64]) -> Answer {
        // SAFETY: as for this call.
        unsafe { derivative(&self.directional_derivative, c, along, out) }
    }

    unsafe fn new_discrete_states(&self, c: Component, info: &mut EventInfo) -> Answer {
        let (mut flags, mut next): ([Flag; 5], f64) = ([0; 5], 0.0);
        let [again, terminate, nominals, values, defined] = flags.each_mut().map(std::ptr::from_mut);
        let function = &self.update_discrete_states;
        let answer = call!(function, c, again, terminate, nominals, values, defined, &raw mut next);
        let [again, terminate, nominals, values, defined] = flags.map(|flag| flag != 0);
        *info = EventInfo {
            new_discrete_states_needed: again,
            terminate,
            nominals_changed: nominals,
            values_changed: values,
            next_event_time: defined.then_some(next),
        };
        answer
    }

    unsafe fn completed_integrator_step(&self, c: Component, no_prior: bool, info: &mut StepInfo) -> Answer {
        let (mut raw_event, mut raw_terminate): (Flag, Flag) = (0, 0);
        let answer =
            call!(self.completed_integrator_step, c, no_prior, &raw mut raw_event, &raw mut raw_terminate);
        (info.event, info.terminate) = (raw_event != 0, raw_terminate != 0);
        answer
    }

    unsafe fn do_step(&self, _: &Functions, c: Component, step: Step, info: &mut StepInfo) -> Answer {
        let Step { time, size, no_set_state_prior, .. } = step;
        let (mut event, mut terminate, mut early): (Flag, Flag, Flag) = (0, 0, 0);
        let mut reached = f64::NAN;
        let answer = call!(
            self.do_step,
            c,
            time,
            size,
            no_set_state_prior,
            &raw mut event,
            &raw mut terminate,
            &raw mut early,
            &raw mut reached
        );
        // The arguments are valid only after a successful call. `reached` is then the time of the model, even
        // if the step is incomplete (section 4.2.1.2). After a discard, the model is at its time before the
        // step (FMI 3.0.x, section 2.2.4), regardless of the arguments.
        if answer.is_good() {
            info.event = event != 0;
            info.terminate = terminate != 0;
            info.early = early != 0;
            info.reached = reached.is_finite().then_some(reached);
        }
        let is_cut_short = info.early || (info.terminate && info.reached.is_some());
        if is_cut_short { Answer { status: Status::Discard, ..answer } } else { answer }
    }

    unsafe fn get_output_derivatives(
        &self,
        _: &Functions,
        c: Component,
        refs: &[u32],
        orders: &[c_int],
        values: &mut [f64],
    ) -> Answer {
        call!(
            self.get_output_derivatives,
            c,
            refs.as_ptr(),
            refs.len(),
            orders.as_ptr(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    fn step_function(&self) -> &'static str {
        self.do_step.name
    }
}
