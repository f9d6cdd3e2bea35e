//! Faults of a call: the reasons why it returned no result.

use crate::error::CallFailure;
use std::path::PathBuf;

/// Sizes of the model's vectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sizes {
    pub(crate) states: usize,
    pub(crate) indicators: usize,
}

/// Reason why a call returned no result. Creating a `Discard` allocates nothing.
#[derive(Debug)]
pub(crate) enum Fault {
    /// The call is not possible at this point.
    Discard(&'static str),
    /// The call failed with a more severe status.
    Failed(Box<CallFailure>),
    /// The library has no such function.
    Missing(&'static str),
    /// Another instance returned `Fatal` earlier; the FMU was not called.
    Unusable(PathBuf),
    /// This function returned `Error` earlier; the FMU was not called.
    AfterError(&'static str),
    /// A slice of the wrong length; the FMU was not called.
    Length { call: &'static str, expected: usize, found: usize },
    /// The size of a value exceeds its limit or the memory.
    TooLarge { call: &'static str, size: usize },
}

pub(super) type Outcome = Result<(), Fault>;
