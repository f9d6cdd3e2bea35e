//! Everything that brings instances back to their start or shares a library: loaded copies and who has them, what was ever
//! set in them, ways of resetting and their check, simulators and pools of them.

mod copies;
mod failed_runs;
mod files;
mod fmu_use;
mod history;
mod instantiate;
mod linkage;
mod loans;
mod past;
mod pool;
mod probe;
mod renewal;
mod runner;
mod simulator;
mod source;
mod store;
mod trial;
mod unset;
mod verdict;

pub use instantiate::InstanceOptions;
pub use pool::{Lease, Pool};
pub use simulator::Simulator;
pub use verdict::Reuse;
