//! What a call into an FMU returned.

use std::fmt;

/// What a call into an FMU returned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Status {
    /// Done.
    Ok,
    /// Done, with something to say about it.
    Warning,
    /// Not possible at this point; nothing is broken.
    Discard,
    /// The instance cannot go on; it can be freed or reset.
    Error,
    /// The instance is broken beyond repair.
    Fatal,
    /// Not finished yet (co-simulation only).
    Pending,
    /// The library does not offer the function.
    Missing,
    /// A number that the standard does not know.
    Unknown(i32),
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Status::Ok => f.write_str("ok"),
            Status::Warning => f.write_str("warning"),
            Status::Discard => f.write_str("discard"),
            Status::Error => f.write_str("error"),
            Status::Fatal => f.write_str("fatal"),
            Status::Pending => f.write_str("pending"),
            Status::Missing => f.write_str("that there is no such function"),
            Status::Unknown(code) => write!(f, "the unknown status {code}"),
        }
    }
}
