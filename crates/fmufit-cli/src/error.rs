//! Errors of the command line, and exit codes.

use calibration::{CalibrationError, visible_error};
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt::Display;
use std::io;
use std::path::Path;

/// Outcome of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    /// The command succeeded.
    Success,
    /// The work was done but did not succeed.
    NoSuccess,
    /// Arguments, files or values are unusable.
    WrongInput,
    /// A fit ran to its end, but its result should not be used.
    NotUsable,
    /// The command was ended by Ctrl-C.
    Interrupted,
}

impl Exit {
    /// Returns the exit code. Shells use 130 for a program ended by SIGINT.
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

/// Error as printed by `--json`.
#[derive(Serialize, JsonSchema)]
#[schemars(title = "fmufit error")]
pub(crate) struct ErrorDocument<'e> {
    error: ErrorFields<'e>,
}

#[derive(Serialize, JsonSchema)]
struct ErrorFields<'e> {
    /// Description of the error, in a sentence.
    message: &'e str,
    /// Exit code of the program.
    exit_code: u8,
}

impl Error {
    /// Creates an error for unusable arguments, files or values.
    pub(crate) fn input(message: impl Display) -> Self {
        Self { exit: Exit::WrongInput, message: message.to_string() }
    }

    /// Creates an error for invalid arguments from the message of the parser: its lines up to the first empty
    /// one.
    pub(crate) fn of_usage(message: &str) -> Self {
        let lines = message.lines().take_while(|line| !line.trim().is_empty()).map(str::trim);
        Self::input(lines.collect::<Vec<_>>().join(" ").trim_start_matches("error: "))
    }

    /// Creates an error for work that did not succeed.
    pub(crate) fn work(message: impl Display) -> Self {
        Self { exit: Exit::NoSuccess, message: message.to_string() }
    }

    /// Creates an error for work that Ctrl-C ended before it had a result.
    pub(crate) fn interrupted() -> Self {
        Self { exit: Exit::Interrupted, message: "interrupted before a result was available".to_owned() }
    }

    /// Returns the error as a JSON document.
    pub(crate) fn document(&self) -> serde_json::Value {
        let error = ErrorFields { message: &self.message, exit_code: self.exit.code() };
        serde_json::to_value(ErrorDocument { error }).unwrap_or_default()
    }

    /// Returns a function that creates an error for a file that cannot be written.
    pub(crate) fn write(path: &Path) -> impl Fn(io::Error) -> Self {
        move |error| Self::input(format!("cannot write {}: {error}", path.display()))
    }

    /// Converts an error of the work. Interrupts, unusable values and unusable files have their own exit
    /// codes.
    pub(crate) fn of_work(error: CalibrationError) -> Self {
        use dfo::Error::{Checkpoint, CheckpointFile, CheckpointMismatch, Option};
        match error {
            error if error.is_interrupt() => Self::interrupted(),
            CalibrationError::Setup(_)
            | CalibrationError::Record(_)
            | CalibrationError::ReportFile { .. }
            | CalibrationError::OptimiserParameter { .. }
            | CalibrationError::Optimiser(
                Option { .. } | Checkpoint { .. } | CheckpointFile { .. } | CheckpointMismatch { .. },
            ) => Self::input(visible_error(&error)),
            error => Self::work(visible_error(&error)),
        }
    }

    /// Converts an error about arguments and uses the names of the arguments in its message.
    pub(crate) fn of_arguments(error: CalibrationError) -> Self {
        let Self { exit, message } = Self::of_input(error);
        let message = message
            .replace("time=\"...\"", "--time COLUMN")
            .replace("start_time = ", "--start-time ")
            .replace(
                "a window or start_time inside",
                "windows in a problem file or --start-time SECONDS inside",
            )
            .replace(
                "parameters is empty. Add a parameter to fit",
                "there are no parameters to fit. Specify --parameter NAME=START:LOWER:UPPER",
            );
        Self { exit, message }
    }

    /// Converts an error in the input. It has the exit code of unusable input, except
    /// for interrupts.
    pub(crate) fn of_input(error: CalibrationError) -> Self {
        match Self::of_work(error) {
            Self { exit: Exit::NoSuccess, message } => Self { exit: Exit::WrongInput, message },
            other => other,
        }
    }
}
