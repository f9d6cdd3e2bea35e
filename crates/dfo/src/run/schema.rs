//! JSON schema of the options of a run: the options of every run, and the options of the named method only.

use crate::methods::AnyMethod;
use crate::run::requested::{RequestedRun, RunRecord};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde_json::{Map, Value as Json, json};
use std::borrow::Cow;

impl JsonSchema for RequestedRun {
    fn schema_name() -> Cow<'static, str> {
        "Run".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut schema = RunRecord::json_schema(generator);
        let mut options = Map::new();
        let (mut words, mut rules) = (vec![json!("auto")], Vec::new());
        for (names, method) in AnyMethod::listed() {
            let of_method = method.option_schemas(generator);
            let of_run = schema.get("properties").and_then(Json::as_object);
            let allowed: Vec<&String> =
                of_run.into_iter().flat_map(Map::keys).chain(of_method.keys()).collect();
            rules.push(json!({
                "if": { "properties": { "method": { "enum": names } }, "required": ["method"] },
                "then": { "propertyNames": { "enum": allowed } },
            }));
            words.extend(names.into_iter().map(Json::from));
            for (name, shape) in of_method {
                // Several methods may have options with the same name.
                let shapes = options.entry(name).or_insert_with(|| json!([]));
                if let Some(shapes) = shapes.as_array_mut().filter(|shapes| !shapes.contains(&shape)) {
                    shapes.push(shape);
                }
            }
        }
        if let Some(properties) = schema.get_mut("properties").and_then(Json::as_object_mut) {
            if let Some(method) = properties.get_mut("method").and_then(Json::as_object_mut) {
                method.remove("type");
                method.insert("enum".to_owned(), words.into());
            }
            properties.extend(options.into_iter().map(|(name, shapes)| match shapes {
                Json::Array(mut shapes) if shapes.len() == 1 => (name, shapes.remove(0)),
                shapes => (name, json!({ "anyOf": shapes })),
            }));
        }
        schema.insert("allOf".to_owned(), rules.into());
        schema
    }
}
