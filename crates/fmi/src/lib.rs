//! A safe importer of Functional Mock-up Units: opening, describing, building and running them.
#![deny(unsafe_code)]

pub mod archive;
mod cancel;
pub mod description;
pub mod error;
mod examples;
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
mod sys;
mod value;

pub use self::log::LogFilter;
pub use archive::{Archive, ArchiveLimits};
pub use cancel::Cancel;
pub use description::{DescriptionLimits, ModelDescription, Variable};
pub use error::{CallFailure, EntryProblem, FmiError, LogLine, Status};
pub use examples::{ExampleKind, example_fmu, example_fmu_as, example_names};
pub use fmu::{Fmu, Kind};
pub use fmu_cache::FmuCache;
pub use instance::{
    CoSimulation, ContinuousTime, EventMode, Initialization, Instance, Instantiated, MAX_EVENT_ITERATIONS,
    ModelExchange, Phase, Readable, Reconfiguration, SavedState, SerializedState, StepMode, StepOutcome,
    Terminated,
};
pub use ode;
pub use open_options::{LogOptions, OpenOptions};
pub use reuse::{InstanceOptions, Lease, Pool, Reuse, Simulator};
pub use session::Session;
pub use simulation::{
    DEFAULT_INTERVALS, DEFAULT_TOLERANCE, InputFunction, Inputs, Recorded, Sharing, SimulateOptions,
    SimulationPlan, Tick, Trajectory, ValueColumn,
};
pub use source::{build_library, clear_caches, pack, pack_unless};
pub use sys::{InterfaceKind, LoaderOptions};
pub use value::Value;
