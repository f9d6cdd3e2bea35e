//! The unsafe room: everything that touches foreign code or raw pointers, behind safe functions.
//!
//! # Invariants
//!
//! 1. **A library outlives its instances.** A [`RawInstance`] holds an `Arc` of the [`Library`] its functions come
//!    from. The function pointers of a binding are only called through a `Library` that is alive, and where threads
//!    may have destructors of the library to run at their end, it is never closed.
//! 2. **One owner per component.** A component pointer lives in exactly one `RawInstance`, is never copied out of
//!    it, and is freed once, on drop. `RawInstance` may move to another thread (`Send`): FMI functions of one
//!    instance may be called from any thread, but not from two at a time (FMI 2.0.x, section 2.1.1); so it is not
//!    `Sync`, and every method takes `&mut self`.
//! 3. **Addresses that an FMU keeps stay put.** The callback structure and the environment it names are on the
//!    heap (in `Arc`s, whose contents do not move) and dropped after the component. The environment is shared with C code that may log from a thread of its own; all
//!    it reaches is a mutex around the log lines, and no foreign code is ever called while that mutex is held.
//! 4. **Lengths are checked in release builds.** Slices handed to an FMU together with a count have that count, and
//!    vectors of states, derivatives, nominals and indicators have the model's sizes, fixed at instantiation.
//!    A mismatch is a typed error and the FMU is not called.
//! 5. **The state machine of FMI is kept one floor up**: [`Instance`](crate::Instance) makes calls in a wrong phase
//!    a compile-time error. This room relies on it for the FMU's sake, not for memory safety of its own.
//! 6. **After `Fatal` an instance is dead, and with it all others of its library.** No function is called on any of
//!    them again, not even the one that frees it (FMI 2.0.x, section 2.1.3: all instances are corrupted). What the FMU might still reach (callbacks, environment, library) is leaked.
//! 7. **No panic crosses into C.** The sink of the logger catches unwinding; the rest of the callbacks are C.
//! 8. **Saved states belong to their instance**: pointers stay in a table of the `RawInstance`; the outside holds
//!    tokens that say whose they are. The table is freed with the instance.
//! 9. **The floating-point environment** that an FMU (or the loading of it) leaves behind is undone by
//!    [`FloatEnvironment`].
//!
//! 10. **Buffers of small numbers** are handed out as what an FMU takes them for (`packed.rs`): never more elements than
//!     there are lanes of 64 bits, and only types of which any bits are a value.
//!
//! The versions of FMI stop here: [`Binding`] is one function table in house types, and `fmi1.rs`, `fmi2.rs` and
//! `fmi3.rs` are the only files that know how a version spells it. A further version is a further implementation and a
//! line in `library.rs`.
#![allow(unsafe_code)]

mod callbacks;
mod fmi1;
mod fmi2;
mod fmi3;
mod fmi3_clocks;
mod fmi3_functions;
mod fmi3_intermediate;
mod fmi3_numbers;
mod library;
mod packed;
mod platform;
mod raw_instance;
mod shared;

pub use callbacks::{LogFilter, LogLine};
pub(crate) use library::Library;
pub(crate) use platform::FloatEnvironment;
pub(crate) use raw_instance::{Failed, Fault, RawInstance, SavedSlot, Sizes};
pub(crate) use shared::{Loan, Shared, Spares};

use crate::description::{Interval, VariableKind};
use callbacks::Environment;
use std::any::Any;
use std::ffi::{CStr, CString, c_char, c_void};
use std::fmt;
use std::path::Path;
use std::sync::Arc;

/// Pointer to a component of an FMU.
type Component = *mut c_void;
/// Pointer to a saved state of a component.
type StatePointer = *mut c_void;

/// What a call into an FMU returned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Status {
    /// Done.
    Ok,
    /// Done, with something to say about it.
    Warning,
    /// Not possible at this point; nothing is broken.
    Discard,
    /// The instance cannot go on; it can be freed or reset.
    Error,
    /// The instance is broken beyond repair.
    Fatal,
    /// Not finished yet (co-simulation only).
    Pending,
    /// The library does not offer the function.
    Missing,
    /// A number that the standard does not know.
    Unknown(i32),
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Status::Ok => f.write_str("ok"),
            Status::Warning => f.write_str("warning"),
            Status::Discard => f.write_str("discard"),
            Status::Error => f.write_str("error"),
            Status::Fatal => f.write_str("fatal"),
            Status::Pending => f.write_str("pending"),
            Status::Missing => f.write_str("that there is no such function"),
            Status::Unknown(code) => write!(f, "the unknown status {code}"),
        }
    }
}

/// The numbers of `fmiStatus`, which all versions share (1.0 for model exchange and 3.0 have no `Pending`).
fn status(code: std::ffi::c_int) -> Status {
    match code {
        0 => Status::Ok,
        1 => Status::Warning,
        2 => Status::Discard,
        3 => Status::Error,
        4 => Status::Fatal,
        5 => Status::Pending,
        other => Status::Unknown(other),
    }
}

/// `file:///...` with everything but unreserved characters percent-encoded (RFC 3986), as FMI 1.0 and 2.0 ask.
fn file_uri(path: &Path) -> CString {
    let mut uri = String::from("file://");
    let text = path.to_string_lossy().replace(std::path::MAIN_SEPARATOR, "/");
    if !text.starts_with('/') {
        uri.push('/');
    }
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"/-._~:".contains(&byte) {
            uri.push(char::from(byte));
        } else {
            uri.push_str(&format!("%{byte:02X}"));
        }
    }
    CString::new(uri).unwrap_or_default()
}

/// The calls, in house words; [`Binding::name`] gives the standard's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Call {
    Instantiate,
    SetDebugLogging,
    SetupExperiment,
    EnterInitialization,
    ExitInitialization,
    Terminate,
    Reset,
    Get(VariableKind),
    Set(VariableKind),
    EnterConfiguration,
    ExitConfiguration,
    CountStates,
    CountIndicators,
    EnterStepMode,
    SaveState,
    RestoreState,
    SerializedSize,
    Serialize,
    Deserialize,
    DirectionalDerivative,
    EnterEventMode,
    NewDiscreteStates,
    EnterContinuousTimeMode,
    CompletedIntegratorStep,
    SetTime,
    SetContinuousStates,
    GetContinuousStates,
    GetDerivatives,
    GetEventIndicators,
    GetNominals,
    DoStep,
    StepStatus,
    CancelStep,
    SetInputDerivatives,
    GetInterval,
    GetShift,
    GetOutputDerivatives,
}

/// What an event iteration told.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct EventInfo {
    /// Another iteration is wanted.
    pub(crate) new_discrete_states_needed: bool,
    /// The model wishes to end the simulation.
    pub(crate) terminate: bool,
    /// The nominals of the states have changed.
    pub(crate) nominals_changed: bool,
    /// The continuous states have changed.
    pub(crate) values_changed: bool,
    /// The next time event.
    pub(crate) next_event_time: Option<f64>,
}

/// What a model says about the interval before the next tick of a clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct IntervalAnswer {
    pub(crate) qualifier: Qualifier,
    pub(crate) interval: Interval,
}

/// How an interval is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Qualifier {
    NotYetKnown,
    /// As told before.
    Unchanged,
    Changed,
}

/// The two ways of running a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum InterfaceKind {
    /// The importer integrates the model.
    ModelExchange,
    /// The model brings its own solver and is asked to step from one communication point to the next.
    CoSimulation,
}

impl fmt::Display for InterfaceKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            InterfaceKind::ModelExchange => "model exchange",
            InterfaceKind::CoSimulation => "co-simulation",
        })
    }
}

/// What a communication step told.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct StepInfo {
    /// How far the model got, where that is not the end of the step (or not known to be).
    pub(crate) reached: Option<f64>,
    /// The model wishes to end the simulation.
    pub(crate) terminate: bool,
    /// The model knows how far it got but has no word for the end of a simulation: it may have meant that.
    pub(crate) may_have_ended: bool,
    /// The model wants to enter event mode.
    pub(crate) event: bool,
    /// The step is still being computed.
    pub(crate) pending: bool,
}

/// A model calls back during a communication step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Update {
    /// Where the model stands.
    pub(crate) time: f64,
    /// It takes new values of continuous inputs.
    pub(crate) set_requested: bool,
}

/// What an importer does when a model calls back during a communication step, maybe on another thread.
pub(crate) trait MidStep: Send {
    /// May set real inputs (value references and values); returns whether the step is to end here, if that can be.
    fn update(&mut self, update: &Update, set: &mut dyn FnMut(&[u32], &[f64])) -> bool;
}

/// Nothing is done then.
impl MidStep for () {
    fn update(&mut self, _: &Update, _: &mut dyn FnMut(&[u32], &[f64])) -> bool {
        false
    }
}

/// A live component and what it needs to stay alive.
struct Created {
    component: Component,
    /// Structures whose address the FMU was given.
    keep: Arc<dyn Any + Send + Sync>,
}

/// What an instance is made with.
#[derive(Debug)]
pub(crate) struct Request<'a> {
    pub(crate) name: &'a CStr,
    pub(crate) guid: &'a CStr,
    pub(crate) resources: &'a Path,
    pub(crate) kind: InterfaceKind,
    /// Co-simulation: events are handled between steps, and a step may end early at one.
    pub(crate) event_mode: bool,
    pub(crate) early_return: bool,
    /// Inputs that are set during steps.
    pub(crate) intermediate: &'a [u32],
    pub(crate) visible: bool,
    pub(crate) logging: bool,
    pub(crate) log_filter: LogFilter,
}

/// What an experiment is set up with.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Experiment {
    pub(crate) tolerance: Option<f64>,
    pub(crate) start: f64,
    pub(crate) stop: Option<f64>,
}

/// The function table of one library in house types: what a version of FMI has to supply.
///
/// # Safety
/// For all `unsafe` methods: `component` was made by this binding, is not freed and not dead, and no other call on
/// it is under way; slices that belong together have the same length; vectors have the model's sizes.
/// Functions that a library may lack answer [`Status::Missing`].
#[allow(clippy::missing_safety_doc)]
trait Binding: Send + Sync {
    fn name(&self, call: Call) -> &'static str;
    unsafe fn instantiate(&self, request: &Request<'_>, environment: &Environment) -> Option<Created>;
    unsafe fn free_instance(&self, component: Component);
    unsafe fn set_debug_logging(&self, component: Component, on: bool) -> Status;
    /// Before the initialization, where a version has a call for it.
    unsafe fn setup_experiment(&self, component: Component, experiment: &Experiment) -> Status {
        let _ = (component, experiment);
        Status::Ok
    }
    unsafe fn enter_initialization(&self, component: Component, experiment: &Experiment) -> Status;
    unsafe fn exit_initialization(&self, component: Component) -> Status;
    unsafe fn terminate(&self, component: Component) -> Status;
    unsafe fn reset(&self, component: Component) -> Status;
    /// Whether a reference may stand for several values. If not, there are as many values as references.
    fn has_arrays(&self) -> bool {
        false
    }
    unsafe fn get_real(&self, component: Component, references: &[u32], values: &mut [f64]) -> Status;
    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Status;
    /// Values of all other kinds of numbers, in lanes (see `lanes.rs`).
    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status;
    /// The lanes are used up.
    unsafe fn set_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status;
    unsafe fn get_string(
        &self,
        component: Component,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Status;
    unsafe fn set_string(&self, component: Component, references: &[u32], values: &[*const c_char])
    -> Status;
    /// Addresses and sizes of binary values; they stay valid until the next call on the component.
    unsafe fn get_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &mut [usize],
        values: &mut [*const u8],
    ) -> Status {
        let _ = (component, references, sizes, values);
        Status::Missing
    }
    unsafe fn set_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &[usize],
        values: &[*const u8],
    ) -> Status {
        let _ = (component, references, sizes, values);
        Status::Missing
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
        let _ = (component, state);
        Status::Missing
    }
    unsafe fn restore_state(&self, component: Component, state: StatePointer) -> Status {
        let _ = (component, state);
        Status::Missing
    }
    unsafe fn free_state(&self, component: Component, state: &mut StatePointer) -> Status {
        let _ = (component, state);
        Status::Missing
    }
    unsafe fn serialized_size(&self, component: Component, state: StatePointer, size: &mut usize) -> Status {
        let _ = (component, state, size);
        Status::Missing
    }
    unsafe fn serialize(&self, component: Component, state: StatePointer, bytes: &mut [u8]) -> Status {
        let _ = (component, state, bytes);
        Status::Missing
    }
    unsafe fn deserialize(&self, component: Component, bytes: &[u8], state: &mut StatePointer) -> Status {
        let _ = (component, bytes, state);
        Status::Missing
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
    unsafe fn set_time(&self, component: Component, time: f64) -> Status;
    unsafe fn set_continuous_states(&self, component: Component, states: &[f64]) -> Status;
    unsafe fn get_continuous_states(&self, component: Component, states: &mut [f64]) -> Status;
    unsafe fn get_derivatives(&self, component: Component, derivatives: &mut [f64]) -> Status;
    /// Time, states and derivatives: the calls of a right-hand side in one, up to the first that fails.
    unsafe fn right_hand_side(
        &self,
        component: Component,
        time: f64,
        states: &[f64],
        derivatives: &mut [f64],
    ) -> (Call, Status) {
        let is_good = |status| matches!(status, Status::Ok | Status::Warning);
        // SAFETY: the caller's promises are those of the three functions.
        unsafe {
            let status = self.set_time(component, time);
            if !is_good(status) {
                return (Call::SetTime, status);
            }
            let status = self.set_continuous_states(component, states);
            if !is_good(status) {
                return (Call::SetContinuousStates, status);
            }
            (Call::GetDerivatives, self.get_derivatives(component, derivatives))
        }
    }
    unsafe fn get_event_indicators(&self, component: Component, indicators: &mut [f64]) -> Status;
    unsafe fn get_nominals(&self, component: Component, nominals: &mut [f64]) -> Status;
    /// One communication step. `Discard` is for steps of which nothing or only a part was computed, also because the
    /// model ends the simulation; `Pending` for steps that go on.
    unsafe fn do_step(&self, component: Component, time: f64, step: f64, info: &mut StepInfo) -> Status;
    /// The same for models that call back during the step; `keep` is what was made with the component.
    unsafe fn do_step_with(
        &self,
        component: Component,
        (time, step): (f64, f64),
        info: &mut StepInfo,
        keep: &(dyn Any + Send + Sync),
        mid_step: &mut dyn MidStep,
    ) -> Status {
        let _ = (keep, mid_step);
        // SAFETY: the caller's promises are those of `do_step`.
        unsafe { self.do_step(component, time, step, info) }
    }
    /// How a pending step stands; as for `do_step`.
    unsafe fn step_status(&self, component: Component, info: &mut StepInfo) -> Status;
    unsafe fn cancel_step(&self, component: Component) -> Status;
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
        let _ = (component, references, orders, values);
        Status::Missing
    }
    /// Derivatives (of these orders) of real inputs with respect to time.
    unsafe fn set_input_derivatives(
        &self,
        component: Component,
        references: &[u32],
        orders: &[i32],
        values: &[f64],
    ) -> Status;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_are_percent_encoded() {
        let uri = |path: &str| file_uri(Path::new(path)).into_string().unwrap();
        assert_eq!(uri("/tmp/a-b_c.d/resources"), "file:///tmp/a-b_c.d/resources");
        assert_eq!(uri("/tmp/a b/{\u{e4}}"), "file:///tmp/a%20b/%7B%C3%A4%7D");
    }
}
