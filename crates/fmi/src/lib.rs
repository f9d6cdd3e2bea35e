//! A safe importer of Functional Mock-up Units: opening, describing, building and running them.
//!
//! # Layers
//!
//! A module imports from those below it only (`tools/layers.py` checks that), from top to bottom:
//!
//! - `session`: one model as scripts use it: set, simulate, get
//! - `start_values`: a copy of an FMU with other start values
//! - `reuse/`: loaded copies of a library and who has them, instances brought back to their start, simulators, pools
//! - `simulation/`: options, the plan that resolves them, the start of an instance, the run, what is recorded
//! - `instance/`: the phases of an instance as types, its values
//! - `fmu`, `fmu_cache`, `open_options`: an opened FMU: its file, its description, its library
//! - `source/`: source-code FMUs: build, compiler, cache, pack
//! - `sys/`: what touches foreign code and raw pointers; versions of FMI stop here
//! - `description/`: what `modelDescription.xml` says, whatever the version
//! - `archive/`: the files of an FMU
//! - `platform/`, `log`, `cancel`, `error/`, `value`: operating systems and files, the log of an instance, ending early, errors, types of variables
//!
//! A right-hand side passes four functions on its way from the stepper to the FMU: `derivatives` of the system
//! (`simulation/model_exchange.rs`), `Current::call` (`simulation/running.rs`: what a refused call means for the run),
//! `right_hand_side` of the raw instance (`sys/raw_instance/component.rs`: lengths, floating-point mode), the C function, whose
//! pointer stands in a table that is the same for all versions of FMI: none of the calls between is dynamic.
#![deny(unsafe_code)]

pub mod archive;
mod cancel;
pub mod description;
pub mod error;
mod fmu;
mod fmu_cache;
mod instance;
mod log;
mod open_options;
pub mod platform;
mod reuse;
mod session;
mod simulation;
mod source;
mod start_values;
mod sys;
mod value;
pub mod worker;

pub use self::log::LogFilter;
pub use archive::{Archive, ArchiveLimits};
pub use cancel::Cancel;
pub use description::{DescriptionLimits, ModelDescription, Variable};
pub use error::{CallFailure, EntryProblem, FmiError, LogLine, Status};
pub use fmu::{Fmu, Kind};
pub use fmu_cache::FmuCache;
pub use instance::{
    CoSimulation, ContinuousTime, EventMode, Initialization, Instance, Instantiated, MAX_EVENT_ITERATIONS,
    ModelExchange, Phase, Readable, Reconfiguration, Running, SavedState, StepMode, StepOutcome, Terminated,
};
pub use ode;
pub use open_options::{LogOptions, OpenOptions};
pub use reuse::{InstanceOptions, Lease, Pool, Reuse, Simulator};
pub use session::Session;
pub use simulation::{
    BetweenSteps, DEFAULT_INTERVALS, DEFAULT_TOLERANCE, InputFunction, Inputs, Recorded, Sharing,
    SimulateOptions, SimulationPlan, Tick, Trajectory, ValueColumn,
};
pub use source::{build_library, clear_caches, pack, pack_texts, pack_unless};
pub use sys::{ElementDependency, InterfaceKind, LoaderOptions};
pub use value::Value;
