//! Everything that brings instances back to their start or shares a library: loaded copies and who has them, what was ever
//! set in them, ways of resetting and their check, simulators and pools of them.

mod copies;
mod copy_use;
mod earlier_run;
mod failed_runs;
mod files;
mod fmu_use;
mod history;
mod instantiate;
mod lend;
mod linkage;
mod pool;
mod probe;
mod reset;
mod restored_values;
mod runner;
mod simulator;
mod source;
mod store;
mod trial;
mod verdict;

pub use instantiate::InstanceOptions;
pub use pool::{Lease, Pool};
pub use simulator::Simulator;
pub use verdict::Reuse;
