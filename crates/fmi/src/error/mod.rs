//! What can go wrong with an FMU: one error type that names the place and the numbers, and what a failed call says.

mod failure;
mod fmi_error;
mod log_line;
mod status;

pub use failure::CallFailure;
pub use fmi_error::{EntryProblem, FmiError};
pub use log_line::LogLine;
pub use status::Status;
