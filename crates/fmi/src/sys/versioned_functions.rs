//! Functions whose types differ between the versions of FMI, behind types that do not depend on the version.

use super::callbacks::Callbacks;
use super::function::{Answer, call};
use super::functions::Functions;
use super::types::{Component, Direction, EventInfo, Experiment, Request, StepInfo};
use crate::error::Status;
use crate::value::VariableKind;
use std::ffi::{c_char, c_int};

/// The functions of one library whose types differ between the versions of FMI.
///
/// # Safety
/// For all `unsafe` methods: `component` was made by this library, is not freed and not dead, and no other
/// call on it is under way; slices that belong together have the same length; vectors have the model's sizes.
/// Functions that a library may lack answer [`Status::Missing`].
#[allow(clippy::missing_safety_doc)]
pub(super) trait Version: Send + Sync {
    /// The component, NULL if it was refused, and the name of the function. The callbacks must never be
    /// freed, nor used for another live component.
    unsafe fn instantiate(&self, request: &Request<'_>, callbacks: &Callbacks) -> (Component, &'static str);
    /// Messages of these categories; of all, if there are none. FMI 1.0 has no choice of categories.
    unsafe fn set_debug_logging(&self, c: Component, on: bool, categories: &[*const c_char]) -> Answer;
    unsafe fn enter_initialization(&self, f: &Functions, c: Component, experiment: &Experiment) -> Answer;
    /// `announced`: what the initialization has already said about events (FMI 1.0).
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
    /// One communication step from `time` on; `is_new`: not the one tried last. `Discard` is for steps of
    /// which nothing or only a part was computed, also because the model ends the simulation; `Pending` for
    /// steps that go on.
    unsafe fn do_step(&self, f: &Functions, c: Component, step: Step, info: &mut StepInfo) -> Answer;
    /// Name of the function that makes a step.
    fn step_function(&self) -> &'static str;
    /// Derivatives (of these orders) of real outputs with respect to time, at the end of the last step.
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

/// A communication step as it is asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) time: f64,
    pub(super) size: f64,
    pub(super) no_set_state_prior: bool,
    /// Not one that is tried again because nothing of it was computed.
    pub(super) is_new: bool,
}

/// Getters and setters of one library.
///
/// # Safety
/// As for [`Version`].
#[allow(clippy::missing_safety_doc)]
pub(super) trait Values: Send + Sync {
    /// True if a reference may stand for several values. If not, there are as many values as references.
    fn has_arrays(&self) -> bool {
        false
    }
    unsafe fn get_real(&self, c: Component, refs: &[u32], values: &mut [f64]) -> Answer;
    unsafe fn set_real(&self, c: Component, refs: &[u32], values: &[f64]) -> Answer;
    /// Values of all other kinds of numbers, in words of 64 bits (see `instance/integer_codec.rs`).
    unsafe fn get_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer;
    /// The words are used up.
    unsafe fn set_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer;
    unsafe fn get_string(&self, c: Component, refs: &[u32], values: &mut [*const c_char]) -> Answer;
    unsafe fn set_string(&self, component: Component, references: &[u32], values: &[*const c_char])
    -> Answer;
    /// Addresses and sizes of binary values; they stay valid until the next call on the component.
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

/// The version has no variables of a type.
pub(super) const NO_SUCH_TYPE: Answer =
    Answer { function: "(variables of this type)", status: Status::Missing };
