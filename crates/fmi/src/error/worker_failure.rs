//! Failures of a worker process: an error that it reported, or its end.

use base::Number;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Kind of an error that a worker reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ReportedErrorKind {
    /// A setting or a value is invalid.
    Setting,
    /// The model has no variable of this name.
    UnknownVariable,
    /// A value does not have the type of its variable.
    WrongType,
    /// The simulation failed.
    Simulation,
    /// Not enough memory was available.
    Memory,
    /// The FMU cannot be opened, loaded or instantiated.
    Model,
    /// A file does not exist.
    NoFile,
    /// The operation was cancelled.
    Cancelled,
}

/// An error that a worker process has reported.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ReportedError {
    /// Message.
    pub message: String,
    /// Kind of the error.
    pub kind: ReportedErrorKind,
    /// Simulated time at which the simulation failed.
    pub time: Option<f64>,
    /// Status that the failed call returned.
    pub status: Option<String>,
    /// Last lines that the instance logged, oldest first.
    pub log: Vec<String>,
}

impl ReportedError {
    /// True if the error concerns the process or its files, not a simulation.
    pub fn is_of_process(&self) -> bool {
        matches!(self.kind, ReportedErrorKind::Model | ReportedErrorKind::NoFile | ReportedErrorKind::Memory)
    }
}

/// Cause of the end of a worker process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EndKind {
    /// The process ended by itself: a signal, `exit`, `abort`.
    Died,
    /// A call into the FMU did not return in time, and the process was killed.
    Hung,
    /// The process exceeded its memory limit and was killed.
    Memory,
    /// The output of the process was not a valid answer, and the process was killed.
    Garbage,
}

/// The end of a worker process during an evaluation.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WorkerEnd {
    /// Cause.
    pub kind: EndKind,
    /// Cause in words, for example "segmentation fault".
    pub what: String,
    /// Last call into the FMU; name of the function in the standard.
    pub function: Option<String>,
    /// Simulated time of that call.
    pub time: Option<f64>,
    /// Last lines that the process printed.
    pub output: String,
    /// Possible cause (see [`CallFailure::hints`](super::CallFailure::hints)).
    pub hint: Option<String>,
}

/// Calls at the end of a run. They do not change the rows of the run.
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
    /// Returns the call at the end of a run during which the process ended or hung.
    pub fn call_at_end_of_run(&self) -> Option<&str> {
        let is_of_call = matches!(self.kind, EndKind::Died | EndKind::Hung);
        self.function.as_deref().filter(|function| is_of_call && AT_END_OF_RUN.contains(function))
    }

    /// Returns the cause and the function, for example "segmentation fault in fmi2DoStep".
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
            write!(f, "; last output: {}", self.output)?;
        }
        if let Some(hint) = &self.hint {
            write!(f, "; {hint}")?;
        }
        Ok(())
    }
}
