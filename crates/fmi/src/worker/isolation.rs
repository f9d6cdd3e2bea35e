//! Where an FMU runs, and which worker process is asked.

use super::frame::Frame;
use super::limits::AnswerLimits;
use base::RunContext;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// Where an FMU runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Isolation {
    /// In processes of its own, one per thread that evaluates: this process outlives whatever the FMU does.
    #[default]
    Process,
    /// In this process, one simulation at a time.
    None,
}

impl Isolation {
    /// All of them, by their names.
    pub const NAMES: [(&'static str, Self); 2] = [("process", Self::Process), ("none", Self::None)];

    /// The name by which it is asked for.
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
        let found = Self::NAMES.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
        found.map(|(_, isolation)| *isolation).ok_or_else(|| {
            crate::error::FmiError::BadSetting(format!(
                "isolation = \"{name}\"; there are: \"process\", \"none\""
            ))
        })
    }
}

/// A question to a worker.
#[derive(Clone, Copy)]
pub struct Question<'a> {
    /// The question.
    pub asked: &'a Frame,
    /// Ends the wait for the answer: it is looked at every 10 ms, and the worker has 0.1 s to answer once it
    /// is over.
    pub context: &'a RunContext<'a>,
    /// Limits of the answer: a simulation that takes longer than its time and 0.25 s ends the worker, and so
    /// does an answer that is larger.
    pub limits: AnswerLimits,
    /// True if the answer is only compared with another one. What the worker logs is dropped then.
    pub is_repetition: bool,
}

/// Process that is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AskedProcess {
    /// Any that is idle and has loaded the same; a new one if there is none.
    Any,
    /// Of these, the one that was asked longest ago.
    LongestIdle,
    /// One that was never asked before.
    Fresh,
    /// One that was never asked before, and is not asked again.
    FreshOnce,
}
