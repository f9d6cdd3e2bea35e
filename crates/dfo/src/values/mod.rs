//! Plain values: choices by name, numbers as text, bytes, records.

pub(crate) mod choices;
pub(crate) mod encoding;
pub(crate) mod fields;
pub(crate) mod nearest;
pub(crate) mod number;
pub(crate) mod record;
