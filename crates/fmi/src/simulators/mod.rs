//! A plan that is run many times in this process: one thread, one instance, brought back to its start between
//! runs.

mod instantiate;
mod reset;
mod run;
mod shared_simulator;
mod simulator;

pub use instantiate::InstanceOptions;
pub use shared_simulator::SharedSimulator;
pub use simulator::Simulator;
