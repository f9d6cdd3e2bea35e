//! Simulation of a model. The modules contain the options, the plan that resolves them, the initialization,
//! and the run by integration or communication steps.

pub(crate) mod clocks;
mod co_simulation;
pub(crate) mod engine;
mod grid;
mod input_table;
mod inputs;
mod model_exchange;
mod options;
mod outputs;
pub(crate) mod plan;
pub(crate) mod running;
mod settling;
mod shared_observer;
pub(crate) mod trajectory;
pub(crate) mod variable_elements;

pub use clocks::Tick;
pub use inputs::{InputFunction, Inputs};
pub use options::{
    BetweenSteps, DEFAULT_INTERVALS, DEFAULT_TOLERANCE, RunSettings, SimulateOptions, SteadyStart,
};
pub use outputs::Recorded;
pub use plan::SimulationPlan;
pub use trajectory::{Trajectory, ValueColumn};
