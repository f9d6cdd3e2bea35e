//! Validator for JSON schemas of draft 7 (json-schema.org, draft-handrews-json-schema-validation-01). It
//! supports the keywords that `fmufit schema` writes. Any other keyword is an error, so none is overlooked.

use serde_json::{Map, Value};

/// A schema with the definitions that it refers to.
pub(crate) struct Schema(Value);

impl Schema {
    pub(crate) fn new(schema: Value) -> Self {
        Self(schema)
    }

    /// Returns the errors of a document with their locations; empty if the document is valid.
    pub(crate) fn errors(&self, document: &Value) -> Vec<String> {
        let mut errors = Vec::new();
        self.check(&self.0, document, "", &mut errors);
        errors
    }

    fn is_valid(&self, schema: &Value, document: &Value) -> bool {
        let mut errors = Vec::new();
        self.check(schema, document, "", &mut errors);
        errors.is_empty()
    }

    fn check(&self, schema: &Value, document: &Value, place: &str, errors: &mut Vec<String>) {
        let schema = match schema {
            Value::Bool(true) => return,
            Value::Bool(false) => return errors.push(format!("{place}: no value is allowed here")),
            Value::Object(schema) => schema,
            other => panic!("no schema: {other}"),
        };
        for (keyword, rule) in schema {
            let n_valid = || items(rule).iter().filter(|part| self.is_valid(part, document)).count();
            let is_good = match keyword.as_str() {
                "$schema" | "title" | "description" | "default" | "definitions" | "format" | "then"
                | "additionalItems" => true,
                "$ref" => {
                    let path = rule.as_str().unwrap().strip_prefix('#').unwrap();
                    let part = self.0.pointer(path).unwrap_or_else(|| panic!("{path} is not defined"));
                    self.check(part, document, place, errors);
                    true
                }
                "type" => match rule {
                    Value::Array(types) => types.iter().any(|name| is_of(name, document)),
                    name => is_of(name, document),
                },
                "enum" => items(rule).contains(document),
                "pattern" => document.as_str().is_none_or(|text| matches(rule.as_str().unwrap(), text)),
                "const" => rule == document,
                "anyOf" => n_valid() > 0,
                "oneOf" => n_valid() == 1,
                "allOf" => n_valid() == items(rule).len(),
                "if" => !self.is_valid(rule, document) || self.is_valid(&schema["then"], document),
                "minimum" => document.as_f64().is_none_or(|number| number >= rule.as_f64().unwrap()),
                "maximum" => document.as_f64().is_none_or(|number| number <= rule.as_f64().unwrap()),
                "exclusiveMinimum" => document.as_f64().is_none_or(|number| number > rule.as_f64().unwrap()),
                "minItems" => document.as_array().is_none_or(|l| l.len() as u64 >= rule.as_u64().unwrap()),
                "maxItems" => document.as_array().is_none_or(|l| l.len() as u64 <= rule.as_u64().unwrap()),
                "items" => {
                    for (k, item) in document.as_array().into_iter().flatten().enumerate() {
                        let schema_of_item = match rule {
                            Value::Array(parts) => parts.get(k).unwrap_or(&Value::Bool(true)),
                            all => all,
                        };
                        self.check(schema_of_item, item, &format!("{place}/{k}"), errors);
                    }
                    true
                }
                "required" => document.as_object().is_none_or(|fields| {
                    items(rule).iter().all(|n| fields.contains_key(n.as_str().unwrap()))
                }),
                "propertyNames" => document
                    .as_object()
                    .is_none_or(|fields| fields.keys().all(|n| self.is_valid(rule, &n.clone().into()))),
                "properties" | "additionalProperties" => {
                    self.check_fields(keyword, schema, document, place, errors);
                    true
                }
                other => panic!("{place}: the keyword {other} is not known here"),
            };
            if !is_good {
                errors.push(format!("{place}: {document} is not {keyword} {rule}"));
            }
        }
    }

    fn check_fields(
        &self,
        keyword: &str,
        schema: &Map<String, Value>,
        document: &Value,
        place: &str,
        errors: &mut Vec<String>,
    ) {
        for (name, value) in document.as_object().into_iter().flatten() {
            let schema_of_field = schema.get("properties").and_then(|properties| properties.get(name));
            let rule = match keyword {
                "properties" => schema_of_field,
                _ if schema_of_field.is_some() => None,
                _ => schema.get(keyword),
            };
            if let Some(rule) = rule {
                self.check(rule, value, &format!("{place}/{name}"), errors);
            }
        }
    }
}

/// True if a text matches an expression `^(...|...)$` of single characters and character sets.
fn matches(pattern: &str, text: &str) -> bool {
    let pattern = pattern.strip_prefix("^(").and_then(|rest| rest.strip_suffix(")$")).unwrap();
    pattern.split('|').any(|word| {
        let mut rest = word;
        let is_next = |letter: char| {
            let (set, after) = match rest.strip_prefix('[') {
                Some(set) => set.split_once(']').unwrap(),
                None => rest.split_at(rest.chars().next().map_or(0, char::len_utf8)),
            };
            rest = after;
            set.contains(letter)
        };
        text.chars().all(is_next) && rest.is_empty()
    })
}

fn items(value: &Value) -> &[Value] {
    value.as_array().unwrap()
}

fn is_of(name: &Value, document: &Value) -> bool {
    match name.as_str().unwrap() {
        "null" => document.is_null(),
        "boolean" => document.is_boolean(),
        "string" => document.is_string(),
        "array" => document.is_array(),
        "object" => document.is_object(),
        "number" => document.is_number(),
        "integer" => document.as_f64().is_some_and(|number| number.fract() == 0.0),
        other => panic!("the type {other} is not known"),
    }
}

#[test]
fn validator_rejects_documents_that_violate_schema() {
    let schema = Schema::new(serde_json::json!({
        "type": "object",
        "properties": {
            "n": { "type": "integer", "minimum": 1, "maximum": 3 },
            "pair": { "type": "array", "items": [{ "type": "number" }, { "$ref": "#/definitions/word" }], "minItems": 2 },
            "word": { "pattern": "^([aA]b|[-_])$" },
            "one": { "oneOf": [{ "const": 1 }, { "type": "number", "exclusiveMinimum": 2 }] },
        },
        "required": ["n"],
        "additionalProperties": false,
        "if": { "required": ["one"] },
        "then": { "propertyNames": { "enum": ["n", "one"] } },
        "definitions": { "word": { "enum": ["a", "b"] } },
    }));
    for (text, n) in [
        (r#"{"n": 1, "pair": [1.5, "a"]}"#, 0),
        (r#"{"n": 3.0, "one": 2.5}"#, 0),
        (r#"{"n": 0}"#, 1),
        (r#"{"n": 4}"#, 1),
        (r#"{"n": 1.5}"#, 1),
        (r#"{}"#, 1),
        (r#"{"n": 1, "m": 1}"#, 1),
        (r#"{"n": 1, "pair": [1]}"#, 1),
        (r#"{"n": 1, "pair": ["a", "c"]}"#, 2),
        (r#"{"n": 1, "one": 2}"#, 1),
        (r#"{"n": 1, "word": "Ab"}"#, 0),
        (r#"{"n": 1, "word": "_"}"#, 0),
        (r#"{"n": 1, "word": "Abb"}"#, 1),
        (r#"{"n": 1, "word": "A"}"#, 1),
        (r#"{"n": 1, "one": 1, "pair": [1, "a"]}"#, 1),
        ("[]", 1),
    ] {
        let errors = schema.errors(&serde_json::from_str(text).unwrap());
        assert_eq!(errors.len(), n, "{text}: {errors:?}");
    }
}
