//! Plain values: named choices, encoding and records.

pub(crate) mod choices;
pub(crate) mod encoding;
pub(crate) mod fields;
pub(crate) mod nearest;
pub(crate) mod record;
