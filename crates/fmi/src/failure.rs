//! A call into an FMU that failed: which call, for what, when, and what the FMU had to say about it.

use crate::description::{ModelDescription, VariableKind};
use crate::error::FmiError;
use crate::sys::{Failed, LogLine, Status};
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

impl From<Failed> for CallFailure {
    fn from(failed: Failed) -> Self {
        Self {
            call: failed.call,
            status: failed.status,
            variables: Vec::new(),
            time: failed.time,
            log: failed.log,
            dropped_log_lines: failed.dropped,
        }
    }
}

impl From<Failed> for FmiError {
    fn from(failed: Failed) -> Self {
        FmiError::Call(Box::new(failed.into()))
    }
}

impl CallFailure {
    /// Replaces references in the log lines by names.
    pub(crate) fn expand(&mut self, description: &ModelDescription) {
        for line in &mut self.log {
            if line.text.contains('#') {
                line.text = expand_references(&line.text, description);
            }
        }
    }
}

impl FmiError {
    /// The failed call at the bottom of this error, if there is one.
    pub fn call_failure(&self) -> Option<&CallFailure> {
        match self {
            FmiError::Call(failure) => Some(failure),
            FmiError::Simulation(error) => match &error.kind {
                ode::ErrorKind::Model(inner) => {
                    inner.downcast_ref::<FmiError>().and_then(FmiError::call_failure)
                }
                _ => None,
            },
            _ => None,
        }
    }
}

/// Replaces `#r12#` (type letter and value reference) by the name of the variable and `##` by `#`
/// (FMI 2.0.x, section 2.1.5); anything else stays.
pub(crate) fn expand_references(text: &str, description: &ModelDescription) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('#') {
        out.push_str(&rest[..at]);
        let after = &rest[at + 1..];
        let replaced = after.find('#').and_then(|end| {
            let inner = &after[..end];
            let name = if inner.is_empty() { Some("#") } else { referenced(inner, description) };
            name.map(|name| (name, end))
        });
        if let Some((name, end)) = replaced {
            out.push_str(name);
            rest = &after[end + 1..];
        } else {
            out.push('#');
            rest = after;
        }
    }
    out.push_str(rest);
    out
}

/// The name behind `r12`.
fn referenced<'a>(inner: &str, description: &'a ModelDescription) -> Option<&'a str> {
    let mut chars = inner.chars();
    let letter = chars.next()?;
    let reference: u32 = chars.as_str().parse().ok()?;
    description
        .variables
        .iter()
        .find(|variable| variable.value_reference == reference && letter_of(variable.kind) == letter)
        .map(|variable| variable.name.as_str())
}

fn letter_of(kind: VariableKind) -> char {
    match kind {
        VariableKind::Real => 'r',
        VariableKind::Boolean => 'b',
        VariableKind::String => 's',
        // Types of FMI 3.0, whose messages have no references, cannot be meant.
        _ => 'i',
    }
}
