//! `fmufit schema`: the JSON schema of problem files.

use crate::console::Console;
use crate::error::{Error, Exit};
use crate::problem::ProblemRecord;
use schemars::generate::SchemaSettings;

pub(crate) fn run(console: &Console) -> Result<Exit, Error> {
    // What editors for TOML know.
    let schema = SchemaSettings::draft07().into_generator().into_root_schema_for::<ProblemRecord>();
    console.json(schema.as_value())?;
    Ok(Exit::Success)
}
