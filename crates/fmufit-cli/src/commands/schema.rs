//! `fmufit schema`: writes the JSON schemas of problem files and of `--json` output.

use super::{check, info, validate};
use crate::arguments::{Document, SchemaOf};
use crate::console::Console;
use crate::error::{Error, ErrorDocument, Exit};
use crate::problem::ProblemRecord;
use calibration::FitDocument;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

pub(crate) fn run(arguments: &SchemaOf, console: &Console) -> Result<Exit, Error> {
    // TOML editors support draft 7.
    let generator = SchemaSettings::draft07().into_generator();
    let mut schema = match arguments.of {
        Document::Problem => generator.into_root_schema_for::<ProblemRecord>(),
        Document::Info => generator.into_root_schema_for::<info::Document>(),
        Document::Validate => generator.into_root_schema_for::<validate::Document>(),
        Document::Check => generator.into_root_schema_for::<check::Document>(),
        Document::Fit => generator.into_root_schema_for::<FitDocument>(),
        Document::Error => generator.into_root_schema_for::<ErrorDocument>(),
    };
    let adapt = if arguments.of == Document::Problem { take_spellings } else { allow_null };
    schema.as_object_mut().into_iter().flat_map(Map::values_mut).for_each(adapt);
    console.json(schema.as_value())?;
    Ok(Exit::Success)
}

/// Accepts alternative spellings in problem files. Words are case-insensitive, - and _ are equivalent, and 0
/// and 1 mean false and true. The original words remain listed, because editors offer them.
fn take_spellings(schema: &mut Value) {
    match schema {
        Value::Object(fields) => {
            // The names of fields have only one spelling.
            let all = fields.iter_mut().filter(|(keyword, _)| *keyword != "propertyNames");
            all.for_each(|(_, value)| take_spellings(value));
            let kind = fields.get("type");
            if kind.is_some_and(|kind| *kind == "boolean" || *kind == json!(["boolean", "null"])) {
                fields.remove("type");
                fields.insert("enum".to_owned(), json!([true, false, 0, 1]));
            }
            for keyword in ["enum", "const"] {
                let words: Vec<&str> = match fields.get(keyword) {
                    Some(Value::Array(words)) => words.iter().filter_map(Value::as_str).collect(),
                    word => word.and_then(Value::as_str).into_iter().collect(),
                };
                if !words.is_empty() {
                    let pattern = words.iter().map(|word| spellings(word)).collect::<Vec<_>>().join("|");
                    let words = fields.remove(keyword);
                    let spelt = json!({ "type": "string", "pattern": format!("^({pattern})$") });
                    fields.insert("anyOf".to_owned(), json!([{ keyword: words }, spelt]));
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(take_spellings),
        _ => {}
    }
}

/// Returns the regular expression for the spellings of a word.
fn spellings(word: &str) -> String {
    let letter = |letter: char| match letter {
        '-' | '_' => "[-_]".to_owned(),
        letter if letter.is_ascii_alphabetic() => {
            format!("[{}{}]", letter.to_ascii_lowercase(), letter.to_ascii_uppercase())
        }
        other => other.to_string(),
    };
    word.chars().map(letter).collect()
}

/// Allows null in results, where it represents numbers that are not finite.
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
