//! `fmufit schema`: the JSON schemas of problem files, and of what `--json` prints.

use super::{check, info, validate};
use crate::arguments::{Document, SchemaOf};
use crate::console::Console;
use crate::error::{Error, ErrorDocument, Exit};
use crate::problem::ProblemRecord;
use calibration::FitDocument;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value};

pub(crate) fn run(arguments: &SchemaOf, console: &Console) -> Result<Exit, Error> {
    // What editors for TOML know.
    let generator = SchemaSettings::draft07().into_generator();
    let mut schema = match arguments.of {
        Document::Problem => generator.into_root_schema_for::<ProblemRecord>(),
        Document::Info => generator.into_root_schema_for::<info::Document>(),
        Document::Validate => generator.into_root_schema_for::<validate::Document>(),
        Document::Check => generator.into_root_schema_for::<check::Document>(),
        Document::Fit => generator.into_root_schema_for::<FitDocument>(),
        Document::Error => generator.into_root_schema_for::<ErrorDocument>(),
    };
    if arguments.of != Document::Problem {
        schema.as_object_mut().into_iter().flat_map(Map::values_mut).for_each(allow_null);
    }
    console.json(schema.as_value())?;
    Ok(Exit::Success)
}

/// In results null stands for numbers that are not finite.
fn allow_null(schema: &mut Value) {
    match schema {
        Value::Object(fields) => {
            if fields.get("type") == Some(&Value::from("number")) {
                fields.insert("type".to_owned(), ["number", "null"].as_slice().into());
            }
            fields.values_mut().for_each(allow_null);
        }
        Value::Array(items) => items.iter_mut().for_each(allow_null),
        _ => {}
    }
}
