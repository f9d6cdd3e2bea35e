//! Findings of checks and fits, and the display of external names.

pub(crate) mod finding;
pub(crate) mod identifier;
pub(crate) mod shown_text;
