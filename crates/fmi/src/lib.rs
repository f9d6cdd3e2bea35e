//! A safe importer of Functional Mock-up Units (FMUs): opening, describing, building and running them.
//!
//! # Layers
//!
//! A module imports only from the layers below it (checked by `tools/layers.py`). From top to bottom:
//!
//! - `session`: a model for scripts: set, simulate, get
//! - `driven_instance`: an instance driven by calls that can be sent to another process
//! - `write_start_values`: copies of an FMU with other start values
//! - `simulators/`: simulators that run a plan many times: instances, their reset, and checks of the reset
//! - `simulation/`: options, the plan that resolves them, the start of an instance, the run, the recorded
//!   results
//! - `instance/`: the phases of an instance as types, and its values
//! - `fmu`, `fmu_cache`, `open_options`: an opened FMU: its file, its description, its library
//! - `libraries/`: the separate loaded copy of a library for each opened FMU
//! - `source/`: source-code FMUs: build, compiler, cache, pack
//! - `worker/`: processes that run FMUs: start, protocol, limits, folder, supervision
//! - `sys/`: all foreign code and raw pointers. The layers above do not depend on the FMI version.
//! - `description/`: the contents of `modelDescription.xml`, independent of the FMI version
//! - `archive/`: the files of an FMU
//! - `platform/`, `fair_lock`, `log`, `cancel_request`, `error/`, `value`, `macros`: operating systems and
//!   files, access to a library by one thread at a time, the log of an instance, cancellation, errors, types
//!   of variables, repeated declarations
//!
//! An evaluation of the right-hand side passes through four functions, from the stepper to the FMU:
//!
//! - `derivatives` of the system (`simulation/model_exchange.rs`)
//! - `Current::call` (`simulation/running.rs`), which decides how a failed call affects the run
//! - `right_hand_side` of the raw instance (`sys/raw_instance/component.rs`), which checks lengths and sets
//!   the floating-point mode
//! - the C function, whose pointer is in a table shared by all FMI versions
//!
//! None of these calls uses dynamic dispatch.
//!
//! # Features
//!
//! `sandbox` (on by default) confines worker processes on request (Landlock and seccomp, on Linux). `sparse`
//! (off by default) enables the feature of the same name of `ode`.
#![deny(unsafe_code)]
// Only an implementation of `worker::platform` uses some functions.
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
    SimulateOptions, SimulationPlan, SteadyStart, Tick, Trajectory, ValueColumn,
};
pub use simulators::{InstanceOptions, SharedSimulator, Simulator};
pub use source::{build_library, clear_caches, pack, pack_for, pack_texts};
#[cfg(target_os = "linux")]
#[doc(hidden)]
pub use sys::is_loaded_to_serve;
pub use sys::{ElementDependency, InterfaceKind, LoaderOptions};
pub use value::Value;
