//! A call into an FMU that failed: which call, for what, when, and what the FMU had to say about it.

use base::Number;
use std::fmt;
use std::sync::Arc;

/// A call into an FMU that failed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CallFailure {
    /// The function, by the standard's name.
    pub call: &'static str,
    /// Status that it returned.
    pub status: Status,
    /// The variables it was about, as far as that is known.
    pub variables: Vec<String>,
    /// Simulated time.
    pub time: Option<f64>,
    /// The last lines the instance logged, oldest first; references to variables are expanded to names.
    pub log: Vec<LogLine>,
    /// Number of other lines that are not shown: earlier ones, and those beyond the rate limit.
    pub dropped_log_lines: u64,
    /// What may be the cause beside the call: a missing tool, a draft of the standard, a sandbox.
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
    /// Done.
    Ok,
    /// Done, with something to say about it.
    Warning,
    /// Not possible at this point; nothing is broken.
    Discard,
    /// The instance cannot go on; it can be freed or reset.
    Error,
    /// The instance is broken beyond repair.
    Fatal,
    /// Not finished yet (co-simulation only).
    Pending,
    /// The library does not offer the function.
    Missing,
    /// A number that the standard does not know.
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
            Status::Unknown(code) => write!(f, "the unknown status {code}"),
        }
    }
}

/// A line that an FMU logged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    /// Severity.
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
