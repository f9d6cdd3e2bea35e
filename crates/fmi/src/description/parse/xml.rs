//! XML reader that returns one element at a time. It rejects document type definitions, limits depth and
//! attributes, and reports lines in all errors.

use crate::description::limits::Reading;
use crate::error::{FmiError, Result};
use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::borrow::Cow;
use std::rc::Rc;

/// Maximum depth of elements. Model descriptions need 5 levels; annotations of tools need some more.
const DEEPEST: usize = 128;
/// Maximum number of attributes of an element. The standard defines elements with 20.
const MOST_ATTRIBUTES: usize = 64;
/// Number of events between two checks of the cancellation flag.
const EVENTS_BETWEEN_LOOKS: u32 = 32;

/// Document that is read sequentially from start to end.
pub(super) struct Xml<'a> {
    reader: Reader<&'a [u8]>,
    /// Name of the file, for messages.
    file: &'static str,
    text: &'a str,
    reading: Rc<Reading>,
    /// Number of open elements.
    depth: usize,
    /// Number of events read.
    n_events: u32,
    /// Byte position up to which lines are counted, and the line number there.
    counted: usize,
    line: u32,
}

/// Start of an element.
pub(super) struct Element<'a> {
    start: BytesStart<'a>,
    pub(super) file: &'static str,
    pub(super) reading: Rc<Reading>,
    /// Line in which the element starts.
    pub(super) line: u32,
    /// Depth of the element; the root has depth 1.
    pub(super) level: usize,
}

impl<'a> Xml<'a> {
    pub(super) fn new(text: &'a str, file: &'static str, reading: Rc<Reading>) -> Result<Self> {
        let mut reader = Reader::from_str(text);
        reader.config_mut().expand_empty_elements = true;
        let mut xml = Xml { reader, file, text, reading, depth: 0, n_events: 0, counted: 0, line: 1 };
        // NUL is not allowed in XML, and would truncate strings that are later passed to C.
        match text.find('\0') {
            Some(at) => Err(xml.error_at(at as u64, "NUL characters are not allowed")),
            None => Ok(xml),
        }
    }

    /// Returns the root element.
    pub(super) fn root(&mut self) -> Result<Element<'a>> {
        match self.child(0)? {
            Some(root) => Ok(root),
            None => Err(self.error("the file contains no element")),
        }
    }

    /// Returns the root element, which must have this name.
    pub(super) fn root_named(&mut self, name: &str) -> Result<Element<'a>> {
        let root = self.root()?;
        if root.name() == name {
            return Ok(root);
        }
        Err(self.error(format!("the root element is <{}>; expected <{name}>", root.name())))
    }

    /// Returns the next child of the element at `level`, or `None` at its end. Skips the remaining content of
    /// the previously returned child.
    pub(super) fn child(&mut self, level: usize) -> Result<Option<Element<'a>>> {
        if let Some(complaint) = self.reading.complaint() {
            return Err(self.error(complaint));
        }
        loop {
            if self.n_events.is_multiple_of(EVENTS_BETWEEN_LOOKS) {
                self.reading.cancel.check()?;
            }
            self.n_events = self.n_events.wrapping_add(1);
            let before = self.reader.buffer_position();
            match self.reader.read_event() {
                Ok(Event::Start(start)) => {
                    self.depth += 1;
                    if self.depth > DEEPEST {
                        return Err(self.error_at(
                            before,
                            format!("elements are nested more than {DEEPEST} levels deep"),
                        ));
                    }
                    if self.depth == level + 1 {
                        return Ok(Some(Element {
                            start,
                            file: self.file,
                            reading: Rc::clone(&self.reading),
                            line: self.line_at(before),
                            level: self.depth,
                        }));
                    }
                }
                Ok(Event::End(_)) => {
                    self.depth = self.depth.saturating_sub(1);
                    if self.depth < level {
                        return Ok(None);
                    }
                }
                Ok(Event::DocType(_)) => {
                    return Err(self.error_at(before, "document type definitions are not supported"));
                }
                Ok(Event::Eof) if self.depth == 0 => return Ok(None),
                Ok(Event::Eof) => {
                    return Err(
                        self.error_at(before, format!("the file ends with {} unclosed elements", self.depth))
                    );
                }
                Ok(_) => {}
                Err(error) => {
                    let at = self.reader.error_position().max(before);
                    return Err(self.error_at(at, error.to_string()));
                }
            }
        }
    }

    /// Returns the next child of the element at `level` that has one of these names.
    pub(super) fn named(&mut self, level: usize, names: &[&str]) -> Result<Option<Element<'a>>> {
        loop {
            match self.child(level)? {
                Some(element) if !names.contains(&element.name()) => {}
                found => return Ok(found),
            }
        }
    }

    /// Returns the line of a byte position. Positions must not decrease from call to call.
    fn line_at(&mut self, position: u64) -> u32 {
        let position = (position as usize).min(self.text.len());
        if position > self.counted {
            let between = &self.text.as_bytes()[self.counted..position];
            self.line += between.iter().filter(|&&byte| byte == b'\n').count() as u32;
            self.counted = position;
        }
        self.line
    }

    fn error_at(&mut self, position: u64, message: impl Into<String>) -> FmiError {
        FmiError::Description { file: self.file, line: self.line_at(position), message: message.into() }
    }

    /// Returns an error at the current position.
    pub(super) fn error(&mut self, message: impl Into<String>) -> FmiError {
        let position = self.reader.buffer_position();
        self.error_at(position, message)
    }
}

impl Element<'_> {
    /// Returns the name without namespace prefix.
    pub(super) fn name(&self) -> &str {
        self.start.local_name().into_inner()
    }

    /// Returns the names and values of the attributes, in file order.
    pub(super) fn attributes(&self) -> Result<Vec<(&str, Cow<'_, str>)>> {
        let error = |message: String| FmiError::Description {
            file: self.file,
            line: self.line,
            message: format!("<{}>: {message}", self.name()),
        };
        let mut pairs: Vec<(&str, Cow<'_, str>)> = Vec::with_capacity(8);
        // The library's check for duplicates does not limit the number of attributes.
        for attribute in self.start.attributes().with_checks(false) {
            let attribute = attribute.map_err(|reason| error(reason.to_string()))?;
            let key = attribute.key.into_inner();
            if pairs.len() == MOST_ATTRIBUTES {
                return Err(error(format!("more than {MOST_ATTRIBUTES} attributes")));
            }
            if pairs.iter().any(|(name, _)| *name == key) {
                return Err(error(format!("duplicate attribute {key}")));
            }
            let value = attribute
                .normalized_value(XmlVersion::Explicit1_0)
                .map_err(|reason| error(format!("attribute {key}: {reason}")))?;
            pairs.push((key, value));
        }
        Ok(pairs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::MODEL_DESCRIPTION;

    fn walk(text: &str) -> Result<Vec<String>> {
        let mut xml = Xml::new(text, MODEL_DESCRIPTION, Rc::default())?;
        let root = xml.root()?;
        let mut seen = vec![format!("{}:{}", root.name(), root.line)];
        while let Some(child) = xml.child(root.level)? {
            let attributes = child.attributes()?;
            seen.push(format!("{}:{}:{}", child.name(), child.line, attributes.len()));
        }
        Ok(seen)
    }

    fn refusal(text: &str) -> String {
        walk(text).unwrap_err().to_string()
    }

    #[test]
    fn child_returns_lines_and_skips_grandchildren() {
        let text = "<?xml version=\"1.0\"?>\n<!-- c -->\n<n:a>\n<b x='1'\n y='2'/>\n<c><d><e/></d>text &amp;</c>\n</n:a>\n";
        assert_eq!(walk(text).unwrap(), ["a:3", "b:4:2", "c:6:0"]);
    }

    #[test]
    fn xml_rejects_entities() {
        let bomb = "<?xml version=\"1.0\"?>\n<!DOCTYPE a [<!ENTITY b \"bb\"><!ENTITY c \"&b;&b;\">]>\n<a b=\"&c;\"/>";
        assert_eq!(
            refusal(bomb),
            "modelDescription.xml, line 2: document type definitions are not supported"
        );
        assert!(refusal("<a><b c='&bomb;'/></a>").contains("<b>: attribute c"));
    }

    #[test]
    fn xml_limits_depth_and_number_of_attributes() {
        let deep = format!("{}{}", "<a>\n".repeat(1000), "</a>".repeat(1000));
        assert_eq!(
            refusal(&deep),
            "modelDescription.xml, line 129: elements are nested more than 128 levels deep"
        );
        let many: String = (0..300).map(|i| format!(" a{i}='1'")).collect();
        assert!(refusal(&format!("<r><a{many}/></r>")).contains("more than 64 attributes"));
    }

    #[test]
    fn xml_rejects_damaged_documents_with_their_lines() {
        for (text, line, part) in [
            ("", 1, "no element"),
            ("just text", 1, "no element"),
            ("<a>\n<b>\n", 3, "2 unclosed elements"),
            ("<a>\n</b>\n", 2, "b"),
            ("<a>\n<b", 2, ""),
            ("<a>\n<b c='1' c='2'/></a>", 2, "duplicate attribute c"),
            ("<a>\n<b c=1/></a>", 2, "<b>"),
            ("<a>\n\0</a>", 2, "NUL"),
        ] {
            let message = refusal(text);
            assert!(
                message.contains(&format!("line {line}:")) && message.contains(part),
                "{text:?}: {message}"
            );
        }
    }

    #[test]
    fn attributes_unescape_values_and_normalize_white_space() {
        let mut xml =
            Xml::new("<a b=\"&lt;&#228;&#x62;\n&quot;\"/>", MODEL_DESCRIPTION, Rc::default()).unwrap();
        let root = xml.root().unwrap();
        assert_eq!(root.attributes().unwrap()[0].1, "<\u{e4}b \"");
    }
}
