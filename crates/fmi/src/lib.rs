//! A safe importer of Functional Mock-up Units: opening, describing, building and running them.
//!
//! # Layers
//!
//! A module imports from those below it only (`tools/layers.py` checks that), from top to bottom:
//!
//! - `session`: one model as scripts use it: set, simulate, get
//! - `driven_instance`: one instance, driven by calls that can be sent to another process
//! - `write_start_values`: a copy of an FMU with other start values
//! - `simulators/`: a plan that is run many times: its instance, brought back to its start, and the check of
//!   that
//! - `simulation/`: options, the plan that resolves them, the start of an instance, the run, what is recorded
//! - `instance/`: the phases of an instance as types, its values
//! - `fmu`, `fmu_cache`, `open_options`: an opened FMU: its file, its description, its library
//! - `libraries/`: the loaded copy of a library that an opened FMU has for itself
//! - `source/`: source-code FMUs: build, compiler, cache, pack
//! - `worker/`: processes in which FMUs run: start, protocol, limits, folder, supervision
//! - `sys/`: what touches foreign code and raw pointers; versions of FMI stop here
//! - `description/`: what `modelDescription.xml` says, whatever the version
//! - `archive/`: the files of an FMU
//! - `platform/`, `fair_lock`, `log`, `cancel_request`, `error/`, `value`, `macros`: operating systems and
//!   files, who may be inside of a library, the log of an instance, ending early, errors, types of variables,
//!   repeated declarations
//!
//! A right-hand side passes four functions on its way from the stepper to the FMU: `derivatives` of the
//! system (`simulation/model_exchange.rs`), `Current::call` (`simulation/running.rs`: what a refused call
//! means for the run), `right_hand_side` of the raw instance (`sys/raw_instance/component.rs`: lengths,
//! floating-point mode), the C function, whose pointer stands in a table that is the same for all versions of
//! FMI: none of the calls between is dynamic.
//!
//! # Features
//!
//! `sandbox` (on by default) confines worker processes on request (Landlock and seccomp, on Linux). `sparse`
//! (off by default) is the feature of `ode`.
#![deny(unsafe_code)]
// Worker processes are those of Unix.
#![cfg_attr(not(unix), allow(dead_code))]

pub mod archive;
mod cancel_request;
pub mod description;
mod driven_instance;
pub mod error;
mod fair_lock;
mod fmu;
mod fmu_cache;
mod instance;
mod libraries;
mod log;
mod macros;
mod open_options;
pub mod platform;
mod session;
mod simulation;
mod simulators;
mod source;
mod sys;
mod value;
pub mod worker;
mod write_start_values;

pub use self::log::LogFilter;
pub use archive::{Archive, ArchiveLimits};
pub use cancel_request::CancelRequest;
pub use description::{DescriptionLimits, ModelDescription, Variable};
pub use driven_instance::{DrivenInstance, InstanceAnswer, InstanceCall, InstancePhase};
pub use error::{CallFailure, EntryProblem, FmiError, LogLine, Result, Status};
pub use fmu::{Fmu, InterfaceChoice};
pub use fmu_cache::FmuCache;
pub use instance::{
    CoSimulation, ContinuousTime, EventMode, Initialization, Instance, Instantiated, Integrated,
    Linearization, MAX_EVENT_ITERATIONS, ModelExchange, Phase, Readable, Reconfiguration, Running,
    SavedState, StepMode, StepOutcome, Terminated,
};
pub use libraries::Reuse;
pub use ode;
pub use open_options::{LogOptions, OpenOptions};
pub use session::Session;
pub use simulation::{
    BetweenSteps, DEFAULT_INTERVALS, DEFAULT_TOLERANCE, InputFunction, Inputs, Recorded, RunSettings,
    SimulateOptions, SimulationPlan, Tick, Trajectory, ValueColumn,
};
pub use simulators::{InstanceOptions, SharedSimulator, Simulator};
pub use source::{build_library, clear_caches, pack, pack_texts, pack_unless};
#[cfg(target_os = "linux")]
#[doc(hidden)]
pub use sys::is_loaded_to_serve;
pub use sys::{ElementDependency, InterfaceKind, LoaderOptions};
pub use value::Value;
