//! Texts of files, and numbers, as messages show them: nothing in them moves a cursor, or changes the
//! direction of what is read, and they are not long.

use base::Number;
use std::borrow::Cow;

/// True for a character that is not shown, but changes those that are: control characters but the line break
/// and the tabulator, and those that set the direction of text (Unicode Standard Annex 9, section 2).
fn is_hidden(c: char) -> bool {
    (c.is_control() && c != '\n' && c != '\t')
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// The text with such characters as their numbers, `\u{1b}` for an escape: names in an FMU or in a recording
/// may hold some, and terminals act on them.
pub fn visible(text: &str) -> Cow<'_, str> {
    if !text.contains(is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if is_hidden(c) { shown.extend(c.escape_unicode()) } else { shown.push(c) }
    }
    Cow::Owned(shown)
}

/// So many characters of a text are shown.
const LONGEST_SHOWN: usize = 60;

/// The text, or its beginning and its length.
pub(crate) fn shortened(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(LONGEST_SHOWN) {
        Some((end, _)) => Cow::Owned(format!("{}... ({} bytes)", &text[..end], text.len())),
        None => Cow::Borrowed(text),
    }
}

/// A number with four digits.
pub(crate) fn digits(value: f64) -> Number {
    Number(format!("{value:.3e}").parse().unwrap_or(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_the_cursor_or_the_direction_is_shown_by_its_number() {
        assert!(matches!(visible("k in \u{b5}m\n\tz \u{5d0}"), Cow::Borrowed(_)));
        assert_eq!(visible("a\u{1b}[2Jb\r\u{202e}c\u{9b}"), "a\\u{1b}[2Jb\\u{d}\\u{202e}c\\u{9b}");
    }

    #[test]
    fn long_texts_are_cut_between_characters() {
        assert_eq!(shortened("abc"), "abc");
        let long = "\u{e4}".repeat(70);
        assert_eq!(shortened(&long), format!("{}... (140 bytes)", "\u{e4}".repeat(60)));
    }
}
