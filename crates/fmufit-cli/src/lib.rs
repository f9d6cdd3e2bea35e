//! The command line `fmufit`, which inspects and simulates FMUs and fits them to recordings without
//! programming.
//!
//! [`main`] processes the arguments and returns the exit code, so any program can provide the command line.
//! FMUs run in separate processes if the program first calls [`calibration::serve_if_worker`], or specifies
//! another program that does.
//!
//! Modules, from the lowest layer: `error`; `output_paths` (paths that may be written); `console` (output
//! streams), `interrupt`; `problem` (problem files and their short form); `arguments`; `commands`, one file
//! per command.
#![forbid(unsafe_code)]

mod arguments;
mod commands;
mod console;
mod error;
mod interrupt;
mod output_paths;
mod problem;

use arguments::CommandLine;
use clap::Parser;
use console::Console;
use error::{Error, Exit};
use std::ffi::OsString;

/// Runs the command of these arguments, the first of which is the name of the program. Returns the exit code:
///
/// - 0: the command succeeded.
/// - 1: the work was done but did not succeed (a fit that did not converge, an FMU that cannot be simulated).
/// - 2: arguments, files or values are unusable.
/// - 3: a fit ran, but its result should not be used.
/// - 130: Ctrl-C.
pub fn main(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> u8 {
    let given: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    let arguments = match CommandLine::try_parse_from(&given) {
        Ok(arguments) => arguments,
        Err(message) => {
            // A failed write means that nobody reads the message.
            let _ = message.print();
            if !message.use_stderr() {
                return Exit::Success.code();
            }
            if given.iter().any(|argument| argument == "--json") {
                let _ = Console::new(true).json(&Error::of_usage(&message.render().to_string()).document());
            }
            return Exit::WrongInput.code();
        }
    };
    let console = Console::new(arguments.quiet);
    let is_json = arguments.command.is_json();
    let ran = commands::run(arguments.command, &console).and_then(|exit| console.finish().map(|()| exit));
    match ran {
        Ok(exit) => exit.code(),
        Err(error) => {
            console.error(&error);
            if is_json {
                // Programs read the standard output. If it fails, there is no other way to report the error.
                let _ = console.json(&error.document());
            }
            error.exit.code()
        }
    }
}
