//! Attributes as typed values. An invalid value is reported as a quirk and treated as missing.

use super::xml::Element;
use crate::description::limits::Reading;
use crate::description::model::QuirkKind;
use crate::error::{FmiError, Result};
use crate::value::{Value, VariableKind};
use std::borrow::Cow;

/// Attributes of one element.
pub(super) struct Attributes<'e> {
    file: &'static str,
    element: &'e str,
    pub(super) line: u32,
    reading: &'e Reading,
    pairs: Vec<(&'e str, Cow<'e, str>)>,
}

impl<'e> Attributes<'e> {
    pub(super) fn of(element: &'e Element<'_>) -> Result<Self> {
        Ok(Attributes {
            file: element.file,
            element: element.name(),
            line: element.line,
            reading: &element.reading,
            pairs: element.attributes()?,
        })
    }

    /// Returns the unmodified value.
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        self.pairs.iter().find(|(key, _)| *key == name).map(|(_, value)| value.as_ref())
    }

    /// Returns the value as an owned string.
    pub(super) fn text(&self, name: &str) -> Option<String> {
        self.get(name).filter(|text| self.reading.take_text(text)).map(str::to_owned)
    }

    /// Reserves memory for a list with one item per word of an attribute. If the memory is insufficient,
    /// returns false, and reading ends with the next element.
    fn may_list<T>(&self, name: &str) -> bool {
        // Items are collected in lists that double their capacity.
        let words = self.get(name).map_or(0, |text| text.split_ascii_whitespace().count());
        self.reading.take(words.saturating_mul(2 * size_of::<T>()))
    }

    /// Returns the value as an owned string. A missing value is reported as a quirk and replaced by an empty
    /// string.
    pub(super) fn expected(&self, name: &str) -> String {
        self.text(name).unwrap_or_else(|| {
            self.quirk(QuirkKind::Missing, || format!("<{}> has no attribute {name}", self.element));
            String::new()
        })
    }

    /// Returns a mandatory value. Without it the element cannot be used.
    pub(super) fn required(&self, name: &str) -> Result<&str> {
        self.get(name).ok_or_else(|| self.error(format!("missing attribute {name}")))
    }

    /// Returns a mandatory value as an owned string.
    pub(super) fn required_text(&self, name: &str) -> Result<String> {
        self.required(name)?;
        Ok(self.text(name).unwrap_or_default())
    }

    pub(super) fn error(&self, message: String) -> FmiError {
        FmiError::Description {
            file: self.file,
            line: self.line,
            message: format!("<{}>: {message}", self.element),
        }
    }

    /// Records a deviation from the standard.
    pub(super) fn quirk(&self, kind: QuirkKind, message: impl FnOnce() -> String) {
        self.reading.quirk(kind, self.line, message);
    }

    /// Returns the value converted by `parse`.
    fn parsed<T>(&self, name: &str, what: &str, parse: impl FnOnce(&str) -> Option<T>) -> Option<T> {
        let value = self.get(name)?;
        let parsed = parse(value.trim());
        if parsed.is_none() {
            self.quirk(QuirkKind::Attribute, || {
                format!("<{}>: {name}=\"{}\" is not {what}; ignored", self.element, shortened(value))
            });
        }
        parsed
    }

    pub(super) fn real(&self, name: &str) -> Option<f64> {
        self.parsed(name, "a number", parse_real)
    }

    pub(super) fn integer(&self, name: &str) -> Option<i32> {
        self.parsed(name, "an integer", parse_integer)
    }

    pub(super) fn hexadecimal(&self, name: &str) -> Option<Vec<u8>> {
        let n = self.get(name).map_or(0, str::len);
        self.parsed(name, "hexadecimal", |text| self.reading.take(n).then(|| parse_hexadecimal(text))?)
    }

    pub(super) fn wide_integer(&self, name: &str) -> Option<i64> {
        self.parsed(name, "an integer", |text| {
            parse_wide_integer(text, VariableKind::Int64).and_then(|value| i64::try_from(value).ok())
        })
    }

    /// Returns the start value of a variable of this kind. Several words are the elements of an array.
    pub(super) fn start(&self, kind: VariableKind, is_array: bool) -> Option<Value> {
        let one = |text: &str| match kind {
            VariableKind::Boolean | VariableKind::Clock => parse_boolean(text).map(Value::Boolean),
            VariableKind::String => self.reading.take_text(text).then(|| Value::String(text.to_owned())),
            VariableKind::Binary => parse_hexadecimal(text).map(Value::Binary),
            kind if kind.is_float() => parse_real(text).map(Value::Real),
            kind => parse_wide_integer(text, kind).map(Value::Integer),
        };
        if !is_array {
            // White space is part of a string.
            return match kind {
                VariableKind::String => self.text("start").map(Value::String),
                _ => self.parsed("start", "a value of its type", one),
            };
        }
        if !self.may_list::<Value>("start") {
            return None;
        }
        self.parsed("start", "a list of values of its type", |text| {
            text.split_ascii_whitespace().map(one).collect::<Option<Vec<Value>>>().map(Value::Array)
        })
    }

    pub(super) fn count(&self, name: &str) -> Option<u32> {
        self.parsed(name, "a non-negative integer", |text| text.parse().ok())
    }

    /// Returns the length of an array.
    pub(super) fn length(&self, name: &str) -> Result<Option<usize>> {
        let limit = self.reading.limits.elements;
        match self.count(name).map(|count| count as usize) {
            Some(count) if count > limit => Err(self.error(format!(
                "{name}=\"{count}\" exceeds the limit of {limit} elements (DescriptionLimits::elements)"
            ))),
            count => Ok(count),
        }
    }

    pub(super) fn boolean(&self, name: &str) -> Option<bool> {
        self.parsed(name, "true or false", parse_boolean)
    }

    /// Returns a capability or property; false if the attribute is missing.
    pub(super) fn flag(&self, name: &str) -> bool {
        self.boolean(name).unwrap_or(false)
    }

    /// Returns the meaning of one of these words.
    pub(super) fn choice<T: Copy>(&self, name: &str, words: &[(&str, T)]) -> Option<T> {
        self.parsed(name, "a value that the standard defines", |text| {
            words.iter().find(|(word, _)| *word == text).map(|(_, meaning)| *meaning)
        })
    }

    /// Returns a list of counts separated by white space.
    pub(super) fn counts(&self, name: &str) -> Option<Vec<u32>> {
        // Memory for the counts and for the indices derived from them.
        if !self.may_list::<(u32, usize)>(name) {
            return None;
        }
        self.parsed(name, "a list of non-negative integers", |text| {
            text.split_ascii_whitespace().map(|word| word.parse().ok()).collect()
        })
    }

    /// Returns the meanings of a list of words, each of which must be one of `words`.
    pub(super) fn choices<T: Copy>(&self, name: &str, words: &[(&str, T)]) -> Option<Vec<T>> {
        if !self.may_list::<T>(name) {
            return None;
        }
        self.parsed(name, "a list of values that the standard defines", |text| {
            let meaning = |text| words.iter().find(|(word, _)| *word == text).map(|(_, meaning)| *meaning);
            text.split_ascii_whitespace().map(meaning).collect()
        })
    }

    /// Returns the value reference of a variable.
    pub(super) fn value_reference(&self) -> Result<u32> {
        let text = self.required("valueReference")?.trim();
        text.parse().map_err(|_| {
            self.error(format!("valueReference=\"{}\" is not a value reference", shortened(text)))
        })
    }
}

/// Parses a number in XML Schema format, independent of the locale: "1e3", "-.5", "INF", "NaN".
pub(super) fn parse_real(text: &str) -> Option<f64> {
    text.parse().ok()
}

/// Parses an integer. Also accepts "3.0", because some tools write all numbers in this format.
pub(super) fn parse_integer(text: &str) -> Option<i32> {
    text.parse().ok().or_else(|| {
        let value: f64 = text.parse().ok()?;
        let integer = value as i32;
        (f64::from(integer) == value).then_some(integer)
    })
}

/// Parses an integer within the range of its type. Also accepts "3.0".
pub(super) fn parse_wide_integer(text: &str, kind: VariableKind) -> Option<i128> {
    let (least, most) = kind.range()?;
    let value = text.parse().ok().or_else(|| {
        let value: f64 = text.parse().ok()?;
        let integer = value as i128;
        (integer as f64 == value).then_some(integer)
    })?;
    (least..=most).contains(&value).then_some(value)
}

/// Parses bytes written as pairs of hexadecimal digits.
pub(super) fn parse_hexadecimal(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
    let digit = |b: u8| char::from(b).to_digit(16).map(|d| d as u8);
    if digits.len() % 2 == 1 {
        return None;
    }
    digits.chunks(2).map(|pair| Some(16 * digit(pair[0])? + digit(pair[1])?)).collect()
}

pub(super) fn parse_boolean(text: &str) -> Option<bool> {
    match text {
        "true" | "1" | "True" | "TRUE" => Some(true),
        "false" | "0" | "False" | "FALSE" => Some(false),
        _ => None,
    }
}

/// Truncates a long value for messages.
pub(super) fn shortened(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parse_real_accepts_xml_schema_numbers() {
        for (text, value) in [
            ("1e3", 1000.0),
            ("-.5", -0.5),
            ("+1.", 1.0),
            ("INF", f64::INFINITY),
            ("-INF", f64::NEG_INFINITY),
        ] {
            assert_eq!(parse_real(text), Some(value), "{text}");
        }
        assert!(parse_real("NaN").unwrap().is_nan());
        for text in ["", "1,5", "1d3", "0x10", "1 2", "one"] {
            assert_eq!(parse_real(text), None, "{text}");
        }
    }

    #[test]
    fn parse_integer_and_boolean_accept_common_variants() {
        for (text, value) in [
            ("3", Some(3)),
            ("-3", Some(-3)),
            ("+3", Some(3)),
            ("3.0", Some(3)),
            ("3.5", None),
            ("3000000000", None),
            ("NaN", None),
        ] {
            assert_eq!(parse_integer(text), value, "{text}");
        }
        assert_eq!(parse_boolean("1"), Some(true));
        assert_eq!(parse_boolean("False"), Some(false));
        assert_eq!(parse_boolean("yes"), None);
    }

    #[test]
    fn shortened_truncates_at_character_boundaries() {
        assert_eq!(shortened("abc"), "abc");
        assert_eq!(shortened(&"\u{e4}".repeat(100)), format!("{}...", "\u{e4}".repeat(60)));
    }
}
