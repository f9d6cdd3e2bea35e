//! A call into an FMU that failed: which call, for what, when, and what the FMU had to say about it.

use super::log_line::LogLine;
use super::status::Status;
use ode::Number;
use std::fmt;

/// A call into an FMU that failed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CallFailure {
    /// The function, by the standard's name.
    pub call: &'static str,
    /// What it returned.
    pub status: Status,
    /// The variables it was about, as far as that is known.
    pub variables: Vec<String>,
    /// Simulated time.
    pub time: Option<f64>,
    /// The last lines the instance logged, oldest first; references to variables are expanded to names.
    pub log: Vec<LogLine>,
    /// How many other lines are not shown: earlier ones, and those beyond the rate limit.
    pub dropped_log_lines: u64,
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
        Ok(())
    }
}

impl std::error::Error for CallFailure {}
