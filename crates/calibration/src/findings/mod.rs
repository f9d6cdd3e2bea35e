//! Findings of checks and fits, and the display of external names.

pub(crate) mod display_text;
pub(crate) mod finding;
pub(crate) mod identifier;
