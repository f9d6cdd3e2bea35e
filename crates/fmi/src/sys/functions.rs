//! Functions that have one shape in several versions of the standard: their signatures, and tables of those that belong
//! together. What they are called is for each version to say (see [`Binding::name`](super::binding::Binding::name)).

use super::call::{Call, Values};
use super::packed::{self, Element};
use super::symbols::Symbols;
use super::types::{Component, InterfaceKind, StatePointer, StepInfo, status};
use crate::description::VariableKind;
use crate::error::{FmiError, Status};
use std::ffi::{c_char, c_int};

pub(super) type Plain = unsafe extern "C" fn(Component) -> c_int;
pub(super) type Free = unsafe extern "C" fn(Component);
pub(super) type SetTime = unsafe extern "C" fn(Component, f64) -> c_int;
pub(super) type GetVector = unsafe extern "C" fn(Component, *mut f64, usize) -> c_int;
pub(super) type SetVector = unsafe extern "C" fn(Component, *const f64, usize) -> c_int;
type GetState = unsafe extern "C" fn(Component, *mut StatePointer) -> c_int;
type SetState = unsafe extern "C" fn(Component, StatePointer) -> c_int;
type StateSize = unsafe extern "C" fn(Component, StatePointer, *mut usize) -> c_int;
/// FMI 2.0 says `char` for the bytes, FMI 3.0 `uint8_t`.
type SerializeState = unsafe extern "C" fn(Component, StatePointer, *mut u8, usize) -> c_int;
type DeserializeState = unsafe extern "C" fn(Component, *const u8, usize, *mut StatePointer) -> c_int;
type Get<T> = unsafe extern "C" fn(Component, *const u32, usize, *mut T) -> c_int;
type Set<T> = unsafe extern "C" fn(Component, *const u32, usize, *const T) -> c_int;
type AskStatus<T> = unsafe extern "C" fn(Component, c_int, *mut T) -> c_int;
type SetInputDerivatives =
    unsafe extern "C" fn(Component, *const u32, usize, *const c_int, *const f64) -> c_int;
type GetOutputDerivatives =
    unsafe extern "C" fn(Component, *const u32, usize, *const c_int, *mut f64) -> c_int;

/// `fmiStatusKind` and `fmi2StatusKind`.
const DO_STEP_STATUS: c_int = 0;
const LAST_SUCCESSFUL_TIME: c_int = 2;
const TERMINATED: c_int = 3;

/// Calls a function of the library.
macro_rules! call {
    ($function:expr, $($argument:expr),* $(,)?) => {
        // SAFETY: the caller's promises are those of `Binding`.
        status(unsafe { ($function)($($argument),*) })
    };
}
pub(super) use call;

/// Calls a function that the library may lack.
macro_rules! optional {
    ($function:expr, $($argument:expr),* $(,)?) => {
        match $function {
            Some(function) => call!(function, $($argument),*),
            None => Status::Missing,
        }
    };
}
pub(super) use optional;

/// Functions that belong together.
pub(super) trait Table: Sized {
    /// Looks them up under the names that a version has for the calls.
    ///
    /// # Errors
    /// A function that must be there is missing.
    ///
    /// # Safety
    /// The library follows the version of the standard whose names these are: a symbol of a name has the type the standard
    /// gives it.
    unsafe fn load(symbols: &Symbols<'_>, name: impl Fn(Call) -> &'static str) -> Result<Self, FmiError>;
}

/// No functions.
impl Table for () {
    unsafe fn load(_: &Symbols<'_>, _: impl Fn(Call) -> &'static str) -> Result<Self, FmiError> {
        Ok(())
    }
}

/// The functions of the interface by which a model is run: a version's own, and those that several versions share; `S` are
/// the latter of co-simulation.
pub(super) enum Interface<M, C, S = StepFunctions> {
    ModelExchange(M, PointFunctions),
    CoSimulation(C, S),
}

impl<M: Table, C: Table, S: Table> Interface<M, C, S> {
    /// # Errors
    /// A function that must be there is missing.
    ///
    /// # Safety
    /// As for [`Table::load`].
    pub(super) unsafe fn load(
        symbols: &Symbols<'_>,
        kind: InterfaceKind,
        name: impl Fn(Call) -> &'static str,
    ) -> Result<Self, FmiError> {
        // SAFETY: handed on to the caller.
        unsafe {
            Ok(match kind {
                InterfaceKind::ModelExchange => Interface::ModelExchange(
                    Table::load(symbols, &name)?,
                    PointFunctions::load(symbols, &name)?,
                ),
                InterfaceKind::CoSimulation => {
                    Interface::CoSimulation(Table::load(symbols, &name)?, Table::load(symbols, &name)?)
                }
            })
        }
    }
}

impl<M, C, S> Interface<M, C, S> {
    /// In model exchange.
    pub(super) fn point(&self) -> Option<&PointFunctions> {
        match self {
            Interface::ModelExchange(_, point) => Some(point),
            Interface::CoSimulation(..) => None,
        }
    }

    /// In co-simulation.
    pub(super) fn steps(&self) -> Option<&S> {
        match self {
            Interface::ModelExchange(..) => None,
            Interface::CoSimulation(_, steps) => Some(steps),
        }
    }
}

/// Calls a function of a version's own model exchange.
macro_rules! model {
    ($self:ident, $function:ident, $($argument:expr),* $(,)?) => {
        match &$self.interface {
            Interface::ModelExchange(functions, _) => call!(functions.$function, $($argument),*),
            Interface::CoSimulation(..) => Status::Missing,
        }
    };
}
pub(super) use model;

/// A table of functions, and how it is filled.
macro_rules! table {
    (
        $(#[$doc:meta])*
        $vis:vis struct $name:ident {
            required { $($required:ident: $needed:ty = $needed_call:expr;)* }
            optional { $($optional:ident: $offered:ty = $offered_call:expr;)* }
        }
    ) => {
        $(#[$doc])*
        $vis struct $name {
            $($vis $required: $needed,)*
            $($vis $optional: Option<$offered>,)*
        }

        impl Table for $name {
            unsafe fn load(
                symbols: &Symbols<'_>,
                name: impl Fn(Call) -> &'static str,
            ) -> Result<Self, FmiError> {
                // SAFETY: each call is paired with the signature of the standard; the caller vouches that the library
                // does the same. The pointers stay valid while the `Library` that owns the table is open.
                unsafe {
                    Ok(Self {
                        $($required: symbols.required(name($needed_call))?,)*
                        $($optional: symbols.optional(name($offered_call)),)*
                    })
                }
            }
        }
    };
}
pub(super) use table;

table! {
    /// The end of a life and the beginning of the next (all versions).
    pub(super) struct LifeFunctions {
        required {
            free: Free = Call::FreeInstance;
            terminate: Plain = Call::Terminate;
        }
        optional {
            reset: Plain = Call::Reset;
        }
    }
}

table! {
    /// Model exchange: a point, and what the model is there (all versions).
    pub(super) struct PointFunctions {
        required {
            set_time: SetTime = Call::SetTime;
            set_continuous_states: SetVector = Call::SetContinuousStates;
            get_continuous_states: GetVector = Call::GetContinuousStates;
            get_derivatives: GetVector = Call::GetDerivatives;
            get_event_indicators: GetVector = Call::GetEventIndicators;
            get_nominals: GetVector = Call::GetNominals;
        }
        optional {}
    }
}

table! {
    /// Saved states (FMI 2.0 and 3.0).
    pub(super) struct StateFunctions {
        required {}
        optional {
            save: GetState = Call::SaveState;
            restore: SetState = Call::RestoreState;
            free: GetState = Call::FreeState;
            serialized_size: StateSize = Call::SerializedSize;
            serialize: SerializeState = Call::Serialize;
            deserialize: DeserializeState = Call::Deserialize;
        }
    }
}

table! {
    /// What goes with a communication step (FMI 1.0 and 2.0).
    pub(super) struct StepFunctions {
        required {}
        optional {
            cancel: Plain = Call::CancelStep;
            get_status: AskStatus<c_int> = Call::StepStatus;
            get_real_status: AskStatus<f64> = Call::StepRealStatus;
            get_boolean_status: AskStatus<c_int> = Call::StepBooleanStatus;
            set_input_derivatives: SetInputDerivatives = Call::SetInputDerivatives;
            get_output_derivatives: GetOutputDerivatives = Call::GetOutputDerivatives;
        }
    }
}

impl StepFunctions {
    /// How a pending step stands.
    ///
    /// # Safety
    /// As for the methods of [`Binding`](super::binding::Binding).
    pub(super) unsafe fn status(&self, component: Component, info: &mut StepInfo) -> Status {
        let mut code = 0;
        let asked = optional!(self.get_status, component, DO_STEP_STATUS, &raw mut code);
        let status = if asked == Status::Ok { status(code) } else { asked };
        // SAFETY: as for this call.
        unsafe { self.explain(component, status, info) };
        status
    }

    /// Asks what became of a step that was not completed.
    ///
    /// # Safety
    /// As for the methods of [`Binding`](super::binding::Binding).
    pub(super) unsafe fn explain(&self, component: Component, status: Status, info: &mut StepInfo) {
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

/// Getters and setters of FMI 1.0 and 2.0, where a reference stands for one value; `B` is the version's Boolean.
pub(super) struct ValueFunctions<B> {
    get_real: Get<f64>,
    set_real: Set<f64>,
    get_integer: Option<Get<c_int>>,
    set_integer: Option<Set<c_int>>,
    get_boolean: Option<Get<B>>,
    set_boolean: Option<Set<B>>,
    get_string: Option<Get<*const c_char>>,
    set_string: Option<Set<*const c_char>>,
}

/// What must be there are the functions for real variables; `B` must be the version's Boolean.
impl<B: Element> Table for ValueFunctions<B> {
    unsafe fn load(symbols: &Symbols<'_>, name: impl Fn(Call) -> &'static str) -> Result<Self, FmiError> {
        let getter = |kind| name(Call::Get(kind));
        let setter = |kind| name(Call::Set(kind));
        // SAFETY: as for the tables above.
        unsafe {
            Ok(Self {
                get_real: symbols.required(getter(VariableKind::Real))?,
                set_real: symbols.required(setter(VariableKind::Real))?,
                get_integer: symbols.optional(getter(VariableKind::Integer)),
                set_integer: symbols.optional(setter(VariableKind::Integer)),
                get_boolean: symbols.optional(getter(VariableKind::Boolean)),
                set_boolean: symbols.optional(setter(VariableKind::Boolean)),
                get_string: symbols.optional(getter(VariableKind::String)),
                set_string: symbols.optional(setter(VariableKind::String)),
            })
        }
    }
}

impl<B: Element> Values for ValueFunctions<B> {
    unsafe fn get_real(&self, component: Component, references: &[u32], values: &mut [f64]) -> Status {
        call!(self.get_real, component, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Status {
        call!(self.set_real, component, references.as_ptr(), values.len(), values.as_ptr())
    }

    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        let (list, n) = (references.as_ptr(), references.len());
        match (kind, self.get_integer, self.get_boolean) {
            (VariableKind::Integer | VariableKind::Enumeration, Some(function), _) => {
                // SAFETY: the caller's promises; there are as many lanes as references.
                status(packed::get::<c_int>(lanes, |values| unsafe { function(component, list, n, values) }))
            }
            (VariableKind::Boolean, _, Some(function)) => {
                // SAFETY: the same.
                let code = packed::get::<B>(lanes, |values| unsafe { function(component, list, n, values) });
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
        match (kind, self.set_integer, self.set_boolean) {
            (VariableKind::Integer | VariableKind::Enumeration, Some(function), _) => {
                // SAFETY: the caller's promises; there are as many lanes as references.
                status(packed::set::<c_int>(lanes, |values| unsafe { function(component, list, n, values) }))
            }
            (VariableKind::Boolean, _, Some(function)) => {
                // SAFETY: the same.
                status(packed::set::<B>(lanes, |values| unsafe { function(component, list, n, values) }))
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
        optional!(self.get_string, component, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_string(
        &self,
        component: Component,
        references: &[u32],
        values: &[*const c_char],
    ) -> Status {
        optional!(self.set_string, component, references.as_ptr(), values.len(), values.as_ptr())
    }
}
