//! Places in a problem file, as errors name them.

use dfo::Value;
use std::collections::BTreeMap;

/// Path of a value in a document: names of fields, and numbers in lists, as `experiments[0].outputs`.
pub(super) fn field(of: &str, name: &str) -> String {
    if of.is_empty() { name.to_owned() } else { format!("{of}.{name}") }
}

/// Path of an item of a list.
pub(super) fn item(of: &str, index: usize) -> String {
    format!("{of}[{index}]")
}

/// Lines of the values of a document, by their paths.
#[derive(Debug, Default)]
pub(super) struct Lines(BTreeMap<String, usize>);

impl Lines {
    pub(super) fn add(&mut self, path: String, line: usize) {
        self.0.insert(path, line);
    }

    /// The line of a value, or of the nearest that it is part of.
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

/// The path of what a message names within a value: a field or a text in quotes, or a field at its start;
/// else a file, which stands without quotes, and before a colon.
pub(super) fn named_in(message: &str, value: &Value, path: &str) -> Option<String> {
    let is_quoted =
        |name: &str| ["'", "\""].iter().any(|quote| message.contains(&format!("{quote}{name}{quote}")));
    let is_first = |name: &str| message.strip_prefix(name).is_some_and(|rest| rest.starts_with([' ', ':']));
    let is_file = |text: &str| message.contains(&format!("{text}:"));
    find(value, path, &|name| is_quoted(name) || is_first(name), &is_quoted)
        .or_else(|| find(value, path, &|_| false, &is_file))
}

type Holds<'f> = dyn Fn(&str) -> bool + 'f;

/// The path of the first field, or text, for which this holds; what is inside of a field goes first.
fn find(value: &Value, path: &str, of_field: &Holds<'_>, of_text: &Holds<'_>) -> Option<String> {
    match value {
        Value::Text(text) => of_text(text).then(|| path.to_owned()),
        Value::List(items) => {
            items.iter().enumerate().find_map(|(k, own)| find(own, &item(path, k), of_field, of_text))
        }
        Value::Record(fields) => fields.iter().find_map(|(name, value)| {
            let own = field(path, name);
            find(value, &own, of_field, of_text).or_else(|| of_field(name).then_some(own))
        }),
        _ => None,
    }
}
