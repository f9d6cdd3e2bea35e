//! Plain values: choices by name, numbers as text, records.

pub(crate) mod choices;
pub(crate) mod number;
pub(crate) mod record;
