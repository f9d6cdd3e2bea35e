//! Texts of files as messages show them.

use std::borrow::Cow;

/// So many characters of a text are shown.
const LONGEST_SHOWN: usize = 60;

/// The text, or its beginning and its length.
pub(crate) fn shortened(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(LONGEST_SHOWN) {
        Some((end, _)) => Cow::Owned(format!("{}... ({} bytes)", &text[..end], text.len())),
        None => Cow::Borrowed(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_cut_between_characters() {
        assert_eq!(shortened("abc"), "abc");
        let long = "\u{e4}".repeat(70);
        assert_eq!(shortened(&long), format!("{}... (140 bytes)", "\u{e4}".repeat(60)));
    }
}
