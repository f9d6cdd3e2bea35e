//! What can go wrong with an FMU: one error type that names the place and the numbers, and what a failed call says.

mod entry_problem;
mod failure;
mod fmi_error;
mod worker_failure;

pub use entry_problem::EntryProblem;
pub use failure::{CallFailure, LogLine, Status};
pub use fmi_error::FmiError;
pub use worker_failure::{EndKind, Told, ToldKind, WorkerEnd};
