//! What a version of FMI has to supply: its functions in house types, and the names it has for them.

use super::call::{Call, Values};
use super::callbacks::{Callbacks, Current};
use super::environment::restore_default;
use super::functions::{LifeFunctions, PointFunctions, StateFunctions, StepFunctions, call, optional};
use super::types::{
    Component, EventInfo, Experiment, IntervalAnswer, Request, StatePointer, StepInfo, status,
};
use crate::description::{Interval, VariableKind};
use crate::error::Status;
use std::ffi::c_char;

/// Methods that do what those of [`Values`] of the same names do, with the FMU's own component.
macro_rules! entered {
    ($($name:ident($($argument:ident: $type:ty),*);)*) => {$(
        unsafe fn $name(&self, component: Component, $($argument: $type),*) -> Status {
            // SAFETY: the caller's promises are those of the trait.
            unsafe {
                let (component, _current) = self.enter(component);
                self.values().$name(component, $($argument),*)
            }
        }
    )*};
}

/// Calls a function of a table that the binding may not have.
macro_rules! of {
    ($self:ident, $table:ident, $function:ident, $component:ident $(, $argument:expr)*) => {{
        let Some(functions) = $self.$table() else { return Status::Missing };
        // SAFETY: the caller's promises are those of the trait.
        let (component, _current) = unsafe { $self.enter($component) };
        call!(functions.$function, component $(, $argument)*)
    }};
}

/// The same for a function that a library may lack.
macro_rules! optional_of {
    ($self:ident, $table:ident, $function:ident, $component:ident $(, $argument:expr)*) => {{
        let Some(functions) = $self.$table() else { return Status::Missing };
        // SAFETY: the caller's promises are those of the trait.
        let (component, _current) = unsafe { $self.enter($component) };
        optional!(functions.$function, component $(, $argument)*)
    }};
}

/// The function table of one library in house types: what a version of FMI has to supply.
///
/// # Safety
/// For all `unsafe` methods: `component` was made by this binding, is not freed and not dead, and no other call on
/// it is under way; slices that belong together have the same length; vectors have the model's sizes.
/// Functions that a library may lack answer [`Status::Missing`].
#[allow(clippy::missing_safety_doc)]
pub(super) trait Binding: Send + Sync {
    fn name(&self, call: Call) -> &'static str;
    /// The FMU's own component, and what has to live while it is called.
    unsafe fn enter(&self, component: Component) -> (Component, Option<Current>) {
        (component, None)
    }
    fn life(&self) -> &LifeFunctions;
    /// In model exchange.
    fn point(&self) -> Option<&PointFunctions>;
    fn states(&self) -> Option<&StateFunctions> {
        None
    }
    /// In co-simulation.
    fn steps(&self) -> Option<&StepFunctions> {
        None
    }
    /// The callbacks must never be freed, nor used for another live component. NULL: refused.
    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> Component;
    unsafe fn free_instance(&self, component: Component) {
        // SAFETY: the caller's promises are those of the trait.
        unsafe { (self.life().free)(component) }
    }
    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status;
    /// Before the initialization, where a version has a call for it.
    unsafe fn setup_experiment(&self, component: Component, experiment: &Experiment) -> Status {
        let _ = (component, experiment);
        Status::Ok
    }
    unsafe fn enter_initialization(&self, component: Component, experiment: &Experiment) -> Status;
    unsafe fn exit_initialization(&self, component: Component) -> Status;
    unsafe fn terminate(&self, component: Component) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        let (component, _current) = unsafe { self.enter(component) };
        call!(self.life().terminate, component)
    }
    unsafe fn reset(&self, component: Component) -> Status {
        // SAFETY: the caller's promises are those of the trait.
        let (component, _current) = unsafe { self.enter(component) };
        optional!(self.life().reset, component)
    }
    fn values(&self) -> &dyn Values;
    entered! {
        get_real(references: &[u32], values: &mut [f64]);
        set_real(references: &[u32], values: &[f64]);
        get_packed(kind: VariableKind, references: &[u32], lanes: &mut [i64]);
        set_packed(kind: VariableKind, references: &[u32], lanes: &mut [i64]);
        get_string(references: &[u32], values: &mut [*const c_char]);
        set_string(references: &[u32], values: &[*const c_char]);
        get_binary(references: &[u32], sizes: &mut [usize], values: &mut [*const u8]);
        set_binary(references: &[u32], sizes: &[usize], values: &[*const u8]);
    }
    unsafe fn enter_configuration(&self, component: Component) -> Status {
        let _ = component;
        Status::Missing
    }
    unsafe fn exit_configuration(&self, component: Component) -> Status {
        let _ = component;
        Status::Missing
    }
    /// Number of continuous states, where it can change.
    unsafe fn count_states(&self, component: Component, count: &mut usize) -> Status {
        let _ = (component, count);
        Status::Missing
    }
    /// Number of event indicators, where it can change.
    unsafe fn count_indicators(&self, component: Component, count: &mut usize) -> Status {
        let _ = (component, count);
        Status::Missing
    }
    unsafe fn save_state(&self, component: Component, state: &mut StatePointer) -> Status {
        optional_of!(self, states, save, component, state)
    }
    unsafe fn restore_state(&self, component: Component, state: StatePointer) -> Status {
        optional_of!(self, states, restore, component, state)
    }
    unsafe fn free_state(&self, component: Component, state: &mut StatePointer) -> Status {
        optional_of!(self, states, free, component, state)
    }
    unsafe fn serialized_size(&self, component: Component, state: StatePointer, size: &mut usize) -> Status {
        optional_of!(self, states, serialized_size, component, state, size)
    }
    unsafe fn serialize(&self, component: Component, state: StatePointer, bytes: &mut [u8]) -> Status {
        optional_of!(self, states, serialize, component, state, bytes.as_mut_ptr(), bytes.len())
    }
    unsafe fn deserialize(&self, component: Component, bytes: &[u8], state: &mut StatePointer) -> Status {
        optional_of!(self, states, deserialize, component, bytes.as_ptr(), bytes.len(), state)
    }
    unsafe fn directional_derivative(
        &self,
        component: Component,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Status {
        let _ = (component, unknowns, knowns, seed, sensitivity);
        Status::Missing
    }
    unsafe fn enter_event_mode(&self, component: Component) -> Status;
    unsafe fn new_discrete_states(&self, component: Component, info: &mut EventInfo) -> Status;
    unsafe fn enter_continuous_time_mode(&self, component: Component) -> Status;
    unsafe fn completed_integrator_step(
        &self,
        component: Component,
        no_set_state_prior: bool,
        event: &mut bool,
        terminate: &mut bool,
    ) -> Status;
    unsafe fn set_time(&self, component: Component, time: f64) -> Status {
        of!(self, point, set_time, component, time)
    }
    unsafe fn set_continuous_states(&self, component: Component, states: &[f64]) -> Status {
        of!(self, point, set_continuous_states, component, states.as_ptr(), states.len())
    }
    unsafe fn get_continuous_states(&self, component: Component, states: &mut [f64]) -> Status {
        of!(self, point, get_continuous_states, component, states.as_mut_ptr(), states.len())
    }
    unsafe fn get_derivatives(&self, component: Component, derivatives: &mut [f64]) -> Status {
        of!(self, point, get_derivatives, component, derivatives.as_mut_ptr(), derivatives.len())
    }
    /// Time, states and derivatives: the calls of a right-hand side in one, up to the first that fails. With `looks`, each
    /// starts in the default floating-point mode if the first does, and whether one has changed it is entered there.
    unsafe fn right_hand_side(
        &self,
        component: Component,
        time: f64,
        states: &[f64],
        derivatives: &mut [f64],
        mut looks: Option<&mut bool>,
    ) -> (Call, Status) {
        let mut look = || {
            if let Some(is_changed) = looks.as_deref_mut() {
                *is_changed |= restore_default();
            }
        };
        let is_good = |status| matches!(status, Status::Ok | Status::Warning);
        // SAFETY: the caller's promises are those of the three functions.
        unsafe {
            let status = self.set_time(component, time);
            if !is_good(status) {
                return (Call::SetTime, status);
            }
            look();
            let status = self.set_continuous_states(component, states);
            if !is_good(status) {
                return (Call::SetContinuousStates, status);
            }
            look();
            (Call::GetDerivatives, self.get_derivatives(component, derivatives))
        }
    }
    unsafe fn get_event_indicators(&self, component: Component, indicators: &mut [f64]) -> Status {
        of!(self, point, get_event_indicators, component, indicators.as_mut_ptr(), indicators.len())
    }
    unsafe fn get_nominals(&self, component: Component, nominals: &mut [f64]) -> Status {
        of!(self, point, get_nominals, component, nominals.as_mut_ptr(), nominals.len())
    }
    /// One communication step. `Discard` is for steps of which nothing or only a part was computed, also because the
    /// model ends the simulation; `Pending` for steps that go on.
    unsafe fn do_step(
        &self,
        component: Component,
        span: (f64, f64),
        no_set_state_prior: bool,
        info: &mut StepInfo,
    ) -> Status;
    /// How a pending step stands; as for `do_step`.
    unsafe fn step_status(&self, component: Component, info: &mut StepInfo) -> Status {
        let Some(functions) = self.steps() else { return Status::Missing };
        // SAFETY: the caller's promises are those of the trait.
        unsafe {
            let (component, _current) = self.enter(component);
            functions.status(component, info)
        }
    }
    unsafe fn cancel_step(&self, component: Component) -> Status {
        optional_of!(self, steps, cancel, component)
    }
    /// Back from event mode (co-simulation).
    unsafe fn enter_step_mode(&self, component: Component) -> Status {
        let _ = component;
        Status::Missing
    }
    /// The interval before the next tick of a clock, as a fraction or not.
    unsafe fn get_interval(
        &self,
        component: Component,
        clock: u32,
        fraction: bool,
        answer: &mut IntervalAnswer,
    ) -> Status {
        let _ = (component, clock, fraction, answer);
        Status::Missing
    }
    /// Gives a clock an interval.
    unsafe fn set_interval(&self, component: Component, clock: u32, interval: Interval) -> Status {
        let _ = (component, clock, interval);
        Status::Missing
    }
    /// From the start to the first tick of a clock.
    unsafe fn get_shift(
        &self,
        component: Component,
        clock: u32,
        fraction: bool,
        shift: &mut Interval,
    ) -> Status {
        let _ = (component, clock, fraction, shift);
        Status::Missing
    }
    /// Derivatives (of these orders) of real outputs with respect to time, at the end of the last step.
    unsafe fn get_output_derivatives(
        &self,
        component: Component,
        references: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> Status {
        let (list, n) = (references.as_ptr(), references.len());
        optional_of!(
            self,
            steps,
            get_output_derivatives,
            component,
            list,
            n,
            orders.as_ptr(),
            values.as_mut_ptr()
        )
    }
    /// Derivatives (of these orders) of real inputs with respect to time.
    unsafe fn set_input_derivatives(
        &self,
        component: Component,
        references: &[u32],
        orders: &[i32],
        values: &[f64],
    ) -> Status {
        let (list, n) = (references.as_ptr(), references.len());
        optional_of!(self, steps, set_input_derivatives, component, list, n, orders.as_ptr(), values.as_ptr())
    }
}
