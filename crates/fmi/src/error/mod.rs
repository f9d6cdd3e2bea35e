//! What can go wrong with an FMU: one error type that names the place and the numbers, and what a failed call says.

mod failure;
mod fmi_error;

pub use failure::{CallFailure, LogLine, Status};
pub use fmi_error::{EntryProblem, FmiError};
