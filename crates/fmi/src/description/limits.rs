//! Limits on the memory for reading a model description, and the memory used so far.

use super::model::QuirkKind;
use super::quirks::Quirks;
use crate::archive::MODEL_DESCRIPTION;
use crate::cancel_request::CancelRequest;
use crate::error::{EntryProblem, FmiError, Result};
use serde::{Deserialize, Serialize};
use std::cell::{Cell, RefCell};

/// Limits on a model description. The defaults exceed the needs of real models. They stop small files that
/// would exhaust the memory.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DescriptionLimits {
    /// Maximum size of `modelDescription.xml` in bytes (default 64 MiB, a description of 200 000 variables).
    /// Reading it requires at most eight times as much memory.
    pub bytes: u64,
    /// Maximum number of elements of all array variables together, of continuous states, and of event
    /// indicators (default 2 million). The limit applies to the declared sizes and to the sizes after
    /// structural parameters are set.
    pub elements: usize,
}

impl Default for DescriptionLimits {
    fn default() -> Self {
        Self { bytes: 64 << 20, elements: 2_000_000 }
    }
}

/// Memory for reading, in bytes per byte of the maximum document size.
const MEMORY_PER_BYTE: u64 = 8;
/// Part of `MEMORY_PER_BYTE` reserved for temporary data, such as attributes and growing lists.
const TRANSIENT_PER_BYTE: u64 = 2;

/// State of reading one document: remaining memory, cancellation flag and deviations from the standard.
#[derive(Debug)]
pub(super) struct Reading {
    pub(super) limits: DescriptionLimits,
    pub(super) cancel: CancelRequest,
    pub(super) quirks: RefCell<Quirks>,
    left: Cell<u64>,
    is_exceeded: Cell<bool>,
}

impl Reading {
    pub(super) fn new(limits: &DescriptionLimits, cancel: &CancelRequest) -> Self {
        let left = limits.bytes.saturating_mul(MEMORY_PER_BYTE - TRANSIENT_PER_BYTE);
        Self {
            limits: limits.clone(),
            cancel: cancel.clone(),
            quirks: RefCell::default(),
            left: left.into(),
            is_exceeded: false.into(),
        }
    }

    /// Records a deviation from the standard.
    pub(super) fn quirk(&self, kind: QuirkKind, line: u32, message: impl FnOnce() -> String) {
        self.quirks.borrow_mut().add(kind, line, message);
    }

    /// Reserves memory. Returns false if the remaining memory is insufficient.
    pub(super) fn take(&self, bytes: usize) -> bool {
        match self.left.get().checked_sub(bytes as u64) {
            Some(left) => self.left.set(left),
            None => self.is_exceeded.set(true),
        }
        !self.is_exceeded.get()
    }

    /// Reserves memory for a stored string, including the overhead of the allocator.
    pub(super) fn take_text(&self, text: &str) -> bool {
        self.take((text.len() + 8).next_multiple_of(16).max(32))
    }

    /// Appends to a list that grows by a quarter at a time, and reserves the memory.
    pub(super) fn push<T>(&self, list: &mut Vec<T>, item: T) {
        if list.len() == list.capacity() {
            let more = (list.len() / 4).max(4);
            if !self.take(more * size_of::<T>()) {
                return;
            }
            list.reserve_exact(more);
        }
        list.push(item);
    }

    /// Returns an error if the memory limit is exceeded or reading is cancelled.
    pub(super) fn check(&self, line: u32) -> Result<()> {
        self.cancel.check()?;
        let refusal = |message| FmiError::Description { file: MODEL_DESCRIPTION, line, message };
        self.complaint().map_or(Ok(()), |complaint| Err(refusal(complaint)))
    }

    /// Returns a message if the memory limit is exceeded.
    pub(super) fn complaint(&self) -> Option<String> {
        let Self { limits: DescriptionLimits { bytes, .. }, .. } = self;
        self.is_exceeded.get().then(|| {
            format!(
                "reading the file requires more than {} bytes of memory, {MEMORY_PER_BYTE} times the limit \
                 of {bytes} bytes for the file; increase the limit with max_description_bytes \
                 (DescriptionLimits::bytes)",
                bytes.saturating_mul(MEMORY_PER_BYTE)
            )
        })
    }
}

impl Default for Reading {
    fn default() -> Self {
        Self::new(&DescriptionLimits::default(), &CancelRequest::default())
    }
}

/// Returns an error for a file that exceeds the size limit.
pub(super) fn check_size(bytes: &[u8], file: &'static str, limits: &DescriptionLimits) -> Result<()> {
    if bytes.len() as u64 <= limits.bytes { Ok(()) } else { Err(too_large(file, limits.bytes)) }
}

/// Returns the error for a file that exceeds this limit.
fn too_large(file: &'static str, limit: u64) -> FmiError {
    let message = format!(
        "the file has more bytes than the limit of {limit}; increase the limit with max_description_bytes \
         (DescriptionLimits::bytes)"
    );
    FmiError::Description { file, line: 1, message }
}

/// Adds the name of the limit to the error for a file that is too large.
pub(super) fn name_limit(error: FmiError) -> FmiError {
    match error {
        FmiError::BadEntry { problem: EntryProblem::TooLarge { limit, .. }, .. } => {
            too_large(MODEL_DESCRIPTION, limit)
        }
        error => error,
    }
}
