//! Conversion of bytes to text. The encoding follows from the byte order mark or the declaration. Invalid
//! bytes become replacement characters.

use crate::description::model::QuirkKind;
use crate::description::quirks::Quirks;
use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE};
use std::borrow::Cow;

/// Number of bytes in which the XML declaration is searched.
const DECLARATION_BYTES: usize = 256;

/// Decodes a document. Text that needs no change is not copied.
pub(super) fn decode<'b>(bytes: Cow<'b, [u8]>, quirks: &mut Quirks) -> Cow<'b, str> {
    let (encoding, start) = Encoding::for_bom(&bytes).unwrap_or_else(|| (without_mark(&bytes, quirks), 0));
    let bytes = match bytes {
        Cow::Owned(bytes) if encoding == UTF_8 && start == 0 => match String::from_utf8(bytes) {
            Ok(text) => return Cow::Owned(text),
            Err(damaged) => Cow::Owned(damaged.into_bytes()),
        },
        bytes => bytes,
    };
    match bytes {
        Cow::Borrowed(bytes) => decode_body(encoding, &bytes[start..], quirks),
        Cow::Owned(bytes) => {
            let mut text = decode_body(encoding, &bytes[start..], quirks).into_owned();
            // Decoding buffers have the size of the worst case.
            text.shrink_to_fit();
            Cow::Owned(text)
        }
    }
}

/// Returns the encoding of a document, from its byte order mark or its declaration.
pub(in crate::description) fn encoding_of(bytes: &[u8]) -> &'static Encoding {
    let by_mark = Encoding::for_bom(bytes).map(|(encoding, _)| encoding);
    by_mark.unwrap_or_else(|| without_mark(bytes, &mut Quirks::default()))
}

fn decode_body<'b>(encoding: &'static Encoding, body: &'b [u8], quirks: &mut Quirks) -> Cow<'b, str> {
    let (text, damaged) = encoding.decode_without_bom_handling(body);
    if damaged {
        let line = match encoding == UTF_8 {
            true => first_bad_line(body),
            false => 0,
        };
        quirks.add(QuirkKind::Encoding, line, || {
            format!("invalid {} bytes were replaced by U+FFFD", encoding.name())
        });
    }
    text
}

/// Returns the encoding of a document without byte order mark.
fn without_mark(bytes: &[u8], quirks: &mut Quirks) -> &'static Encoding {
    match bytes {
        [b'<', 0, ..] => return UTF_16LE,
        [0, b'<', ..] => return UTF_16BE,
        _ => {}
    }
    let Some(label) = declared(bytes) else { return UTF_8 };
    match Encoding::for_label(label) {
        // The declaration was readable byte by byte, so the document cannot be in a two-byte encoding.
        Some(encoding) if encoding != UTF_16LE && encoding != UTF_16BE => encoding,
        _ => {
            quirks.add(QuirkKind::Encoding, 1, || {
                format!("encoding \"{}\" is wrong; read as UTF-8", String::from_utf8_lossy(label))
            });
            UTF_8
        }
    }
}

/// Returns the label in `encoding="..."` of the XML declaration.
fn declared(bytes: &[u8]) -> Option<&[u8]> {
    let start = &bytes[..bytes.len().min(DECLARATION_BYTES)];
    let start = start.trim_ascii_start().strip_prefix(b"<?xml")?;
    let end = start.windows(2).position(|pair| pair == b"?>")?;
    let declaration = &start[..end];
    let at = declaration.windows(8).position(|word| word == b"encoding")?;
    let value = declaration[at + 8..].trim_ascii_start().strip_prefix(b"=")?.trim_ascii_start();
    let (&quote, value) = value.split_first()?;
    let length = value.iter().position(|&byte| byte == quote)?;
    (quote == b'"' || quote == b'\'').then_some(&value[..length])
}

fn first_bad_line(bytes: &[u8]) -> u32 {
    let valid = match std::str::from_utf8(bytes) {
        Ok(_) => return 0,
        Err(error) => error.valid_up_to(),
    };
    1 + bytes[..valid].iter().filter(|&&byte| byte == b'\n').count() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(bytes: &[u8]) -> (String, Vec<String>) {
        let mut quirks = Quirks::default();
        let text = decode(bytes.into(), &mut quirks).into_owned();
        assert_eq!(decode(bytes.to_vec().into(), &mut Quirks::default()), text);
        (text, quirks.into_list().iter().map(ToString::to_string).collect())
    }

    #[test]
    fn decode_uses_the_byte_order_mark_or_the_declaration() {
        let latin = b"<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?><a b=\"\xb0C\"/>";
        assert!(decoded(latin).0.ends_with("\u{b0}C\"/>"));
        let single = b"<?xml version='1.0' encoding = 'windows-1252' ?><a b='\x80'/>";
        assert!(decoded(single).0.ends_with("'\u{20ac}'/>"));
        let utf16: Vec<u8> = "\u{feff}<a/>".encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert_eq!(decoded(&utf16), ("<a/>".to_owned(), vec![]));
        let unmarked: Vec<u8> = "<\u{e4}/>".encode_utf16().flat_map(u16::to_be_bytes).collect();
        assert_eq!(decoded(&unmarked), ("<\u{e4}/>".to_owned(), vec![]));
        assert_eq!(decoded(b"\xef\xbb\xbf<a/>"), ("<a/>".to_owned(), vec![]));
    }

    #[test]
    fn decode_borrows_valid_utf8() {
        let mut quirks = Quirks::default();
        assert!(matches!(decode("<\u{e4}/>".as_bytes().into(), &mut quirks), Cow::Borrowed(_)));
    }

    #[test]
    fn decode_replaces_invalid_bytes_and_reports_their_line() {
        let (text, quirks) = decoded(b"<a>\n\n\xff</a>");
        assert_eq!(text, "<a>\n\n\u{fffd}</a>");
        assert_eq!(quirks, ["line 3: invalid UTF-8 bytes were replaced by U+FFFD"]);
    }

    #[test]
    fn decode_reports_impossible_declarations() {
        for label in ["klingon", "UTF-16"] {
            let text = format!("<?xml version=\"1.0\" encoding=\"{label}\"?><a/>");
            let (decoded, quirks) = decoded(text.as_bytes());
            assert_eq!(decoded, text);
            assert!(quirks[0].contains(label), "{quirks:?}");
        }
        assert_eq!(declared(b"<?xml encoding"), None);
        assert_eq!(declared(b"<?xml encoding=?>"), None);
        assert_eq!(declared(b"<?xml encoding=\"a?>"), None);
    }
}
