//! References to variables in the lines of an FMU's log, replaced by names.

use crate::description::{ModelDescription, VariableKind};

/// Replaces `#r12#` (type letter and value reference) by the name of the variable and `##` by `#`
/// (FMI 2.0.x, section 2.1.5); anything else stays.
pub(crate) fn expand_references(text: &str, description: &ModelDescription) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('#') {
        out.push_str(&rest[..at]);
        let after = &rest[at + 1..];
        let replaced = after.find('#').and_then(|end| {
            let inner = &after[..end];
            let name = if inner.is_empty() { Some("#") } else { referenced(inner, description) };
            name.map(|name| (name, end))
        });
        if let Some((name, end)) = replaced {
            out.push_str(name);
            rest = &after[end + 1..];
        } else {
            out.push('#');
            rest = after;
        }
    }
    out.push_str(rest);
    out
}

/// The name behind `r12`.
fn referenced<'a>(inner: &str, description: &'a ModelDescription) -> Option<&'a str> {
    let mut chars = inner.chars();
    let letter = chars.next()?;
    let reference: u32 = chars.as_str().parse().ok()?;
    description
        .variables
        .iter()
        .find(|variable| variable.value_reference == reference && letter_of(variable.kind) == letter)
        .map(|variable| variable.name.as_str())
}

fn letter_of(kind: VariableKind) -> char {
    match kind {
        VariableKind::Real => 'r',
        VariableKind::Boolean => 'b',
        VariableKind::String => 's',
        // Types of FMI 3.0, whose messages have no references, cannot be meant.
        _ => 'i',
    }
}
