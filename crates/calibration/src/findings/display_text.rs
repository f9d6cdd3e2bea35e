//! Safe display of external text and numbers in messages. The text is short, and it cannot move the cursor or
//! change the text direction.

use base::Number;
use fmi::FmiError;
use std::borrow::Cow;
use std::error::Error;

/// True for an invisible character that changes the display of others: control characters, line separators,
/// and characters that set the text direction (Unicode Standard Annex 9, section 2).
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escaped(text: &str, is_hidden: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if is_hidden(c) { shown.extend(c.escape_unicode()) } else { shown.push(c) }
    }
    Cow::Owned(shown)
}

/// Returns a text of several lines with hidden characters escaped, such as `\u{1b}` for an escape, because
/// terminals interpret them. Line breaks and tabulators are kept. Pass names in the text through
/// [`visible_line`] first, because they may also contain line breaks and tabulators.
pub fn visible(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_hidden(c) && c != '\n' && c != '\t')
}

/// Returns a name or another text of one line with all hidden characters escaped, such as `\u{a}` for a line
/// break. Variables, columns, units and descriptions may contain any character.
pub fn visible_line(text: &str) -> Cow<'_, str> {
    escaped(text, is_hidden)
}

/// Returns the message of an error on one line. Only compiler output keeps its lines.
pub fn visible_error(error: &(dyn Error + 'static)) -> String {
    let message = error.to_string();
    let mut cause = Some(error);
    while let Some(error) = cause {
        if matches!(error.downcast_ref(), Some(FmiError::CompileFailed { .. })) {
            return visible(&message).into_owned();
        }
        cause = error.source();
    }
    match marked(&message) {
        Some((head, formula, mark)) => {
            format!("{}\n{}\n{mark}", visible_line(head), visible_line(formula))
        }
        None => visible_line(&message).into_owned(),
    }
}

/// Splits a message whose last two lines are a formula and a mark below the mistake in it.
fn marked(message: &str) -> Option<(&str, &str, &str)> {
    let (rest, mark) = message.rsplit_once('\n').filter(|(_, mark)| mark.trim_start() == "^")?;
    let (head, formula) = rest.rsplit_once('\n')?;
    Some((head, formula, mark))
}

/// Maximum number of characters of a text in a message.
const LONGEST_SHOWN: usize = 60;

/// Returns the text, or its beginning and its length if it is long.
pub(crate) fn shortened(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(LONGEST_SHOWN) {
        Some((end, _)) => Cow::Owned(format!("{}... ({} bytes)", &text[..end], text.len())),
        None => Cow::Borrowed(text),
    }
}

/// Rounds a number to four digits.
pub(crate) fn digits(value: f64) -> Number {
    Number(format!("{value:.3e}").parse().unwrap_or(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn visible_escapes_characters_that_move_the_cursor_or_set_the_direction() {
        assert!(matches!(visible("k in \u{b5}m\n\tz \u{5d0}"), Cow::Borrowed(_)));
        assert_eq!(visible("a\u{1b}[2Jb\r\u{202e}c\u{9b}"), "a\\u{1b}[2Jb\\u{d}\\u{202e}c\\u{9b}");
        assert_eq!(visible_line("a\nb\tc\u{2028}"), "a\\u{a}b\\u{9}c\\u{2028}");
    }

    #[test]
    fn shortened_cuts_long_text_between_characters() {
        assert_eq!(shortened("abc"), "abc");
        let long = "\u{e4}".repeat(70);
        assert_eq!(shortened(&long), format!("{}... (140 bytes)", "\u{e4}".repeat(60)));
    }

    #[test]
    fn marks_below_formulas_keep_their_lines() {
        let error = crate::CalibrationError::Setup("k\n3: unknown\n    1 - k\u{b}\n        ^".to_owned());
        assert_eq!(visible_error(&error), "k\\u{a}3: unknown\n    1 - k\\u{b}\n        ^");
    }
}
