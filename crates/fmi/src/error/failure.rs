//! A failed call into an FMU: the call, its variables, its time and the log lines of the FMU.

use base::Number;
use std::fmt;
use std::sync::Arc;

/// A call into an FMU that failed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CallFailure {
    /// Name of the function in the standard.
    pub call: &'static str,
    /// Status that the function returned.
    pub status: Status,
    /// Variables that the call concerned, if known.
    pub variables: Vec<String>,
    /// Simulated time.
    pub time: Option<f64>,
    /// Last lines that the instance logged, oldest first. References to variables are expanded to names.
    pub log: Vec<LogLine>,
    /// Number of other lines that are not shown: earlier lines and lines beyond the rate limit.
    pub dropped_log_lines: u64,
    /// Possible causes other than the call itself: a missing tool, a draft of the standard, a sandbox.
    pub hints: Vec<Arc<str>>,
}

impl fmt::Display for CallFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} returned {}", self.call, self.status)?;
        if let Some((first, rest)) = self.variables.split_first() {
            write!(f, " for {first}")?;
            match rest {
                [] => {}
                [second] => write!(f, " and {second}")?,
                _ => write!(f, " and {} more", rest.len())?,
            }
        }
        if let Some(time) = self.time {
            write!(f, " at t = {}", Number(time))?;
        }
        if !self.log.is_empty() {
            f.write_str("; the FMU logged: ")?;
            for (i, line) in self.log.iter().enumerate() {
                if i > 0 {
                    f.write_str(" | ")?;
                }
                write!(f, "{line}")?;
            }
        }
        if self.dropped_log_lines > 0 {
            write!(f, " (and {} other lines)", self.dropped_log_lines)?;
        }
        self.hints.iter().try_for_each(|hint| write!(f, "; {hint}"))
    }
}

impl std::error::Error for CallFailure {}

/// Status returned by a call into an FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Status {
    /// Succeeded.
    Ok,
    /// Succeeded, with a warning.
    Warning,
    /// Not possible at this point; the instance remains usable.
    Discard,
    /// The instance cannot continue; it can be freed or reset.
    Error,
    /// The instance is permanently unusable.
    Fatal,
    /// Not finished yet (co-simulation only).
    Pending,
    /// The library does not have the function.
    Missing,
    /// A status code that the standard does not define.
    Unknown(i32),
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Status::Ok => f.write_str("ok"),
            Status::Warning => f.write_str("warning"),
            Status::Discard => f.write_str("discard"),
            Status::Error => f.write_str("error"),
            Status::Fatal => f.write_str("fatal"),
            Status::Pending => f.write_str("pending"),
            Status::Missing => f.write_str("that there is no such function"),
            Status::Unknown(code) => write!(f, "unknown status {code}"),
        }
    }
}

/// A line that an FMU logged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    /// Severity.
    pub status: Status,
    /// Category, usually from the model description.
    pub category: String,
    /// Message. Invalid UTF-8 and control characters are replaced, and long messages are truncated.
    pub text: String,
}

impl fmt::Display for LogLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}] {}", self.status, self.text)
    }
}
