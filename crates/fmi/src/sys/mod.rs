//! All code that touches foreign code or raw pointers, behind safe functions.
//!
//! # Invariants
//!
//! 1. **A library outlives its instances.** A [`RawInstance`] has an `Arc` of the [`Library`] that provides
//!    its functions. The function pointers of a binding are only called through a `Library` that is alive. A
//!    library is never closed, because its code may be called later (destructors of threads, functions that
//!    it registered).
//! 2. **One owner per component.** A component pointer is in exactly one `RawInstance` and is never copied
//!    out of it. It is freed once, on drop. `RawInstance` may move to another thread (`Send`). FMI functions
//!    of one instance may be called from any thread, but not from two at a time (FMI 2.0.x, section 2.1.1).
//!    `RawInstance` is therefore not `Sync`, and every method takes `&mut self`.
//! 3. **Addresses that an FMU keeps do not change.** The data for callbacks
//!    ([`Callbacks`](callbacks::Callbacks)) are on the heap (in `Arc`s, whose contents do not move). They are
//!    never freed, because threads of an FMU may outlive its component and its destructors may log. C code
//!    shares these data, but reaches only a mutex around the log lines. No foreign code is called while that
//!    mutex is locked.
//! 4. **Lengths are checked in release builds.** Slices passed to an FMU together with a count have that
//!    count. Vectors of states, derivatives, nominals and indicators have the model's sizes, fixed at
//!    instantiation. A mismatch is a typed error and the FMU is not called.
//! 5. **The layer above enforces the state machine of FMI**: [`Instance`](crate::Instance) makes calls in a
//!    wrong phase a compile-time error. This module relies on it for correct use of the FMU, not for its own
//!    memory safety.
//! 6. **After `Fatal` an instance is unusable, and so are all others of its loaded copy of the library.** No
//!    function of them is called again, not even the function that frees an instance (FMI 2.0.x, section
//!    2.1.3: all instances are corrupted). Data that the FMU might still reach (callbacks, environment,
//!    library) are leaked.
//! 7. **No panic crosses into C.** The sink of the logger catches unwinding. The rest of the callbacks is C
//!    code.
//! 8. **Saved states belong to their instance**: pointers stay in a table of the `RawInstance`. The caller
//!    receives tokens that identify their owner. The table is freed with the instance.
//! 9. **A run starts in the default floating-point mode**, regardless of earlier changes on the same thread.
//!    The loading of an FMU or an earlier run may have changed the mode. [`Inside`] restores the previous
//!    mode. One thread at a time is inside a loaded library, for a call or for a whole run.
//! 10. **Buffers of small numbers** are passed with the element type that the FMU expects
//!     (`packed_integers.rs`). There are never more elements than 64-bit words, and any bits are a valid
//!     value of these types.
//!
//! Other modules do not depend on the version of FMI. Functions with one type in several versions are in the
//! tables of `functions.rs`, with their names. All others are in [`Version`](versioned_functions::Version),
//! with version-independent types. Only `fmi1.rs`, `fmi2.rs` and `fmi3/` contain the declarations of a
//! version. A new version requires a column of the tables, an implementation, and a line in `library.rs`.
#![allow(unsafe_code)]

mod before_main;
mod callbacks;
mod environment;
mod fmi1;
mod fmi1_fmi2_values;
mod fmi2;
mod fmi3;
mod function;
mod functions;
mod library;
mod packed_integers;
mod platform;
mod raw_instance;
mod shared_page;
mod symbols;
mod types;
#[cfg(unix)]
pub(crate) mod unix;
mod versioned_functions;
#[cfg(windows)]
pub(crate) mod windows;
mod worker_state;

#[cfg(target_os = "linux")]
pub use before_main::is_loaded_to_serve;
pub(crate) use before_main::{PRELOAD, PRELOADED_BEFORE};
pub(crate) use environment::{Inside, set_float_mode};
pub(crate) use library::{Library, LoadFrom};
pub use platform::LoaderOptions;
pub(crate) use raw_instance::{Fault, RawInstance, SavedSlot, Sizes};
pub(crate) use shared_page::{Page, is_worker, note_run, note_start};
pub(crate) use types::{Direction, EventInfo, Experiment, IntervalAnswer, Qualifier, Request, StepInfo};
pub use types::{ElementDependency, InterfaceKind};
#[cfg(unix)]
pub(crate) use unix::limit_compiler;
pub(crate) use worker_state::{
    REFUSED, forget_refusal, has_kept_instances, instance_suffix, refusal, set_avoided_calls, set_confined,
    set_instance_suffix,
};

/// Sets no limits, which this system does not support.
#[cfg(not(unix))]
pub(crate) fn limit_compiler(_: &mut std::process::Command, _: std::time::Duration) {}

#[cfg(test)]
mod tests {
    use super::types::file_uri;
    use super::*;
    use std::path::Path;

    /// Functions of the standard, without prefix (FMI 1.0 for model exchange and for co-simulation, FMI
    /// 2.0.4, FMI 3.0.1).
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
    fn function_names_follow_standard() {
        use super::fmi1_fmi2_values::ScalarValues;
        use super::fmi3::Fmi3;
        use super::fmi3::Fmi3Values;
        use super::functions::Functions;
        let tables = [
            Functions::NAMES,
            ScalarValues::<u8>::NAMES,
            Fmi3Values::NAMES,
            fmi1::Fmi1::NAMES,
            fmi2::Fmi2::NAMES,
            Fmi3::NAMES,
        ];
        let is_one_of =
            |names: &str, name| names.split_whitespace().any(|name_of_standard| name_of_standard == name);
        let mut n = 0;
        for row in tables.into_iter().flatten() {
            for (place, name) in row.iter().enumerate().filter(|(_, name)| name.starts_with('f')) {
                // A row with a single name belongs to a single version.
                let version = if row.len() == 1 { name.as_bytes()[3] - b'1' } else { place as u8 };
                let is_standard = match version {
                    1 => name.strip_prefix("fmi2").is_some_and(|name| is_one_of(FMI2, name)),
                    2 => name.strip_prefix("fmi3").is_some_and(|name| is_one_of(FMI3, name)),
                    _ => name.strip_prefix("fmi").is_some_and(|name| is_one_of(FMI1, name)),
                };
                assert!(is_standard, "{name}");
                n += 1;
            }
        }
        assert!(n > 120, "{n}");
    }

    #[test]
    fn file_uri_percent_encodes_special_characters() {
        let uri = |path: &str| file_uri(Path::new(path)).into_string().unwrap();
        assert_eq!(uri("/tmp/a-b_c.d/resources"), "file:///tmp/a-b_c.d/resources");
        assert_eq!(uri("/tmp/a b/{\u{e4}}"), "file:///tmp/a%20b/%7B%C3%A4%7D");
    }
}
