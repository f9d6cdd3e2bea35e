//! Instances of a model and their phases. Each phase is a type with the calls that FMI allows in it.

pub(crate) mod assignments;
mod clocks;
mod co_simulation;
mod core;
mod events_by_hand;
pub(crate) mod integer_codec;
mod integration;
mod linearization;
mod model_exchange;
mod phases;
mod progress;
mod reconfiguration;
mod schedule;

pub(crate) use clocks::check_interval;
pub use co_simulation::StepOutcome;
pub(crate) use core::Core;
pub use integration::Integrated;
pub use linearization::Linearization;
pub use model_exchange::MAX_EVENT_ITERATIONS;
pub use phases::{
    CoSimulation, ContinuousTime, EventMode, Initialization, Instance, Instantiated, ModelExchange, Phase,
    Readable, Reconfiguration, Running, SavedState, StepMode, Terminated,
};
pub(crate) use schedule::{Schedule, TimedClock, next_instant};
