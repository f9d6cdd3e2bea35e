//! Error of a formula, with the column of the mistake.

use std::fmt;

/// Number of characters shown on either side of a mistake.
const SHOWN: usize = 60;

/// Mistake in an expression or a relation. `Display` shows the text with a caret below the mistake.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct ExpressionError {
    /// The text.
    pub text: String,
    /// Column of the mistake in characters, from 1.
    pub column: usize,
    message: String,
}

impl ExpressionError {
    pub(crate) fn new(text: &str, column: usize, message: impl Into<String>) -> Self {
        Self { text: text.to_owned(), column, message: message.into() }
    }

    /// Returns the description of the mistake, without the text.
    pub fn message(&self) -> &str {
        &self.message
    }
}

impl fmt::Display for ExpressionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (column {})", self.message, self.column)?;
        if self.text.trim().is_empty() {
            return Ok(());
        }
        let at = self.column - 1;
        let (from, n) = (at.saturating_sub(SHOWN), self.text.chars().count());
        let (before, after) = (if from > 0 { "..." } else { "" }, if n > at + SHOWN { "..." } else { "" });
        // A control character would move the caret.
        let plain = |c: char| if c.is_control() { ' ' } else { c };
        let shown: String = self.text.chars().skip(from).take(at - from + SHOWN).map(plain).collect();
        let indent = " ".repeat(before.len() + at - from);
        write!(f, "\n    {before}{}{after}\n    {indent}^", shown.trim_end())
    }
}

impl std::error::Error for ExpressionError {}
