//! JSON schemas of the options of a fit and of a stage, including the options of the run.

use crate::fit::one_stage::FitRecord;
use crate::fit::several_stages::StageRecord;
use dfo::RequestedRun;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde_json::Value as Json;

/// Returns the schema of the options of a fit.
pub fn fit_schema(generator: &mut SchemaGenerator) -> Schema {
    with_run(FitRecord::json_schema(generator), generator)
}

/// Returns the schema of the options of a stage.
fn stage_schema(generator: &mut SchemaGenerator) -> Schema {
    with_run(StageRecord::json_schema(generator), generator)
}

/// Returns the schema of the options of several stages.
pub fn stages_schema(generator: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "array", "items": stage_schema(generator) })
}

fn with_run(of_fit: Schema, generator: &mut SchemaGenerator) -> Schema {
    let mut schema = RequestedRun::json_schema(generator);
    let of_fit = of_fit.get("properties").and_then(Json::as_object).cloned().unwrap_or_default();
    for rule in schema.get_mut("allOf").and_then(Json::as_array_mut).into_iter().flatten() {
        if let Some(names) = rule.pointer_mut("/then/propertyNames/enum").and_then(Json::as_array_mut) {
            names.extend(of_fit.keys().map(|name| Json::from(name.as_str())));
        }
    }
    if let Some(properties) = schema.get_mut("properties").and_then(Json::as_object_mut) {
        properties.extend(of_fit);
    }
    schema
}
