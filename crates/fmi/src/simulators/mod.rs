//! Simulators, which run one plan many times in this process. One thread uses one instance, which returns to
//! its start between runs.

mod instantiate;
mod reset;
mod run;
mod shared_simulator;
mod simulator;

pub use instantiate::InstanceOptions;
pub use shared_simulator::SharedSimulator;
pub use simulator::Simulator;
