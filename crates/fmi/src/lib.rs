//! A safe importer of Functional Mock-up Units: opening, describing, building and running them.
#![deny(unsafe_code)]

pub mod archive;
mod assign;
mod binary;
mod clocks;
mod co_simulation;
mod communication;
pub mod description;
mod digest;
pub mod error;
mod examples;
mod failure;
mod fmu;
mod input;
mod instance;
mod intermediate;
mod lanes;
mod model_exchange;
mod options;
mod outputs;
mod plan;
pub mod platform;
mod pool;
mod reconfiguration;
mod session;
mod simulation;
mod source;
mod sys;
mod system;
mod texts;
mod trajectory;

pub use archive::{Archive, ArchiveLimits};
pub use clocks::Tick;
pub use co_simulation::StepOutcome;
pub use description::{ModelDescription, Value, Variable};
pub use error::{EntryProblem, FmiError};
pub use examples::{ExampleKind, example_fmu, example_fmu_as, example_names};
pub use failure::CallFailure;
pub use fmu::{Fmu, FmuCache, InstanceOptions, Reuse};
pub use input::{InputFunction, Inputs};
pub use instance::{
    CoSimulation, ContinuousTime, EventMode, Initialization, Instance, Instantiated, ModelExchange, Phase,
    Readable, Reconfiguration, SavedState, SerializedState, StepMode, Terminated,
};
pub use model_exchange::MAX_EVENT_ITERATIONS;
pub use ode;
pub use options::{DEFAULT_INTERVALS, DEFAULT_TOLERANCE, Kind, SimulateOptions};
pub use outputs::Recorded;
pub use plan::SimulationPlan;
pub use pool::{Lease, Pool};
pub use session::Session;
pub use simulation::Simulator;
pub use source::{build_library, clear_caches, pack};
pub use sys::{InterfaceKind, LogLine, Status};
pub use trajectory::{Trajectory, ValueColumn};
