//! Errors of this crate, and the data of a failed call.

mod entry_problem;
mod failure;
mod fmi_error;
mod worker_failure;

pub use entry_problem::EntryProblem;
pub use failure::{CallFailure, LogLine, Status};
pub use fmi_error::{FmiError, Result};
pub use worker_failure::{EndKind, ReportedError, ReportedErrorKind, WorkerEnd};
