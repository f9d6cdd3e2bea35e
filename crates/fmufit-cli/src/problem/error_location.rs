//! Locations in a problem file, for errors.

use dfo::Value;
use std::collections::BTreeMap;

/// Returns the path of a field in a document. A path consists of field names and list indices, for example
/// `experiments[0].outputs`.
pub(super) fn field(of: &str, name: &str) -> String {
    if of.is_empty() { name.to_owned() } else { format!("{of}.{name}") }
}

/// Returns the path of an item of a list.
pub(super) fn item(of: &str, index: usize) -> String {
    format!("{of}[{index}]")
}

/// Line numbers of the values of a document, by path.
#[derive(Debug, Default)]
pub(super) struct Lines(BTreeMap<String, usize>);

impl Lines {
    pub(super) fn add(&mut self, path: String, line: usize) {
        self.0.insert(path, line);
    }

    /// Returns the line of a value, or of the nearest value that contains it.
    pub(super) fn of(&self, path: &str) -> Option<usize> {
        let mut path = path;
        loop {
            if let Some(line) = self.0.get(path) {
                return Some(*line);
            }
            path = &path[..path.rfind(['.', '['])?];
        }
    }
}

/// Returns the path of the part of a value that a message names. The name is a field or string in quotes, or
/// a field at the start of the message. Otherwise, it is a file name, unquoted and followed by a colon.
pub(super) fn named_in(message: &str, value: &Value, path: &str) -> Option<String> {
    let is_quoted =
        |name: &str| ["'", "\""].iter().any(|quote| message.contains(&format!("{quote}{name}{quote}")));
    let is_first = |name: &str| message.strip_prefix(name).is_some_and(|rest| rest.starts_with([' ', ':']));
    let is_file = |text: &str| message.contains(&format!("{text}:"));
    find(value, path, &|name| is_quoted(name) || is_first(name), &is_quoted)
        .or_else(|| find(value, path, &|_| false, &is_file))
}

type Holds<'f> = dyn Fn(&str) -> bool + 'f;

/// Returns the path of the first matching field or string. Matches inside a field take precedence over the
/// field.
fn find(value: &Value, path: &str, of_field: &Holds<'_>, of_text: &Holds<'_>) -> Option<String> {
    match value {
        Value::Text(text) => of_text(text).then(|| path.to_owned()),
        Value::List(items) => items
            .iter()
            .enumerate()
            .find_map(|(k, item_value)| find(item_value, &item(path, k), of_field, of_text)),
        Value::Record(fields) => fields.iter().find_map(|(name, value)| {
            let path_of_field = field(path, name);
            find(value, &path_of_field, of_field, of_text).or_else(|| of_field(name).then_some(path_of_field))
        }),
        _ => None,
    }
}
