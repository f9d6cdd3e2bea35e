//! Plain values: choices by name, bytes as text, records.

pub(crate) mod choices;
pub(crate) mod encoding;
pub(crate) mod fields;
pub(crate) mod nearest;
pub(crate) mod record;
