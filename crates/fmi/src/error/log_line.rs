//! A line of the log of an FMU.

use super::status::Status;
use std::fmt;

/// A line that an FMU logged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    /// How serious it is.
    pub status: Status,
    /// Category, one of the model description's or anything else.
    pub category: String,
    /// The message; bytes that are not UTF-8 and control characters are replaced, long messages cut.
    pub text: String,
}

impl fmt::Display for LogLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}] {}", self.status, self.text)
    }
}
