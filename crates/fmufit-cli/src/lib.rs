//! The command line `fmufit`: FMUs are looked at, simulated and fitted to recordings, without a line of code.
//!
//! [`main`] takes the arguments and returns the exit code, so that any program can offer the command line. A
//! program that calls [`calibration::serve_if_worker`] first, or names another one that does, has FMUs run in
//! processes of their own.
//!
//! Folders, from the lowest: `error`; `written` (which files may be); `console` (what is printed, and where),
//! `interrupt`; `problem` (problem files and their short form); `arguments`; `commands`, one file for each.
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

/// Runs the command that these arguments, the first of which is the name of the program, ask for. Returns the
/// exit code: 0 if all went well; 1 if the work was done and did not succeed (a fit that did not converge, an
/// FMU that cannot be simulated); 2 for arguments, files and values that cannot be used; 3 for a fit that ran
/// and whose result is not to be used; 130 after Ctrl-C.
pub fn main(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> u8 {
    let given: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    let arguments = match CommandLine::try_parse_from(&given) {
        Ok(arguments) => arguments,
        Err(message) => {
            // What cannot be printed has nobody who reads it.
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
                // Programs read the standard output; there is nothing else to say where that fails.
                let _ = console.json(&error.document());
            }
            error.exit.code()
        }
    }
}
