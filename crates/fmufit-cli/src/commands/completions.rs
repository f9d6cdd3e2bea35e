//! `fmufit completions`: writes shell completion scripts.

use crate::arguments::{CommandLine, Completions};
use crate::console::Console;
use crate::error::{Error, Exit};
use clap::CommandFactory;

pub(crate) fn run(arguments: &Completions, console: &Console) -> Result<Exit, Error> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut CommandLine::command(), "fmufit", &mut text);
    console.data(&String::from_utf8_lossy(&text));
    Ok(Exit::Success)
}
