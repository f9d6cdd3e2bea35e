//! Functions whose types differ between FMI versions, behind version-independent types.

use super::callbacks::Callbacks;
use super::function::{Answer, call};
use super::functions::Functions;
use super::types::{Component, Direction, EventInfo, Experiment, Request, StepInfo};
use crate::error::Status;
use crate::value::VariableKind;
use std::ffi::{c_char, c_int};

/// Functions of a library whose types differ between FMI versions.
///
/// # Safety
/// For all `unsafe` methods: `component` was created by this library, has not been freed, and has not
/// returned `Fatal`. No other call uses it at the same time. Slices that belong together have the same
/// length. Vectors have the model's sizes. Functions that a library may lack return [`Status::Missing`].
#[allow(clippy::missing_safety_doc)]
pub(super) trait Version: Send + Sync {
    /// Returns the component (NULL if creation failed) and the name of the function. The callbacks must never
    /// be freed, nor used for another live component.
    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> (Component, &'static str);
    /// Switches logging on or off for these categories; an empty list means all categories. FMI 1.0 cannot
    /// select categories.
    unsafe fn set_debug_logging(&self, c: Component, on: bool, categories: &[*const c_char]) -> Answer;
    unsafe fn enter_initialization(&self, f: &Functions, c: Component, experiment: &Experiment) -> Answer;
    /// Ends the initialization. `announced` receives the events that it reported (FMI 1.0).
    unsafe fn exit_initialization(
        &self,
        f: &Functions,
        c: Component,
        experiment: &Experiment,
        announced: &mut Option<EventInfo>,
    ) -> Answer {
        let _ = (experiment, announced);
        call!(f.exit_initialization, c)
    }
    unsafe fn directional_derivative(&self, c: Component, along: Direction<'_>, out: &mut [f64]) -> Answer;
    unsafe fn new_discrete_states(&self, c: Component, info: &mut EventInfo) -> Answer;
    unsafe fn completed_integrator_step(&self, c: Component, no_prior: bool, info: &mut StepInfo) -> Answer;
    /// Performs one communication step from `time`. `is_new` is false for a repetition of the previous
    /// attempt. Returns `Discard` if the step was not computed or was computed only in part, even if the
    /// model ended the simulation. Returns `Pending` if the step is still being computed.
    unsafe fn do_step(&self, f: &Functions, c: Component, step: Step, info: &mut StepInfo) -> Answer;
    /// Returns the name of the function that performs a step.
    fn step_function(&self) -> &'static str;
    /// Returns derivatives (of these orders) of real outputs with respect to time, at the end of the last
    /// step.
    unsafe fn get_output_derivatives(
        &self,
        f: &Functions,
        c: Component,
        refs: &[u32],
        orders: &[c_int],
        values: &mut [f64],
    ) -> Answer {
        let function = f.get_output_derivatives;
        let (list, n) = (refs.as_ptr(), refs.len());
        call!(function, c, list, n, orders.as_ptr(), values.as_mut_ptr())
    }
}

/// Arguments of a communication step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) time: f64,
    pub(super) size: f64,
    pub(super) no_set_state_prior: bool,
    /// False for a repetition of a step of which nothing was computed.
    pub(super) is_new: bool,
}

/// Getters and setters of one library.
///
/// # Safety
/// As for [`Version`].
#[allow(clippy::missing_safety_doc)]
pub(super) trait Values: Send + Sync {
    /// True if a reference may refer to several values. Otherwise, there are as many values as references.
    fn has_arrays(&self) -> bool {
        false
    }
    unsafe fn get_real(&self, c: Component, refs: &[u32], values: &mut [f64]) -> Answer;
    unsafe fn set_real(&self, c: Component, refs: &[u32], values: &[f64]) -> Answer;
    /// Returns values of all other numeric types, as 64-bit words (see `instance/integer_codec.rs`).
    unsafe fn get_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer;
    /// Sets values from 64-bit words, and overwrites the words.
    unsafe fn set_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer;
    unsafe fn get_string(&self, c: Component, refs: &[u32], values: &mut [*const c_char]) -> Answer;
    unsafe fn set_string(&self, component: Component, references: &[u32], values: &[*const c_char])
    -> Answer;
    /// Returns addresses and sizes of binary values. They stay valid until the next call on the component.
    unsafe fn get_binary(
        &self,
        c: Component,
        refs: &[u32],
        sizes: &mut [usize],
        values: &mut [*const u8],
    ) -> Answer {
        let _ = (c, refs, sizes, values);
        NO_SUCH_TYPE
    }
    unsafe fn set_binary(&self, c: Component, refs: &[u32], sizes: &[usize], values: &[*const u8]) -> Answer {
        let _ = (c, refs, sizes, values);
        NO_SUCH_TYPE
    }
}

/// Answer for a type that the version does not have.
pub(super) const NO_SUCH_TYPE: Answer =
    Answer { function: "(variables of this type)", status: Status::Missing };
