//! Findings of checks and fits, and how names from elsewhere are shown.

pub(crate) mod finding;
pub(crate) mod shown_text;
