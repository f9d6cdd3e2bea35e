//! The functions of an FMI 3.0 library (FMI 3.0.x, chapters 2, 3 and 4), bound by name.

mod clocks;
mod functions;
mod numbers;
mod values;

use super::binding::Binding;
use super::call::{Call, Values};
use super::callbacks::{Callbacks, fmi3_log};
use super::symbols::Symbols;
use super::types::{
    Component, EventInfo, Experiment, InterfaceKind, IntervalAnswer, Request, StepInfo, status,
};
use crate::description::Interval;
use crate::error::{FmiError, Status};
use crate::sys::functions::{
    Interface, LifeFunctions, Plain, PointFunctions, StateFunctions, Table, call, model, optional, table,
};
use clocks::ClockFunctions;
use functions::{
    CompletedStep, Count, DirectionalDerivative, DoStep, EnterInitialization, Flag, GetOutputDerivatives,
    InstantiateCoSimulation, InstantiateModelExchange, SetDebugLogging, UpdateDiscreteStates,
};
use numbers::{get_name, set_name};
use std::ffi::{CString, c_int, c_void};
use values::Fmi3Values;

/// The functions of one library. The standard demands nearly all of them; FMUs that leave out what they do not need are
/// known, so only what every simulation needs must be there.
pub(super) struct Fmi3 {
    kind: InterfaceKind,
    common: Common,
    life: LifeFunctions,
    states: StateFunctions,
    values: Fmi3Values,
    clocks: ClockFunctions,
    interface: Interface<ModelExchange, CoSimulation, ()>,
}

table! {
    /// What both interfaces have.
    struct Common {
        required {
            enter_initialization_mode: EnterInitialization = Call::EnterInitialization;
            exit_initialization_mode: Plain = Call::ExitInitialization;
        }
        optional {
            set_debug_logging: SetDebugLogging = Call::SetDebugLogging;
            enter_configuration_mode: Plain = Call::EnterConfiguration;
            exit_configuration_mode: Plain = Call::ExitConfiguration;
            enter_event_mode: Plain = Call::EnterEventMode;
            update_discrete_states: UpdateDiscreteStates = Call::NewDiscreteStates;
            directional_derivative: DirectionalDerivative = Call::DirectionalDerivative;
        }
    }
}

table! {
    /// Model exchange.
    struct ModelExchange {
        required {
            instantiate: InstantiateModelExchange = Call::Instantiate;
            enter_continuous_time_mode: Plain = Call::EnterContinuousTimeMode;
            completed_integrator_step: CompletedStep = Call::CompletedIntegratorStep;
        }
        optional {
            count_states: Count = Call::CountStates;
            count_indicators: Count = Call::CountIndicators;
        }
    }
}

table! {
    /// Co-simulation.
    struct CoSimulation {
        required {
            instantiate: InstantiateCoSimulation = Call::Instantiate;
            do_step: DoStep = Call::DoStep;
        }
        optional {
            enter_step_mode: Plain = Call::EnterStepMode;
            get_output_derivatives: GetOutputDerivatives = Call::GetOutputDerivatives;
        }
    }
}

impl Fmi3 {
    /// Looks the functions of one interface up.
    ///
    /// # Safety
    /// The library follows FMI 3.0: a symbol of a name has the type the standard gives it.
    pub(super) unsafe fn load(symbols: &Symbols<'_>, kind: InterfaceKind) -> Result<Self, FmiError> {
        let name = |call| name(kind, call);
        // SAFETY: the caller vouches for the library, and the names are those of FMI 3.0.
        unsafe {
            Ok(Self {
                interface: Interface::load(symbols, kind, name)?,
                kind,
                common: Common::load(symbols, name)?,
                life: LifeFunctions::load(symbols, name)?,
                states: StateFunctions::load(symbols, name)?,
                values: Fmi3Values::load(symbols, name)?,
                clocks: ClockFunctions::load(symbols),
            })
        }
    }
}

/// The standard's names.
pub(super) fn name(kind: InterfaceKind, call: Call) -> &'static str {
    match call {
        Call::Instantiate => match kind {
            InterfaceKind::ModelExchange => "fmi3InstantiateModelExchange",
            InterfaceKind::CoSimulation => "fmi3InstantiateCoSimulation",
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
        Call::GetInterval(false) => "fmi3GetIntervalDecimal",
        Call::GetInterval(true) => "fmi3GetIntervalFraction",
        Call::GetShift(false) => "fmi3GetShiftDecimal",
        Call::GetShift(true) => "fmi3GetShiftFraction",
        Call::SetInterval(false) => "fmi3SetIntervalDecimal",
        Call::SetInterval(true) => "fmi3SetIntervalFraction",
        Call::GetOutputDerivatives => "fmi3GetOutputDerivatives",
        Call::FreeInstance => "fmi3FreeInstance",
        Call::FreeState => "fmi3FreeFMUState",
        other => other.in_brackets(),
    }
}

impl Binding for Fmi3 {
    fn name(&self, call: Call) -> &'static str {
        name(self.kind, call)
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

    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> Component {
        // FMI 3.0 wants a path, ending in a separator; NULL where there are no resources.
        let mut path = request.resources.to_string_lossy().into_owned();
        path.push(std::path::MAIN_SEPARATOR);
        let resources = CString::new(path).unwrap_or_default();
        let resources = if request.resources.is_dir() { resources.as_ptr() } else { std::ptr::null() };
        let environment: *mut c_void = std::ptr::from_ref(callbacks.environment()).cast_mut().cast();
        // SAFETY: the strings end in NUL; the environment is on the heap and never freed.
        unsafe {
            match &self.interface {
                Interface::ModelExchange(functions, _) => (functions.instantiate)(
                    request.name.as_ptr(),
                    request.guid.as_ptr(),
                    resources,
                    request.visible,
                    request.logging,
                    environment,
                    fmi3_log,
                ),
                Interface::CoSimulation(functions, ()) => (functions.instantiate)(
                    request.name.as_ptr(),
                    request.guid.as_ptr(),
                    resources,
                    request.visible,
                    request.logging,
                    request.event_mode,
                    request.early_return,
                    std::ptr::null(),
                    0,
                    environment,
                    fmi3_log,
                    None,
                ),
            }
        }
    }

    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status {
        optional!(self.common.set_debug_logging, component, on, 0, std::ptr::null())
    }

    unsafe fn enter_initialization(&self, component: Component, experiment: &Experiment) -> Status {
        let Experiment { tolerance, start, stop } = *experiment;
        call!(
            self.common.enter_initialization_mode,
            component,
            tolerance.is_some(),
            tolerance.unwrap_or(0.0),
            start,
            stop.is_some(),
            stop.unwrap_or(0.0)
        )
    }

    unsafe fn exit_initialization(&self, component: Component) -> Status {
        call!(self.common.exit_initialization_mode, component)
    }

    unsafe fn enter_configuration(&self, component: Component) -> Status {
        optional!(self.common.enter_configuration_mode, component)
    }

    unsafe fn exit_configuration(&self, component: Component) -> Status {
        optional!(self.common.exit_configuration_mode, component)
    }

    unsafe fn count_states(&self, component: Component, count: &mut usize) -> Status {
        match &self.interface {
            Interface::ModelExchange(functions, _) => optional!(functions.count_states, component, count),
            Interface::CoSimulation(..) => Status::Missing,
        }
    }

    unsafe fn count_indicators(&self, component: Component, count: &mut usize) -> Status {
        match &self.interface {
            Interface::ModelExchange(functions, _) => optional!(functions.count_indicators, component, count),
            Interface::CoSimulation(..) => Status::Missing,
        }
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
            seed.len(),
            sensitivity.as_mut_ptr(),
            sensitivity.len()
        )
    }

    unsafe fn enter_event_mode(&self, component: Component) -> Status {
        optional!(self.common.enter_event_mode, component)
    }

    unsafe fn new_discrete_states(&self, component: Component, info: &mut EventInfo) -> Status {
        let (mut again, mut terminate, mut nominals, mut values, mut defined) = (0, 0, 0, 0, 0);
        let mut next = 0.0;
        let status = optional!(
            self.common.update_discrete_states,
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

    unsafe fn do_step(
        &self,
        component: Component,
        (time, step): (f64, f64),
        no_set_state_prior: bool,
        info: &mut StepInfo,
    ) -> Status {
        let Interface::CoSimulation(functions, ()) = &self.interface else { return Status::Missing };
        let (mut event, mut terminate, mut early): (Flag, Flag, Flag) = (0, 0, 0);
        let mut reached = f64::NAN;
        let result = call!(
            functions.do_step,
            component,
            time,
            step,
            no_set_state_prior,
            &raw mut event,
            &raw mut terminate,
            &raw mut early,
            &raw mut reached
        );
        // Only then do the arguments mean something. After a discard the model stands where it did before (FMI 3.0.x,
        // section 2.2.4), whatever they say.
        if matches!(result, Status::Ok | Status::Warning) {
            info.event = event != 0;
            info.terminate = terminate != 0;
            info.early = early != 0;
            info.reached = ((info.early || info.terminate) && reached.is_finite()).then_some(reached);
        }
        if info.early || info.reached.is_some() { Status::Discard } else { result }
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

    unsafe fn set_interval(&self, component: Component, clock: u32, interval: Interval) -> Status {
        // SAFETY: the same.
        unsafe { self.clocks.set_interval(component, clock, interval) }
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
        let Interface::CoSimulation(functions, ()) = &self.interface else { return Status::Missing };
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

    unsafe fn enter_step_mode(&self, component: Component) -> Status {
        match &self.interface {
            Interface::CoSimulation(functions, ()) => optional!(functions.enter_step_mode, component),
            Interface::ModelExchange(..) => Status::Missing,
        }
    }
}
