//! A safe importer of Functional Mock-up Units: opening, describing, building and running them.
#![deny(unsafe_code)]

pub mod archive;
mod assign;
mod beginning;
mod binary;
mod cancel;
mod clocks;
mod co_simulation;
mod column;
mod communication;
pub mod description;
pub mod error;
mod examples;
mod failure;
mod fmu;
mod fmu_cache;
mod input;
mod instance;
mod intermediate;
mod jacobian;
mod lanes;
mod memory;
mod model_exchange;
mod no_effect;
mod open_options;
mod options;
mod outputs;
mod places;
mod plan;
pub mod platform;
mod points;
mod reconfiguration;
mod reuse;
mod running;
mod selection;
mod session;
mod simulation;
mod source;
mod sys;
mod system;
mod text_inputs;
mod texts;
mod trajectory;

pub use archive::{Archive, ArchiveLimits};
pub use cancel::Cancel;
pub use clocks::Tick;
pub use co_simulation::StepOutcome;
pub use description::{DescriptionLimits, ModelDescription, Value, Variable};
pub use error::{EntryProblem, FmiError};
pub use examples::{ExampleKind, example_fmu, example_fmu_as, example_names};
pub use failure::CallFailure;
pub use fmu::{Fmu, InstanceOptions};
pub use fmu_cache::FmuCache;
pub use input::{InputFunction, Inputs};
pub use instance::{
    CoSimulation, ContinuousTime, EventMode, Initialization, Instance, Instantiated, ModelExchange, Phase,
    Readable, Reconfiguration, SavedState, SerializedState, StepMode, Terminated,
};
pub use model_exchange::MAX_EVENT_ITERATIONS;
pub use ode;
pub use open_options::{LoaderOptions, LogOptions, OpenOptions};
pub use options::{DEFAULT_INTERVALS, DEFAULT_TOLERANCE, Kind, SimulateOptions};
pub use outputs::Recorded;
pub use plan::SimulationPlan;
pub use reuse::{Lease, Pool, Reuse, Sharing};
pub use session::Session;
pub use simulation::Simulator;
pub use source::{build_library, clear_caches, pack};
pub use sys::{InterfaceKind, LogFilter, LogLine, Status};
pub use trajectory::{Trajectory, ValueColumn};
