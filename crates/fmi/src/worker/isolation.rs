//! Choice of the process in which an FMU runs, and of the worker process for a request.

use super::frame::Frame;
use super::limits::AnswerLimits;
use crate::error::FmiError;
use base::RunContext;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// Process in which an FMU runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Isolation {
    /// Separate processes, one for each thread that evaluates. Failures of the FMU do not affect this
    /// process.
    #[default]
    Process,
    /// This process, one simulation at a time.
    None,
}

impl Isolation {
    /// All values, with their names.
    pub const NAMES: [(&'static str, Self); 2] = [("process", Self::Process), ("none", Self::None)];

    /// Returns the name of the value.
    pub fn name(self) -> &'static str {
        match self {
            Self::Process => "process",
            Self::None => "none",
        }
    }
}

impl FromStr for Isolation {
    type Err = crate::error::FmiError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let found = Self::NAMES.iter().find(|(listed, _)| listed.eq_ignore_ascii_case(name));
        found.map(|(_, isolation)| *isolation).ok_or_else(|| {
            crate::error::FmiError::BadSetting(format!(
                "isolation = \"{name}\" is invalid; expected one of: \"process\", \"none\""
            ))
        })
    }
}

/// A request to a worker.
#[derive(Clone, Copy)]
pub struct Question<'a> {
    /// Message to the worker.
    pub requested: &'a Frame,
    /// Ends the wait for the answer. It is checked every 10 ms. After it ends, the worker has 0.1 s to
    /// answer.
    pub context: &'a RunContext<'a>,
    /// Limits of the answer. The worker is ended if a simulation exceeds its time limit by more than 0.25 s,
    /// or if the answer is too large.
    pub limits: AnswerLimits,
    /// True if the answer is only compared with another one. Log lines of the worker are then dropped.
    pub is_repetition: bool,
}

/// A repeated question. It is sent to the process that has just answered another question, before anything
/// else can use that process.
pub struct Repeat<'a> {
    /// Question.
    pub question: Question<'a>,
    /// Answer.
    pub answer: Frame,
    /// `None` if the process was not used before, or cannot be asked again.
    pub outcome: Option<Result<(), FmiError>>,
}

/// Choice of the process that receives a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequestedProcess {
    /// Any idle process with the required load; a new one if there is none.
    Any,
    /// The process with the required load that has been idle the longest.
    LongestIdle,
    /// A process that has not received a request before.
    Fresh,
    /// A process that has not received a request before, and receives no further ones.
    FreshOnce,
}
