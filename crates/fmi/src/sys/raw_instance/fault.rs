//! Faults of a call: the reasons why it returned no result.

use crate::error::CallFailure;
use std::path::PathBuf;

/// Sizes of the model's vectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sizes {
    pub(crate) states: usize,
    pub(crate) indicators: usize,
}

/// Why a call did not deliver. Making a `Discard` allocates nothing.
#[derive(Debug)]
pub(crate) enum Fault {
    /// Not possible at this point.
    Discard(&'static str),
    /// Anything worse.
    Failed(Box<CallFailure>),
    /// The library has no such function.
    Missing(&'static str),
    /// After a `Fatal` of another instance; the FMU was not called.
    Unusable(PathBuf),
    /// After an `Error` of this function; the FMU was not called.
    AfterError(&'static str),
    /// A slice of the wrong length; the FMU was not called.
    Length { call: &'static str, expected: usize, found: usize },
    /// A value of a size that none can have.
    TooLarge { call: &'static str, size: usize },
}

pub(super) type Outcome = Result<(), Fault>;
