//! Failures of a worker process: an error that it reported, or its end.

use base::Number;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Kind of an error that a worker reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ReportedErrorKind {
    /// A setting or a value that cannot be used.
    Setting,
    /// A name that the model does not have.
    UnknownVariable,
    /// A value of another type than the variable's.
    WrongType,
    /// The simulation failed.
    Simulation,
    /// There was not enough memory.
    Memory,
    /// The FMU cannot be opened, loaded or instantiated.
    Model,
    /// A file is not there.
    NoFile,
    /// It was cancelled.
    Cancelled,
}

/// An error that a worker process has told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ReportedError {
    /// Its text.
    pub message: String,
    /// Its sort.
    pub kind: ReportedErrorKind,
    /// Simulated time at which a simulation failed.
    pub time: Option<f64>,
    /// Status that the failed call returned.
    pub status: Option<String>,
    /// The last lines that the instance logged, oldest first.
    pub log: Vec<String>,
}

impl ReportedError {
    /// True if it concerns the process or its files rather than a simulation.
    pub fn is_of_process(&self) -> bool {
        matches!(self.kind, ReportedErrorKind::Model | ReportedErrorKind::NoFile | ReportedErrorKind::Memory)
    }
}

/// Cause of the end of a worker process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EndKind {
    /// It ended by itself: a signal, `exit`, `abort`.
    Died,
    /// It did not come back from the FMU in time, and was ended.
    Hung,
    /// It had more memory than its limit, and was ended.
    Memory,
    /// Its output was not a valid answer; it was ended.
    Garbage,
}

/// The end of a worker process, in the middle of an evaluation.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WorkerEnd {
    /// Cause.
    pub kind: EndKind,
    /// The same in words: "segmentation fault".
    pub what: String,
    /// The last call into the FMU, by the standard's name.
    pub function: Option<String>,
    /// The simulated time of that call.
    pub time: Option<f64>,
    /// The last lines that the process has printed.
    pub output: String,
    /// What may be the cause (see [`CallFailure::hints`](super::CallFailure::hints)).
    pub hint: Option<String>,
}

/// Calls that are made when a run is over: what they do changes none of its rows.
const AT_END_OF_RUN: [&str; 13] = [
    "fmiTerminate",
    "fmiFreeModelInstance",
    "fmiTerminateSlave",
    "fmiResetSlave",
    "fmiFreeSlaveInstance",
    "fmi2Terminate",
    "fmi2Reset",
    "fmi2FreeFMUstate",
    "fmi2FreeInstance",
    "fmi3Terminate",
    "fmi3Reset",
    "fmi3FreeFMUState",
    "fmi3FreeInstance",
];

impl WorkerEnd {
    /// The call at the end of a run that has ended the process, or has not returned.
    pub fn call_at_end_of_run(&self) -> Option<&str> {
        let is_of_call = matches!(self.kind, EndKind::Died | EndKind::Hung);
        self.function.as_deref().filter(|function| is_of_call && AT_END_OF_RUN.contains(function))
    }

    /// Cause and place, the same for all ends of that kind: "segmentation fault in fmi2DoStep".
    pub fn reason(&self) -> String {
        match &self.function {
            Some(function) => format!("{} in {function}", self.what),
            None => self.what.clone(),
        }
    }
}

impl fmt::Display for WorkerEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.reason())?;
        if let Some(time) = self.time {
            write!(f, " at t = {}", Number(time))?;
        }
        if !self.output.is_empty() {
            write!(f, "; it had printed: {}", self.output)?;
        }
        if let Some(hint) = &self.hint {
            write!(f, "; {hint}")?;
        }
        Ok(())
    }
}
