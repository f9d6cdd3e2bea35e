//! Runs: minimisation, ask/tell, options, report, checkpoint.

pub(crate) mod checkpoint;
pub(crate) mod drive;
pub(crate) mod minimize;
pub(crate) mod optimizer;
pub(crate) mod options;
pub(crate) mod progress;
pub(crate) mod report;
pub(crate) mod requested;
#[cfg(feature = "schema")]
mod schema;
pub(crate) mod start;
