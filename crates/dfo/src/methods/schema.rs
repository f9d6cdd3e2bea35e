//! JSON schemas of the options of methods, with the names and value forms that users write.

use crate::methods::option_names::shape;
use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value as Json, json};
use std::collections::BTreeSet;

/// Returns the schema of each option in `names`.
pub(super) fn option_schemas<T: JsonSchema>(
    _: &T,
    names: &BTreeSet<String>,
    generator: &mut SchemaGenerator,
) -> Map<String, Json> {
    let mut options = Map::new();
    collect(T::json_schema(generator).as_value(), generator, names, &mut options);
    options
}

/// Adds the options found in a schema. The fields of a variant count as options.
fn collect(
    schema: &Json,
    generator: &SchemaGenerator,
    names: &BTreeSet<String>,
    options: &mut Map<String, Json>,
) {
    let of_reference = || {
        let name = schema.get("$ref")?.as_str()?.rsplit('/').next()?;
        generator.definitions().get(name)
    };
    for part in
        of_reference().into_iter().chain(schema.get("oneOf").into_iter().flat_map(Json::as_array).flatten())
    {
        collect(part, generator, names, options);
    }
    for (name, shape_of_option) in schema.get("properties").and_then(Json::as_object).into_iter().flatten() {
        if names.contains(name) {
            let shape_of_option = match shape(name) {
                Some(also) => json!({ "anyOf": [shape_of_option, also] }),
                None => shape_of_option.clone(),
            };
            options.insert(name.clone(), shape_of_option);
        } else {
            collect(shape_of_option, generator, names, options);
        }
    }
}
