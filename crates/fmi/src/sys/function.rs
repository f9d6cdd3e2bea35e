//! A function of a library, and what a call of it answers.

use super::shared_page;
use super::types::{Component, OK, status};
use crate::error::Status;
use std::ffi::c_int;

/// A function of a library.
#[derive(Clone, Copy)]
pub(super) struct Function<F> {
    /// The standard's.
    pub(super) name: &'static str,
    pub(super) pointer: Option<F>,
    /// By which its calls are told, see [`last_call`].
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
        // Which code it is matters where it is not this one.
        let status = if code == OK { Status::Ok } else { status(code) };
        Answer { function: self.name, status }
    }

    /// The component that an instantiating function makes, NULL without the function; and its name.
    pub(super) fn make(&self, call: impl FnOnce(&F) -> Component) -> (Component, &'static str) {
        self.note_call();
        (self.pointer.as_ref().map_or(Component::NULL, call), self.name)
    }

    /// Tells that it is called now.
    #[inline]
    pub(super) fn note_call(&self) {
        shared_page::note_call(self.number);
    }

    /// Without a function: missing, unless the version does not ask for the call.
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

    /// The answer where it is not good.
    #[inline(always)]
    pub(super) fn good(self) -> Result<(), Self> {
        if self.is_good() { Ok(()) } else { Err(self) }
    }
}

/// Calls a function of a table, if the library has it.
macro_rules! call {
    ($function:expr, $($argument:expr),* $(,)?) => {{
        let function = $function;
        match function.pointer {
            Some(pointer) => {
                function.note_call();
                // SAFETY: the caller's promises are those of `Version`.
                function.answer(unsafe { pointer($($argument),*) })
            }
            None => function.answer_without(),
        }
    }};
}
pub(super) use call;
