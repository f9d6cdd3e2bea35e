//! Commands, one file per command.

mod build;
mod check;
mod completions;
mod fit;
mod info;
mod init;
mod jobs;
mod optimize;
mod report;
mod schema;
mod sensitivity;
mod simulate;
mod validate;
mod variable_text;

use crate::arguments::Command;
use crate::console::Console;
use crate::error::{Error, Exit};

/// Runs a command.
pub(crate) fn run(command: Command, console: &Console) -> Result<Exit, Error> {
    match command {
        Command::Info(arguments) => info::run(&arguments, console),
        Command::Validate(arguments) => validate::run(&arguments, console),
        Command::Simulate(arguments) => simulate::run(&arguments, console),
        Command::Init(arguments) => init::run(&arguments, console),
        Command::Check(arguments) => check::run(&arguments, console),
        Command::Fit(arguments) => fit::run(&arguments, fit::Begin::Auto, console),
        Command::Optimize(arguments) => optimize::run(&arguments, console),
        Command::Sensitivity(arguments) => sensitivity::run(&arguments, console),
        Command::Resume(arguments) => fit::run(&arguments, fit::Begin::Resume, console),
        Command::Jobs(arguments) => jobs::run(&arguments, console),
        Command::Report(arguments) => report::run(&arguments, console),
        Command::Build(arguments) => build::run(&arguments, console),
        Command::Schema(arguments) => schema::run(&arguments, console),
        Command::Completions(arguments) => completions::run(&arguments, console),
        Command::Worker => Err(Error::input(
            "worker: this command is started by other programs only; do not run it directly",
        )),
    }
}
