//! Changes start values in the text of a `modelDescription.xml`. All other bytes stay unchanged.

use super::model::ModelDescription;
use super::parse::encoding_of;
use crate::archive::MODEL_DESCRIPTION;
use crate::error::{FmiError, Result};
use encoding_rs::{Encoding, UTF_16BE, UTF_16LE};
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::collections::BTreeMap;
use std::ops::Range;

/// Byte order mark of two-byte encodings. The UTF-8 mark is decoded to three characters here.
const MARK: char = '\u{feff}';

/// Elements of FMI 1.0 and 2.0 that contain the start value of a variable.
const TYPES: [&str; 5] = ["Real", "Integer", "Boolean", "String", "Enumeration"];

/// Returns the document with other start values. `starts` maps variable indices to attribute values. An
/// element without `start` gets the attribute.
///
/// # Errors
/// Returns [`FmiError::Description`] if the document does not match the description, or a variable is not
/// found in it.
pub(crate) fn with_start_texts(
    bytes: &[u8],
    description: &ModelDescription,
    starts: &BTreeMap<usize, String>,
) -> Result<Vec<u8>> {
    let document = Text::of(bytes);
    let mut edits: Vec<(Range<usize>, String)> = Vec::new();
    let mut found = std::collections::BTreeSet::new();
    let bad = |message: String| FmiError::Description { file: MODEL_DESCRIPTION, line: 1, message };
    let mut reader = Reader::from_str(&document.text);
    // Names of the open elements.
    let mut path: Vec<String> = Vec::new();
    // FMI 1.0 and 2.0: variable whose type element comes next.
    let mut waiting: Option<usize> = None;
    loop {
        let before = reader.buffer_position() as usize;
        let event = reader.read_event().map_err(|e| bad(e.to_string()))?;
        let end = reader.buffer_position() as usize;
        let (start, is_empty) = match event {
            Event::Start(start) => (start, false),
            Event::Empty(start) => (start, true),
            Event::End(_) => {
                path.pop();
                continue;
            }
            Event::Eof => break,
            _ => continue,
        };
        let name = start.local_name().as_ref().to_owned();
        let is_variable = path.len() == 2 && path[1] == "ModelVariables";
        let is_type = path.len() == 3 && path[1] == "ModelVariables" && path[2] == "ScalarVariable";
        let variable = match () {
            () if is_variable => document.name_of(&start).and_then(|name| description.variable_index(&name)),
            () if is_type && TYPES.contains(&name.as_str()) => waiting.take(),
            () => None,
        };
        match variable {
            Some(index) if is_variable && name == "ScalarVariable" => waiting = Some(index),
            Some(index) => {
                if let Some(text) = starts.get(&index)
                    && found.insert(index)
                {
                    edits.push(edit(&document.text[before..end], before, text).ok_or_else(|| {
                        bad(format!("the element of '{}' cannot be read", description.variables[index].name))
                    })?);
                }
            }
            None => {}
        }
        if !is_empty {
            path.push(name);
        }
    }
    if let Some(missing) = starts.keys().find(|index| !found.contains(index)) {
        let name = description.variables.get(*missing).map_or("", |variable| &variable.name);
        return Err(bad(format!("the variable '{name}' was not found")));
    }
    Ok(document.with(edits))
}

/// Returns the edit that sets the start value of an element. `at` is the position of its tag.
fn edit(tag: &str, at: usize, text: &str) -> Option<(Range<usize>, String)> {
    let after_name = 1 + tag[1..].find(|c: char| c.is_ascii_whitespace() || c == '/' || c == '>')?;
    let mut rest = after_name;
    // The reader has already checked that the attributes are well formed.
    while let Some(length) = tag[rest..].find('=') {
        let name = tag[rest..rest + length].trim_ascii();
        let quoted = rest + length + 1 + tag[rest + length + 1..].find(['"', '\''])?;
        let quote = char::from(*tag.as_bytes().get(quoted)?);
        let close = quoted + 1 + tag[quoted + 1..].find(quote)?;
        if name == "start" {
            return Some((at + quoted + 1..at + close, text.to_owned()));
        }
        rest = close + 1;
    }
    Some((at + after_name..at + after_name, format!(" start=\"{text}\"")))
}

/// Document as text that preserves every byte. Two-byte encodings are decoded; in all other encodings each
/// byte becomes one character.
struct Text {
    encoding: &'static Encoding,
    /// True if a byte order mark precedes the text.
    is_marked: bool,
    text: String,
}

impl Text {
    fn of(bytes: &[u8]) -> Self {
        let encoding = encoding_of(bytes);
        let is_wide = encoding == UTF_16LE || encoding == UTF_16BE;
        let text = match is_wide {
            true => encoding.decode_without_bom_handling(bytes).0.into_owned(),
            false => bytes.iter().map(|byte| char::from(*byte)).collect(),
        };
        // The reader does not count the byte order mark.
        let text: String = text;
        let is_marked = text.starts_with(MARK);
        Self { encoding, is_marked, text: text.trim_start_matches(MARK).to_owned() }
    }

    fn is_wide(&self) -> bool {
        self.encoding == UTF_16LE || self.encoding == UTF_16BE
    }

    /// Returns the `name` attribute of an element, decoded as in the description.
    fn name_of(&self, start: &BytesStart<'_>) -> Option<String> {
        let raw = start.try_get_attribute("name").ok()??.value;
        let raw = raw.into_owned();
        let text = match self.is_wide() {
            true => raw,
            false => {
                let bytes: Vec<u8> = raw.chars().map(|c| c as u8).collect();
                self.encoding.decode_without_bom_handling(&bytes).0.into_owned()
            }
        };
        quick_xml::escape::unescape(&text).ok().map(|name| name.into_owned())
    }

    /// Returns the bytes after these edits. The edits are in ascending order.
    fn with(&self, edits: Vec<(Range<usize>, String)>) -> Vec<u8> {
        let mut text = self.text.clone();
        for (place, new) in edits.into_iter().rev() {
            text.replace_range(place, &new);
        }
        if self.is_marked {
            text.insert(0, MARK);
        }
        match self.encoding {
            encoding if encoding == UTF_16LE => text.encode_utf16().flat_map(u16::to_le_bytes).collect(),
            encoding if encoding == UTF_16BE => text.encode_utf16().flat_map(u16::to_be_bytes).collect(),
            _ => text.chars().map(|c| c as u8).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(document: &[u8], starts: &[(&str, &str)]) -> Vec<u8> {
        let description = ModelDescription::parse(document).unwrap();
        let of =
            |(name, text): &(&str, &str)| (description.variable_index(name).unwrap(), (*text).to_owned());
        with_start_texts(document, &description, &starts.iter().map(of).collect()).unwrap()
    }

    const FMI2: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<!-- <Real start="9"/> -->
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g">
  <CoSimulation modelIdentifier="m"/>
  <ModelVariables>
    <ScalarVariable name="k" valueReference="1" causality="parameter" variability="fixed">
      <Real  unit = '=start=' start = '1.0' min="0"/> <Annotations><Tool name="t"><Real start="5"/></Tool></Annotations>
    </ScalarVariable>
    <ScalarVariable name="&lt;T&#228;&gt;" valueReference="2" causality="parameter" variability="fixed"><Real start="2"/></ScalarVariable>
    <ScalarVariable name="open" valueReference="3" causality="input"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure/>
</fmiModelDescription>
"#;

    #[test]
    fn with_start_texts_changes_only_start_values() {
        let new = changed(FMI2.as_bytes(), &[("k", "0.25"), ("<T\u{e4}>", "-3e-5"), ("open", "7")]);
        let expected = FMI2
            .replace("start = '1.0'", "start = '0.25'")
            .replace("<Real start=\"2\"/>", "<Real start=\"-3e-5\"/>")
            .replace("<Real/>", "<Real start=\"7\"/>");
        assert_eq!(String::from_utf8(new).unwrap(), expected);
    }

    #[test]
    fn with_start_texts_preserves_bytes_in_every_encoding() {
        let name = FMI2.replace("&lt;T&#228;&gt;", "T\u{e4}");
        let new = name.replace("start=\"2\"", "start=\"8.5\"");
        let change = |bytes: Vec<u8>| changed(&bytes, &[("T\u{e4}", "8.5")]);
        assert_eq!(change(name.clone().into_bytes()), new.as_bytes());
        let marked = |text: &str| [b"\xef\xbb\xbf", text.as_bytes()].concat();
        assert_eq!(change(marked(&name)), marked(&new));
        let latin = |text: &str| -> Vec<u8> {
            text.replace("UTF-8", "ISO-8859-1").chars().map(|c| c as u8).collect()
        };
        assert_eq!(change(latin(&name)), latin(&new));
        let wide = |text: &str| -> Vec<u8> {
            let text = text.replace(" encoding=\"UTF-8\"", "");
            std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect()
        };
        assert_eq!(change(wide(&name)), wide(&new));
        // Bytes that are invalid in the encoding stay unchanged.
        let damaged = |text: &str| [text.as_bytes(), b"<!-- \xff -->"].concat();
        assert_eq!(change(damaged(&name)), damaged(&new));
    }

    #[test]
    fn with_start_texts_edits_fmi3_variable_elements() {
        let document = r#"<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="g"><CoSimulation modelIdentifier="m"/>
<ModelVariables><Float64 name="a" valueReference="1" causality="parameter" variability="fixed" start="1 2 3"><Dimension start="3"/></Float64>
<Int32 name="n" valueReference="2" causality="parameter" variability="fixed" start="4"><Alias name="start" description="start=5"/></Int32>
</ModelVariables><ModelStructure/></fmiModelDescription>"#;
        let new = changed(document.as_bytes(), &[("a", "1 0.5 3"), ("n", "6")]);
        let expected = document.replace("1 2 3", "1 0.5 3").replace("start=\"4\"", "start=\"6\"");
        assert_eq!(String::from_utf8(new).unwrap(), expected);
    }
}
