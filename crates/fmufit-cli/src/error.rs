//! Errors of the command line, and the exit codes.

use calibration::{CalibrationError, visible_error};
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt::Display;
use std::io;
use std::path::Path;

/// Outcome of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    /// All went well.
    Success,
    /// The work was done, and did not succeed.
    NoSuccess,
    /// Arguments, files or values that cannot be used.
    WrongInput,
    /// A fit ran to its end, and its result is not to be used.
    NotUsable,
    /// Ended by Ctrl-C.
    Interrupted,
}

impl Exit {
    /// The exit code; 130 is what shells give to a program that SIGINT has ended.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Success => 0,
            Self::NoSuccess => 1,
            Self::WrongInput => 2,
            Self::NotUsable => 3,
            Self::Interrupted => 130,
        }
    }
}

/// Reason why a command ended early.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub(crate) struct Error {
    pub(crate) exit: Exit,
    message: String,
}

/// An error as `--json` prints it.
#[derive(Serialize, JsonSchema)]
#[schemars(title = "Error of fmufit")]
pub(crate) struct ErrorDocument<'e> {
    error: ErrorFields<'e>,
}

#[derive(Serialize, JsonSchema)]
struct ErrorFields<'e> {
    /// What went wrong, in a sentence.
    message: &'e str,
    /// The exit code of the program.
    exit_code: u8,
}

impl Error {
    /// Arguments, files or values that cannot be used.
    pub(crate) fn input(message: impl Display) -> Self {
        Self { exit: Exit::WrongInput, message: message.to_string() }
    }

    /// Arguments that are no command, by the message for people: the lines up to the first empty one.
    pub(crate) fn of_usage(message: &str) -> Self {
        let lines = message.lines().take_while(|line| !line.trim().is_empty()).map(str::trim);
        Self::input(lines.collect::<Vec<_>>().join(" ").trim_start_matches("error: "))
    }

    /// Work that did not succeed.
    pub(crate) fn work(message: impl Display) -> Self {
        Self { exit: Exit::NoSuccess, message: message.to_string() }
    }

    /// Work that Ctrl-C has ended before it had a result.
    pub(crate) fn interrupted() -> Self {
        Self { exit: Exit::Interrupted, message: "interrupted before there was a result".to_owned() }
    }

    /// The error for programs that read JSON.
    pub(crate) fn document(&self) -> serde_json::Value {
        let error = ErrorFields { message: &self.message, exit_code: self.exit.code() };
        serde_json::to_value(ErrorDocument { error }).unwrap_or_default()
    }

    /// A file that cannot be written.
    pub(crate) fn write(path: &Path) -> impl Fn(io::Error) -> Self {
        move |error| Self::input(format!("cannot write {}: {error}", path.display()))
    }

    /// An error of work: an interrupt, if it is none of its own; a value or a file that cannot be used, if it
    /// is one of these.
    pub(crate) fn of_work(error: CalibrationError) -> Self {
        use dfo::Error::{Checkpoint, CheckpointFile, CheckpointMismatch, Option};
        match error {
            error if error.is_interrupt() => Self::interrupted(),
            CalibrationError::Setup(_)
            | CalibrationError::Record(_)
            | CalibrationError::ReportFile { .. }
            | CalibrationError::Optimiser(
                Option { .. } | Checkpoint { .. } | CheckpointFile { .. } | CheckpointMismatch { .. },
            ) => Self::input(visible_error(&error)),
            error => Self::work(visible_error(&error)),
        }
    }

    /// The same of what arguments name, in their words.
    pub(crate) fn of_arguments(error: CalibrationError) -> Self {
        let Self { exit, message } = Self::of_input(error);
        let message = message
            .replace("time=\"...\"", "--time COLUMN")
            .replace("start_time = ", "--start-time ")
            .replace(
                "a window or a start_time of the experiment",
                "a problem file with windows, or --start-time SECONDS",
            )
            .replace(
                "there is no parameter to fit",
                "there is no parameter to fit: give --parameter NAME=START:LOWER:UPPER",
            );
        Self { exit, message }
    }

    /// An error of what was read or built: an interrupt, if it is none of its own.
    pub(crate) fn of_input(error: CalibrationError) -> Self {
        match Self::of_work(error) {
            Self { exit: Exit::NoSuccess, message } => Self { exit: Exit::WrongInput, message },
            other => other,
        }
    }
}
