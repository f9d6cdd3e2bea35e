//! Options as text, for the fingerprint of a run and for errors about checkpoints that do not match.

use serde::Serialize;
use serde_json::Value;

/// Returns the fields of an options struct with their names.
pub(crate) fn fields(options: &impl Serialize) -> Vec<(String, String)> {
    match serde_json::to_value(options) {
        Ok(Value::Object(fields)) => fields.iter().map(|(name, value)| (name.clone(), text(value))).collect(),
        Ok(other) => vec![("options".to_owned(), text(&other))],
        Err(error) => vec![("options".to_owned(), error.to_string())],
    }
}

/// Returns the text of a named choice or of a list of choices.
pub(crate) fn word(value: &impl Serialize) -> String {
    serde_json::to_value(value).map_or_else(|error| error.to_string(), |value| text(&value))
}

/// Returns the text of a list of numbers, including infinite ones.
pub(crate) fn numbers(values: &[f64]) -> String {
    format!("{values:?}")
}

/// Returns the text of a limit, or "none".
pub(crate) fn limit(value: Option<usize>) -> String {
    value.map_or_else(|| "none".to_owned(), |value| value.to_string())
}

fn text(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::String(word) => word.clone(),
        Value::Number(number) => number.to_string(),
        Value::Array(values) => {
            let values: Vec<String> = values.iter().map(text).collect();
            format!("[{}]", values.join(", "))
        }
        Value::Object(fields) => {
            let field = |(name, value): (&String, &Value)| match value {
                Value::Object(_) => format!("{name} ({})", text(value)),
                _ => format!("{name} {}", text(value)),
            };
            fields.iter().map(field).collect::<Vec<_>>().join(", ")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AnyMethod, Coefficients, Genetic, Lookahead, MethodOptions, NelderMead, Selection};

    #[test]
    fn options_are_formatted_as_users_write_them() {
        let coefficients =
            Coefficients::Custom { reflection: 1.0, expansion: 1.5, contraction: 0.5, shrink: 0.9 };
        let options = NelderMead::default()
            .batch(Lookahead::Points(20))
            .coefficients(coefficients)
            .initial_steps(&[0.1, 2.0]);
        let reported = options.describe();
        let reported: Vec<String> = reported.iter().map(|(name, value)| format!("{name}: {value}")).collect();
        assert_eq!(
            reported,
            [
                "batch: 20",
                "bounds_handling: sine",
                "coefficients: custom (contraction 0.5, expansion 1.5, reflection 1.0, shrink 0.9)",
                "initial_simplex: steps [0.1, 2.0]",
                "restarts: 20",
            ]
        );
        let reported = Genetic::default().selection(Selection::Tournament(3)).describe();
        let of = |name: &str| reported.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str());
        assert_eq!(
            (of("selection"), of("gray"), of("mutation_rate")),
            (Some("tournament 3"), Some("yes"), Some("none"))
        );
    }

    #[test]
    fn option_texts_contain_no_program_syntax() {
        for name in AnyMethod::NAMES {
            for (option, value) in name.parse::<AnyMethod>().unwrap().describe() {
                let text = format!("{option} {value}");
                assert!(!text.contains(|c: char| c.is_uppercase() || "{}\"".contains(c)), "{name}: {text}");
            }
        }
        assert_eq!(numbers(&[-0.5, f64::INFINITY]), "[-0.5, inf]");
        assert_eq!((limit(None), limit(Some(7))), ("none".to_owned(), "7".to_owned()));
    }
}
