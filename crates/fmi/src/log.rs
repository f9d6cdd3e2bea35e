//! The log of an instance: a bounded store of its last lines, with a rate limit.

use crate::error::{LogLine, Status};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicI32, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Lines kept per instance.
pub(crate) const LINES: usize = 32;

/// Number of lines that an instance may log at once. The rate limit counts calls of the FMU, not time, so
/// that repeated runs keep identical lines.
const BURST: i32 = 64;
/// Number of additional lines for every time point, completed step and event iteration.
const PER_POINT: i32 = 4;
/// Number of errors that an instance may log after it has used up its lines. Further lines are counted, but
/// neither expanded nor kept.
const ERRORS_BEYOND: i32 = 64;

/// Filter for the log lines of an FMU. Lines that are not kept are not expanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LogFilter {
    /// All lines.
    #[default]
    All,
    /// Lines whose status is not ok.
    Warnings,
    /// Lines whose status is error, fatal or unknown.
    Errors,
    /// No lines.
    Nothing,
}

impl LogFilter {
    fn lets_pass(self, status: Status) -> bool {
        match self {
            LogFilter::All => true,
            LogFilter::Warnings => !matches!(status, Status::Ok | Status::Pending),
            LogFilter::Errors => is_error(status),
            LogFilter::Nothing => false,
        }
    }
}

fn is_error(status: Status) -> bool {
    matches!(status, Status::Error | Status::Fatal | Status::Unknown(_))
}

/// The last lines that an instance logged, and the number of dropped earlier lines.
#[derive(Debug)]
pub(crate) struct Lines {
    pub(crate) kept: VecDeque<LogLine>,
    /// Categories of the lines with status ok that are kept; empty for all categories.
    pub(crate) categories: Vec<String>,
    dropped: u64,
}

impl Lines {
    /// Adds a line. If the store is full, the new line reuses the buffers of the oldest one.
    pub(crate) fn push(&mut self, status: Status, category: &[u8], text: &[u8]) {
        let is_requested = |requested: &String| requested.as_bytes() == category;
        if status == Status::Ok && !self.categories.is_empty() && !self.categories.iter().any(is_requested) {
            return;
        }
        let mut line = if self.kept.len() >= LINES {
            self.dropped += 1;
            self.kept.pop_front()
        } else {
            None
        }
        .unwrap_or_else(|| LogLine { status, category: String::new(), text: String::new() });
        line.status = status;
        copy_lossy(category, &mut line.category);
        copy_lossy(text.trim_ascii_end(), &mut line.text);
        self.kept.push_back(line);
    }
}

/// Copies text. Replaces invalid UTF-8 and control characters that could affect a terminal.
fn copy_lossy(bytes: &[u8], target: &mut String) {
    target.clear();
    for chunk in bytes.utf8_chunks() {
        for c in chunk.valid().chars() {
            target.push(if c.is_control() && c != '\n' && c != '\t' {
                char::REPLACEMENT_CHARACTER
            } else {
                c
            });
        }
        if !chunk.invalid().is_empty() {
            target.push(char::REPLACEMENT_CHARACTER);
        }
    }
}

/// The log of one instance. The mutex is needed because FMUs may log from their own threads.
#[derive(Debug)]
pub(crate) struct Log {
    lines: Mutex<Lines>,
    /// A [`LogFilter`], stored as its number.
    pub(crate) filter: AtomicU8,
    /// Number of lines that may still be logged; if negative, only errors may be logged.
    credit: AtomicI32,
    /// Number of lines beyond the rate limit.
    pub(crate) refused: AtomicU64,
}

impl Log {
    pub(crate) fn new(filter: LogFilter) -> Self {
        Self {
            lines: Mutex::new(Lines {
                kept: VecDeque::with_capacity(LINES),
                categories: Vec::new(),
                dropped: 0,
            }),
            filter: AtomicU8::new(filter as u8),
            credit: AtomicI32::new(BURST),
            refused: AtomicU64::new(0),
        }
    }

    /// Adds credit for a new time point, a step or an event.
    #[inline]
    pub(crate) fn go_on(&self) {
        let credit = self.credit.load(Ordering::Relaxed);
        if credit < BURST {
            self.credit.store((credit + PER_POINT).min(BURST), Ordering::Relaxed);
        }
    }

    /// True if a line should be expanded and kept.
    pub(crate) fn admits(&self, status: Status) -> bool {
        const FILTERS: [LogFilter; 4] =
            [LogFilter::All, LogFilter::Warnings, LogFilter::Errors, LogFilter::Nothing];
        let filter = FILTERS[usize::from(self.filter.load(Ordering::Relaxed)) % FILTERS.len()];
        if !filter.lets_pass(status) {
            return false;
        }
        let least = if is_error(status) { -ERRORS_BEYOND } else { 0 };
        let take = |credit: i32| (credit > least).then_some(credit - 1);
        let admitted = self.credit.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take).is_ok();
        if !admitted {
            self.refused.fetch_add(1, Ordering::Relaxed);
        }
        admitted
    }

    pub(crate) fn lines(&self) -> MutexGuard<'_, Lines> {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the last `n` kept lines, oldest first, and the number of other lines.
    pub(crate) fn last(&self, n: usize) -> (Vec<LogLine>, u64) {
        let lines = self.lines();
        let skip = lines.kept.len().saturating_sub(n);
        let others = lines.dropped + skip as u64 + self.refused.load(Ordering::Relaxed);
        (lines.kept.iter().skip(skip).cloned().collect(), others)
    }

    /// Clears the log.
    pub(crate) fn clear(&self) {
        let mut lines = self.lines();
        lines.kept.clear();
        lines.dropped = 0;
        self.credit.store(BURST, Ordering::Relaxed);
        self.refused.store(0, Ordering::Relaxed);
    }
}
