//! A function of a library, and the answer of a call.

use super::shared_page;
use super::types::{Component, OK, status};
use crate::error::Status;
use std::ffi::c_int;

/// A function of a library.
#[derive(Clone, Copy)]
pub(super) struct Function<F> {
    /// Name in the standard.
    pub(super) name: &'static str,
    pub(super) pointer: Option<F>,
    /// Number with which calls of the function are recorded, see `Page::last_call`.
    pub(super) number: u32,
}

/// Status returned by a call, with the name of the function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[must_use]
pub(super) struct Answer {
    pub(super) function: &'static str,
    pub(super) status: Status,
}

impl<F> Function<F> {
    #[inline(always)]
    pub(super) fn answer(&self, code: c_int) -> Answer {
        // The conversion of other codes is needed only after a failure.
        let status = if code == OK { Status::Ok } else { status(code) };
        Answer { function: self.name, status }
    }

    /// Calls a function that creates a component. Returns the component (NULL if the function is missing) and
    /// the name of the function.
    pub(super) fn make(&self, call: impl FnOnce(&F) -> Component) -> (Component, &'static str) {
        self.note_call();
        (self.pointer.as_ref().map_or(Component::NULL, call), self.name)
    }

    /// Records that the function is being called.
    #[inline]
    pub(super) fn note_call(&self) {
        shared_page::note_call(self.number);
    }

    /// Returns the answer for a function that the library lacks: `Ok` if the version does not need the call,
    /// otherwise `Missing`.
    #[cold]
    pub(super) fn answer_without(&self) -> Answer {
        let status = if self.name.is_empty() { Status::Ok } else { Status::Missing };
        Answer { function: self.name, status }
    }
}

impl Answer {
    #[inline(always)]
    pub(super) fn is_good(&self) -> bool {
        matches!(self.status, Status::Ok | Status::Warning)
    }

    /// Returns the answer as an error if it is neither ok nor a warning.
    #[inline(always)]
    pub(super) fn good(self) -> Result<(), Self> {
        if self.is_good() { Ok(()) } else { Err(self) }
    }
}

/// Calls a function of a table if the library has it.
macro_rules! call {
    ($function:expr, $($argument:expr),* $(,)?) => {{
        let function = $function;
        match function.pointer {
            Some(pointer) => {
                function.note_call();
                // SAFETY: the caller upholds the requirements of `Version`.
                function.answer(unsafe { pointer($($argument),*) })
            }
            None => function.answer_without(),
        }
    }};
}
pub(super) use call;
