//! The functions of an FMI 3.0 library (FMI 3.0.x, chapters 2, 3 and 4), bound by name.

use super::callbacks::{Environment, fmi3_log};
use super::fmi3_clocks::ClockFunctions;
use super::fmi3_functions::{
    CompletedStep, Count, DeserializeState, DirectionalDerivative, DoStep, EnterInitialization, Flag, Get,
    GetBinary, GetClock, GetOutputDerivatives, GetState, GetVector, InstantiateCoSimulation,
    InstantiateModelExchange, Plain, SerializeState, Set, SetBinary, SetClock, SetDebugLogging, SetState,
    SetTime, SetVector, StateSize, UpdateDiscreteStates,
};
use super::fmi3_intermediate::{StepEnvironment, intermediate_update};
use super::fmi3_numbers::{Numbers, get_name, set_name};
use super::library::Symbols;
use super::packed;
use super::{
    Binding, Call, Component, Created, EventInfo, Experiment, InterfaceKind, IntervalAnswer, MidStep,
    Request, StatePointer, Status, StepInfo, status,
};
use crate::description::{Interval, VariableKind};
use crate::error::FmiError;
use std::any::Any;
use std::ffi::{CString, c_char, c_int, c_void};
use std::sync::Arc;

/// The function table. The standard demands nearly all of these functions; FMUs that leave out what they do not need
/// are known, so only what every simulation needs must be there.
pub(super) struct Fmi3 {
    interface: Interface,
    free_instance: unsafe extern "C" fn(Component),
    enter_initialization_mode: EnterInitialization,
    exit_initialization_mode: Plain,
    terminate: Plain,
    get_float64: Get<f64>,
    set_float64: Set<f64>,
    numbers: Numbers,
    get_string: Option<Get<*const c_char>>,
    set_string: Option<Set<*const c_char>>,
    get_binary: Option<GetBinary>,
    set_binary: Option<SetBinary>,
    get_clock: Option<GetClock>,
    set_clock: Option<SetClock>,
    clocks: ClockFunctions,
    reset: Option<Plain>,
    set_debug_logging: Option<SetDebugLogging>,
    enter_configuration_mode: Option<Plain>,
    exit_configuration_mode: Option<Plain>,
    enter_event_mode: Option<Plain>,
    update_discrete_states: Option<UpdateDiscreteStates>,
    get_fmu_state: Option<GetState>,
    set_fmu_state: Option<SetState>,
    free_fmu_state: Option<GetState>,
    serialized_size: Option<StateSize>,
    serialize: Option<SerializeState>,
    deserialize: Option<DeserializeState>,
    directional_derivative: Option<DirectionalDerivative>,
}

enum Interface {
    ModelExchange(ModelExchange),
    CoSimulation(CoSimulation),
}

struct ModelExchange {
    instantiate: InstantiateModelExchange,
    enter_continuous_time_mode: Plain,
    completed_integrator_step: CompletedStep,
    set_time: SetTime,
    set_continuous_states: SetVector,
    get_continuous_states: GetVector,
    get_derivatives: GetVector,
    get_event_indicators: GetVector,
    get_nominals: GetVector,
    count_states: Option<Count>,
    count_indicators: Option<Count>,
}

struct CoSimulation {
    instantiate: InstantiateCoSimulation,
    do_step: DoStep,
    enter_step_mode: Option<Plain>,
    get_output_derivatives: Option<GetOutputDerivatives>,
}

impl Fmi3 {
    /// Looks the functions of one interface up.
    ///
    /// # Safety
    /// The library follows FMI 3.0: a symbol of a name has the type the standard gives it.
    pub(super) unsafe fn load(symbols: &Symbols<'_>, kind: InterfaceKind) -> Result<Self, FmiError> {
        // SAFETY: each name is paired with the signature of the standard's fmi3FunctionTypes; the caller vouches that
        // the library does the same. The pointers stay valid while the `Library` that owns this table is open.
        unsafe {
            let interface = match kind {
                InterfaceKind::ModelExchange => Interface::ModelExchange(ModelExchange {
                    instantiate: symbols.required("fmi3InstantiateModelExchange")?,
                    enter_continuous_time_mode: symbols.required("fmi3EnterContinuousTimeMode")?,
                    completed_integrator_step: symbols.required("fmi3CompletedIntegratorStep")?,
                    set_time: symbols.required("fmi3SetTime")?,
                    set_continuous_states: symbols.required("fmi3SetContinuousStates")?,
                    get_continuous_states: symbols.required("fmi3GetContinuousStates")?,
                    get_derivatives: symbols.required("fmi3GetContinuousStateDerivatives")?,
                    get_event_indicators: symbols.required("fmi3GetEventIndicators")?,
                    get_nominals: symbols.required("fmi3GetNominalsOfContinuousStates")?,
                    count_states: symbols.optional("fmi3GetNumberOfContinuousStates"),
                    count_indicators: symbols.optional("fmi3GetNumberOfEventIndicators"),
                }),
                InterfaceKind::CoSimulation => Interface::CoSimulation(CoSimulation {
                    instantiate: symbols.required("fmi3InstantiateCoSimulation")?,
                    do_step: symbols.required("fmi3DoStep")?,
                    enter_step_mode: symbols.optional("fmi3EnterStepMode"),
                    get_output_derivatives: symbols.optional("fmi3GetOutputDerivatives"),
                }),
            };
            Ok(Self {
                interface,
                free_instance: symbols.required("fmi3FreeInstance")?,
                enter_initialization_mode: symbols.required("fmi3EnterInitializationMode")?,
                exit_initialization_mode: symbols.required("fmi3ExitInitializationMode")?,
                terminate: symbols.required("fmi3Terminate")?,
                get_float64: symbols.required("fmi3GetFloat64")?,
                set_float64: symbols.required("fmi3SetFloat64")?,
                numbers: Numbers::load(symbols),
                get_string: symbols.optional("fmi3GetString"),
                set_string: symbols.optional("fmi3SetString"),
                get_binary: symbols.optional("fmi3GetBinary"),
                set_binary: symbols.optional("fmi3SetBinary"),
                get_clock: symbols.optional("fmi3GetClock"),
                set_clock: symbols.optional("fmi3SetClock"),
                clocks: ClockFunctions::load(symbols),
                reset: symbols.optional("fmi3Reset"),
                set_debug_logging: symbols.optional("fmi3SetDebugLogging"),
                enter_configuration_mode: symbols.optional("fmi3EnterConfigurationMode"),
                exit_configuration_mode: symbols.optional("fmi3ExitConfigurationMode"),
                enter_event_mode: symbols.optional("fmi3EnterEventMode"),
                update_discrete_states: symbols.optional("fmi3UpdateDiscreteStates"),
                get_fmu_state: symbols.optional("fmi3GetFMUState"),
                set_fmu_state: symbols.optional("fmi3SetFMUState"),
                free_fmu_state: symbols.optional("fmi3FreeFMUState"),
                serialized_size: symbols.optional("fmi3SerializedFMUStateSize"),
                serialize: symbols.optional("fmi3SerializeFMUState"),
                deserialize: symbols.optional("fmi3DeserializeFMUState"),
                directional_derivative: symbols.optional("fmi3GetDirectionalDerivative"),
            })
        }
    }
}

/// Calls a mandatory function.
macro_rules! call {
    ($function:expr, $($argument:expr),*) => {
        // SAFETY: the caller's promises are those of the trait.
        status(unsafe { ($function)($($argument),*) })
    };
}

/// Calls an optional function, or says that it is missing.
macro_rules! optional {
    ($function:expr, $($argument:expr),*) => {
        match $function {
            Some(function) => call!(function, $($argument),*),
            None => Status::Missing,
        }
    };
}

/// Calls a function of model exchange.
macro_rules! model {
    ($self:ident, $function:ident, $($argument:expr),*) => {
        match &$self.interface {
            Interface::ModelExchange(functions) => call!(functions.$function, $($argument),*),
            Interface::CoSimulation(_) => Status::Missing,
        }
    };
}

impl Binding for Fmi3 {
    fn name(&self, call: Call) -> &'static str {
        match call {
            Call::Instantiate => match self.interface {
                Interface::ModelExchange(_) => "fmi3InstantiateModelExchange",
                Interface::CoSimulation(_) => "fmi3InstantiateCoSimulation",
            },
            Call::SetDebugLogging => "fmi3SetDebugLogging",
            Call::SetupExperiment | Call::EnterInitialization => "fmi3EnterInitializationMode",
            Call::ExitInitialization => "fmi3ExitInitializationMode",
            Call::Terminate => "fmi3Terminate",
            Call::Reset => "fmi3Reset",
            Call::Get(kind) => get_name(kind),
            Call::Set(kind) => set_name(kind),
            Call::EnterConfiguration => "fmi3EnterConfigurationMode",
            Call::ExitConfiguration => "fmi3ExitConfigurationMode",
            Call::CountStates => "fmi3GetNumberOfContinuousStates",
            Call::CountIndicators => "fmi3GetNumberOfEventIndicators",
            Call::SaveState => "fmi3GetFMUState",
            Call::RestoreState => "fmi3SetFMUState",
            Call::SerializedSize => "fmi3SerializedFMUStateSize",
            Call::Serialize => "fmi3SerializeFMUState",
            Call::Deserialize => "fmi3DeserializeFMUState",
            Call::DirectionalDerivative => "fmi3GetDirectionalDerivative",
            Call::EnterEventMode => "fmi3EnterEventMode",
            Call::NewDiscreteStates => "fmi3UpdateDiscreteStates",
            Call::EnterContinuousTimeMode => "fmi3EnterContinuousTimeMode",
            Call::EnterStepMode => "fmi3EnterStepMode",
            Call::CompletedIntegratorStep => "fmi3CompletedIntegratorStep",
            Call::SetTime => "fmi3SetTime",
            Call::SetContinuousStates => "fmi3SetContinuousStates",
            Call::GetContinuousStates => "fmi3GetContinuousStates",
            Call::GetDerivatives => "fmi3GetContinuousStateDerivatives",
            Call::GetEventIndicators => "fmi3GetEventIndicators",
            Call::GetNominals => "fmi3GetNominalsOfContinuousStates",
            Call::DoStep => "fmi3DoStep",
            // Of FMI 2.0.
            Call::StepStatus | Call::CancelStep => "(pending steps)",
            Call::SetInputDerivatives => "(input derivatives)",
            Call::GetInterval => "fmi3GetInterval",
            Call::GetShift => "fmi3GetShift",
            Call::GetOutputDerivatives => "fmi3GetOutputDerivatives",
        }
    }

    fn has_arrays(&self) -> bool {
        true
    }

    unsafe fn instantiate(&self, request: &Request<'_>, environment: &Environment) -> Option<Created> {
        // FMI 3.0 wants a path, ending in a separator; NULL where there are no resources.
        let mut path = request.resources.to_string_lossy().into_owned();
        path.push(std::path::MAIN_SEPARATOR);
        let resources = CString::new(path).unwrap_or_default();
        let resources = if request.resources.is_dir() { resources.as_ptr() } else { std::ptr::null() };
        let mut keep: Arc<dyn Any + Send + Sync> = Arc::new(());
        let mut environment_of: *mut c_void = std::ptr::from_ref(environment).cast_mut().cast();
        if let Interface::CoSimulation(_) = &self.interface {
            let step_environment = Arc::new(StepEnvironment::new(environment));
            environment_of = Arc::as_ptr(&step_environment).cast_mut().cast();
            keep = step_environment;
        }
        // SAFETY: the strings end in NUL; the environment is kept by the caller until the component is gone.
        let component = unsafe {
            match &self.interface {
                Interface::ModelExchange(functions) => (functions.instantiate)(
                    request.name.as_ptr(),
                    request.guid.as_ptr(),
                    resources,
                    request.visible,
                    request.logging,
                    environment_of,
                    fmi3_log,
                ),
                Interface::CoSimulation(functions) => (functions.instantiate)(
                    request.name.as_ptr(),
                    request.guid.as_ptr(),
                    resources,
                    request.visible,
                    request.logging,
                    request.event_mode,
                    request.early_return,
                    request.intermediate.as_ptr(),
                    request.intermediate.len(),
                    environment_of,
                    fmi3_log,
                    intermediate_update,
                ),
            }
        };
        if component.is_null() { None } else { Some(Created { component, keep }) }
    }

    unsafe fn free_instance(&self, component: Component) {
        // SAFETY: the caller's promises are those of the trait.
        unsafe { (self.free_instance)(component) }
    }

    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status {
        optional!(self.set_debug_logging, component, on, 0, std::ptr::null())
    }

    unsafe fn enter_initialization(&self, component: Component, experiment: &Experiment) -> Status {
        let Experiment { tolerance, start, stop } = *experiment;
        call!(
            self.enter_initialization_mode,
            component,
            tolerance.is_some(),
            tolerance.unwrap_or(0.0),
            start,
            stop.is_some(),
            stop.unwrap_or(0.0)
        )
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
        call!(
            self.get_float64,
            component,
            references.as_ptr(),
            references.len(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Status {
        call!(
            self.set_float64,
            component,
            references.as_ptr(),
            references.len(),
            values.as_ptr(),
            values.len()
        )
    }

    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        let status = match kind {
            VariableKind::Clock => {
                let Some(function) = self.get_clock else { return Status::Missing };
                let (list, n) = (references.as_ptr(), references.len());
                if lanes.len() != n {
                    return Status::Error;
                }
                // SAFETY: the caller's promises are those of the trait; there are as many lanes as references.
                status(packed::get::<Flag>(lanes, |values| unsafe { function(component, list, n, values) }))
            }
            // SAFETY: the same.
            VariableKind::Enumeration => unsafe {
                self.numbers.get(component, VariableKind::Int64, references, lanes)
            },
            // SAFETY: the same.
            kind => unsafe { self.numbers.get(component, kind, references, lanes) },
        };
        if matches!(kind, VariableKind::Boolean | VariableKind::Clock) {
            packed::normalize(lanes);
        }
        status
    }

    unsafe fn set_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        match kind {
            VariableKind::Clock => {
                let Some(function) = self.set_clock else { return Status::Missing };
                let (list, n) = (references.as_ptr(), references.len());
                if lanes.len() != n {
                    return Status::Error;
                }
                // SAFETY: as for getting.
                status(packed::set::<Flag>(lanes, |values| unsafe { function(component, list, n, values) }))
            }
            // SAFETY: as for getting.
            VariableKind::Enumeration => unsafe {
                self.numbers.set(component, VariableKind::Int64, references, lanes)
            },
            // SAFETY: as for getting.
            kind => unsafe { self.numbers.set(component, kind, references, lanes) },
        }
    }

    unsafe fn get_string(
        &self,
        component: Component,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Status {
        optional!(
            self.get_string,
            component,
            references.as_ptr(),
            references.len(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    unsafe fn set_string(
        &self,
        component: Component,
        references: &[u32],
        values: &[*const c_char],
    ) -> Status {
        optional!(
            self.set_string,
            component,
            references.as_ptr(),
            references.len(),
            values.as_ptr(),
            values.len()
        )
    }

    unsafe fn get_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &mut [usize],
        values: &mut [*const u8],
    ) -> Status {
        optional!(
            self.get_binary,
            component,
            references.as_ptr(),
            references.len(),
            sizes.as_mut_ptr(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    unsafe fn set_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &[usize],
        values: &[*const u8],
    ) -> Status {
        optional!(
            self.set_binary,
            component,
            references.as_ptr(),
            references.len(),
            sizes.as_ptr(),
            values.as_ptr(),
            values.len()
        )
    }

    unsafe fn enter_configuration(&self, component: Component) -> Status {
        optional!(self.enter_configuration_mode, component)
    }

    unsafe fn exit_configuration(&self, component: Component) -> Status {
        optional!(self.exit_configuration_mode, component)
    }

    unsafe fn count_states(&self, component: Component, count: &mut usize) -> Status {
        match &self.interface {
            Interface::ModelExchange(functions) => optional!(functions.count_states, component, count),
            Interface::CoSimulation(_) => Status::Missing,
        }
    }

    unsafe fn count_indicators(&self, component: Component, count: &mut usize) -> Status {
        match &self.interface {
            Interface::ModelExchange(functions) => optional!(functions.count_indicators, component, count),
            Interface::CoSimulation(_) => Status::Missing,
        }
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
        optional!(self.serialize, component, state, bytes.as_mut_ptr(), bytes.len())
    }

    unsafe fn deserialize(&self, component: Component, bytes: &[u8], state: &mut StatePointer) -> Status {
        optional!(self.deserialize, component, bytes.as_ptr(), bytes.len(), state)
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
            seed.len(),
            sensitivity.as_mut_ptr(),
            sensitivity.len()
        )
    }

    unsafe fn enter_event_mode(&self, component: Component) -> Status {
        optional!(self.enter_event_mode, component)
    }

    unsafe fn new_discrete_states(&self, component: Component, info: &mut EventInfo) -> Status {
        let (mut again, mut terminate, mut nominals, mut values, mut defined) = (0, 0, 0, 0, 0);
        let mut next = 0.0;
        let status = optional!(
            self.update_discrete_states,
            component,
            &raw mut again,
            &raw mut terminate,
            &raw mut nominals,
            &raw mut values,
            &raw mut defined,
            &raw mut next
        );
        *info = EventInfo {
            new_discrete_states_needed: again != 0,
            terminate: terminate != 0,
            nominals_changed: nominals != 0,
            values_changed: values != 0,
            next_event_time: (defined != 0).then_some(next),
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
        let (mut raw_event, mut raw_terminate): (Flag, Flag) = (0, 0);
        let status = model!(
            self,
            completed_integrator_step,
            component,
            no_set_state_prior,
            &raw mut raw_event,
            &raw mut raw_terminate
        );
        *event = raw_event != 0;
        *terminate = raw_terminate != 0;
        status
    }

    unsafe fn set_time(&self, component: Component, time: f64) -> Status {
        model!(self, set_time, component, time)
    }

    unsafe fn set_continuous_states(&self, component: Component, states: &[f64]) -> Status {
        model!(self, set_continuous_states, component, states.as_ptr(), states.len())
    }

    unsafe fn get_continuous_states(&self, component: Component, states: &mut [f64]) -> Status {
        model!(self, get_continuous_states, component, states.as_mut_ptr(), states.len())
    }

    unsafe fn get_derivatives(&self, component: Component, derivatives: &mut [f64]) -> Status {
        model!(self, get_derivatives, component, derivatives.as_mut_ptr(), derivatives.len())
    }

    unsafe fn get_event_indicators(&self, component: Component, indicators: &mut [f64]) -> Status {
        model!(self, get_event_indicators, component, indicators.as_mut_ptr(), indicators.len())
    }

    unsafe fn get_nominals(&self, component: Component, nominals: &mut [f64]) -> Status {
        model!(self, get_nominals, component, nominals.as_mut_ptr(), nominals.len())
    }

    unsafe fn do_step(&self, component: Component, time: f64, step: f64, info: &mut StepInfo) -> Status {
        let Interface::CoSimulation(functions) = &self.interface else { return Status::Missing };
        let (mut event, mut terminate, mut early): (Flag, Flag, Flag) = (0, 0, 0);
        let mut reached = time;
        let result = call!(
            functions.do_step,
            component,
            time,
            step,
            // The master never goes back behind a communication point.
            true,
            &raw mut event,
            &raw mut terminate,
            &raw mut early,
            &raw mut reached
        );
        info.event = event != 0;
        info.terminate = terminate != 0;
        match result {
            Status::Ok | Status::Warning if early != 0 || terminate != 0 => {
                info.reached = Some(reached);
                Status::Discard
            }
            Status::Discard => {
                info.reached = Some(reached);
                Status::Discard
            }
            other => other,
        }
    }

    unsafe fn do_step_with(
        &self,
        component: Component,
        (time, step): (f64, f64),
        info: &mut StepInfo,
        keep: &(dyn Any + Send + Sync),
        mid_step: &mut dyn MidStep,
    ) -> Status {
        // SAFETY: the caller's promises are those of `do_step`.
        let mut make = || unsafe { self.do_step(component, time, step, info) };
        match keep.downcast_ref::<StepEnvironment>() {
            Some(environment) => environment.during(mid_step, component, self.set_float64, make),
            None => make(),
        }
    }

    unsafe fn step_status(&self, _: Component, _: &mut StepInfo) -> Status {
        Status::Missing
    }

    unsafe fn cancel_step(&self, _: Component) -> Status {
        Status::Missing
    }

    unsafe fn get_interval(
        &self,
        component: Component,
        clock: u32,
        fraction: bool,
        answer: &mut IntervalAnswer,
    ) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        unsafe { self.clocks.interval(component, clock, fraction, answer) }
    }

    unsafe fn get_shift(
        &self,
        component: Component,
        clock: u32,
        fraction: bool,
        shift: &mut Interval,
    ) -> Status {
        // SAFETY: the same.
        unsafe { self.clocks.shift(component, clock, fraction, shift) }
    }

    unsafe fn get_output_derivatives(
        &self,
        component: Component,
        references: &[u32],
        orders: &[c_int],
        values: &mut [f64],
    ) -> Status {
        let Interface::CoSimulation(functions) = &self.interface else { return Status::Missing };
        optional!(
            functions.get_output_derivatives,
            component,
            references.as_ptr(),
            references.len(),
            orders.as_ptr(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    unsafe fn set_input_derivatives(&self, _: Component, _: &[u32], _: &[c_int], _: &[f64]) -> Status {
        Status::Missing
    }

    unsafe fn enter_step_mode(&self, component: Component) -> Status {
        match &self.interface {
            Interface::CoSimulation(functions) => optional!(functions.enter_step_mode, component),
            Interface::ModelExchange(_) => Status::Missing,
        }
    }
}
