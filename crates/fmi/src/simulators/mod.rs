//! A plan that is run many times in this process: one thread, one instance, brought back to its start between
//! runs.

mod check;
mod first_run;
mod instantiate;
mod pool;
mod reset;
mod run;
mod simulator;

pub use instantiate::InstanceOptions;
pub use pool::Pool;
pub use simulator::Simulator;
