//! The unsafe room: everything that touches foreign code or raw pointers, behind safe functions.
//!
//! # Invariants
//!
//! 1. **A library outlives its instances.** A [`RawInstance`] holds an `Arc` of the [`Library`] its functions come
//!    from. The function pointers of a binding are only called through a `Library` that is alive. It is closed only where the
//!    file shows that nothing of it can be called later (destructors of threads, functions that it registered).
//! 2. **One owner per component.** A component pointer lives in exactly one `RawInstance`, is never copied out of
//!    it, and is freed once, on drop. `RawInstance` may move to another thread (`Send`): FMI functions of one
//!    instance may be called from any thread, but not from two at a time (FMI 2.0.x, section 2.1.1); so it is not
//!    `Sync`, and every method takes `&mut self`.
//! 3. **Addresses that an FMU keeps stay put.** What it is given for calling back ([`Callbacks`](callbacks::Callbacks)) is on
//!    the heap (in `Arc`s, whose contents do not move) and not freed while the library is loaded, for threads of an FMU may
//!    outlive its component. It is shared with C code; all that this reaches is a mutex around the log lines, and no foreign code is ever called
//!    while that mutex is held.
//! 4. **Lengths are checked in release builds.** Slices handed to an FMU together with a count have that count, and
//!    vectors of states, derivatives, nominals and indicators have the model's sizes, fixed at instantiation.
//!    A mismatch is a typed error and the FMU is not called.
//! 5. **The state machine of FMI is kept one floor up**: [`Instance`](crate::Instance) makes calls in a wrong phase
//!    a compile-time error. This room relies on it for the FMU's sake, not for memory safety of its own.
//! 6. **After `Fatal` an instance is dead, and with it all others of its loaded copy of the library.** No function is called on any of
//!    them again, not even the one that frees it (FMI 2.0.x, section 2.1.3: all instances are corrupted). What the FMU might still reach (callbacks, environment, library) is leaked.
//! 7. **No panic crosses into C.** The sink of the logger catches unwinding; the rest of the callbacks are C.
//! 8. **Saved states belong to their instance**: pointers stay in a table of the `RawInstance`; the outside holds
//!    tokens that say whose they are. The table is freed with the instance.
//! 9. **What an FMU (or the loading of it) changes in its thread or process** is undone: the floating-point mode after
//!    every call, before any arithmetic of ours; the rest by [`CallEnvironment`].
//! 10. **Buffers of small numbers** are handed out as what an FMU takes them for (`packed.rs`): never more elements than
//!     there are lanes of 64 bits, and only types of which any bits are a value.
//!
//! The versions of FMI stop here: [`Binding`] is one function table in house types, and `fmi1.rs`, `fmi2.rs` and
//! `fmi3.rs` are the only files that know how a version spells it. What has one shape in several versions is bound once,
//! in `functions.rs`. A further version is a further implementation and a line in `library.rs`.
#![allow(unsafe_code)]

mod binding;
mod callbacks;
mod environment;
mod fmi1;
mod fmi2;
mod fmi3;
mod fmi3_clocks;
mod fmi3_functions;
mod fmi3_intermediate;
mod fmi3_numbers;
mod fmi3_values;
mod functions;
mod library;
mod log_lines;
mod packed;
mod platform;
mod raw_instance;
mod shared;

pub(crate) use environment::{CallEnvironment, look_now_and_then};
pub(crate) use library::{Library, LoadFrom};
pub use log_lines::{LogFilter, LogLine};
pub(crate) use raw_instance::{Failed, Fault, RawInstance, SavedSlot, Sizes};
pub(crate) use shared::Shared;

use crate::description::Interval;
use binding::{Binding, Call};
use std::ffi::{CStr, CString, c_void};
use std::fmt;
use std::path::Path;

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
    /// The model returned before the end of the step and goes on from where it got (FMI 3.0).
    pub(crate) early: bool,
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The functions of the standard, without prefix (FMI 1.0 for model exchange and for co-simulation, FMI 2.0.4, FMI 3.0.1).
    const FMI1: &str = "GetModelTypesPlatform GetVersion InstantiateModel FreeModelInstance SetDebugLogging SetTime \
        SetContinuousStates CompletedIntegratorStep SetReal SetInteger SetBoolean SetString Initialize GetDerivatives \
        GetEventIndicators GetReal GetInteger GetBoolean GetString EventUpdate GetContinuousStates \
        GetNominalContinuousStates GetStateValueReferences Terminate GetTypesPlatform InstantiateSlave InitializeSlave \
        TerminateSlave ResetSlave FreeSlaveInstance SetRealInputDerivatives GetRealOutputDerivatives CancelStep DoStep \
        GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus";
    const FMI2: &str = "GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment \
        EnterInitializationMode ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString SetReal \
        SetInteger SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate \
        DeSerializeFMUstate GetDirectionalDerivative EnterEventMode NewDiscreteStates EnterContinuousTimeMode \
        CompletedIntegratorStep SetTime SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates \
        GetNominalsOfContinuousStates SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus \
        GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus";
    const FMI3: &str = "GetVersion SetDebugLogging InstantiateModelExchange InstantiateCoSimulation \
        InstantiateScheduledExecution FreeInstance EnterInitializationMode ExitInitializationMode EnterEventMode Terminate \
        Reset GetFloat32 GetFloat64 GetInt8 GetUInt8 GetInt16 GetUInt16 GetInt32 GetUInt32 GetInt64 GetUInt64 GetBoolean \
        GetString GetBinary GetClock SetFloat32 SetFloat64 SetInt8 SetUInt8 SetInt16 SetUInt16 SetInt32 SetUInt32 SetInt64 \
        SetUInt64 SetBoolean SetString SetBinary SetClock GetNumberOfVariableDependencies GetVariableDependencies \
        GetFMUState SetFMUState FreeFMUState SerializedFMUStateSize SerializeFMUState DeserializeFMUState \
        GetDirectionalDerivative GetAdjointDerivative EnterConfigurationMode ExitConfigurationMode GetIntervalDecimal \
        GetIntervalFraction GetShiftDecimal GetShiftFraction SetIntervalDecimal SetIntervalFraction SetShiftDecimal \
        SetShiftFraction EvaluateDiscreteStates UpdateDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime \
        SetContinuousStates GetContinuousStateDerivatives GetEventIndicators GetContinuousStates \
        GetNominalsOfContinuousStates GetNumberOfEventIndicators GetNumberOfContinuousStates EnterStepMode \
        GetOutputDerivatives DoStep ActivateModelPartition";

    #[test]
    fn functions_are_called_what_the_standard_calls_them() {
        use crate::description::VariableKind::{
            Binary, Boolean, Clock, Enumeration, Float32, Int8, Int16, Int64, Integer, Real, String, UInt8,
            UInt16, UInt32, UInt64,
        };
        let kinds = [
            Real,
            Float32,
            Integer,
            Int8,
            Int16,
            Int64,
            UInt8,
            UInt16,
            UInt32,
            UInt64,
            Boolean,
            String,
            Binary,
            Enumeration,
            Clock,
        ];
        let mut calls = vec![
            Call::Instantiate,
            Call::SetDebugLogging,
            Call::SetupExperiment,
            Call::EnterInitialization,
            Call::ExitInitialization,
            Call::Terminate,
            Call::Reset,
            Call::FreeInstance,
            Call::EnterConfiguration,
            Call::ExitConfiguration,
            Call::CountStates,
            Call::CountIndicators,
            Call::EnterStepMode,
            Call::SaveState,
            Call::RestoreState,
            Call::FreeState,
            Call::SerializedSize,
            Call::Serialize,
            Call::Deserialize,
            Call::DirectionalDerivative,
            Call::EnterEventMode,
            Call::NewDiscreteStates,
            Call::EnterContinuousTimeMode,
            Call::CompletedIntegratorStep,
            Call::SetTime,
            Call::SetContinuousStates,
            Call::GetContinuousStates,
            Call::GetDerivatives,
            Call::GetEventIndicators,
            Call::GetNominals,
            Call::DoStep,
            Call::StepStatus,
            Call::StepRealStatus,
            Call::StepBooleanStatus,
            Call::CancelStep,
            Call::SetInputDerivatives,
            Call::EvaluateDiscreteStates,
            Call::GetOutputDerivatives,
        ];
        calls.extend(kinds.into_iter().flat_map(|kind| [Call::Get(kind), Call::Set(kind)]));
        calls.extend(
            [false, true]
                .into_iter()
                .flat_map(|f| [Call::GetInterval(f), Call::GetShift(f), Call::SetInterval(f)]),
        );
        for kind in [InterfaceKind::ModelExchange, InterfaceKind::CoSimulation] {
            for call in &calls {
                for (name, prefix, known) in [
                    (fmi1::name(kind, *call), "fmi", FMI1),
                    (fmi2::name(*call), "fmi2", FMI2),
                    (fmi3::name(kind, *call), "fmi3", FMI3),
                ] {
                    let is_known = name
                        .strip_prefix(prefix)
                        .is_some_and(|name| known.split_whitespace().any(|known| known == name));
                    assert!(is_known || name.starts_with('('), "{prefix}, {call:?}: {name}");
                }
            }
        }
        assert_eq!(
            fmi1::name(InterfaceKind::CoSimulation, Call::GetOutputDerivatives),
            "fmiGetRealOutputDerivatives"
        );
    }

    #[test]
    fn uris_are_percent_encoded() {
        let uri = |path: &str| file_uri(Path::new(path)).into_string().unwrap();
        assert_eq!(uri("/tmp/a-b_c.d/resources"), "file:///tmp/a-b_c.d/resources");
        assert_eq!(uri("/tmp/a b/{\u{e4}}"), "file:///tmp/a%20b/%7B%C3%A4%7D");
    }
}
