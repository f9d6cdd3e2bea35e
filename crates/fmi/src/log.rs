//! The log of an instance: a bounded store of its last lines, with a limit of their rate.

use crate::error::{LogLine, Status};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicI32, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Lines kept per instance.
pub(crate) const LINES: usize = 32;

/// The rate limit, counted in what the FMU is asked to do and not in time, so that the same run leaves the
/// same lines: an instance may log so many lines at once,
const BURST: i32 = 64;
/// so many more with every point of time, completed step and event iteration,
const PER_POINT: i32 = 4;
/// and when it has used that up, may still log so many errors. The lines beyond are counted, and neither
/// expanded nor kept.
const ERRORS_BEYOND: i32 = 64;

/// Filter for the lines of an FMU's log; lines that are not kept are not even expanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LogFilter {
    /// All.
    #[default]
    All,
    /// Lines whose status is not ok.
    Warnings,
    /// Lines whose status is error, fatal or unknown.
    Errors,
    /// None.
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

/// The last lines an instance logged, and how many earlier ones were dropped.
#[derive(Debug)]
pub(crate) struct Lines {
    pub(crate) kept: VecDeque<LogLine>,
    /// Of which lines with the status ok are kept; empty: of all.
    pub(crate) categories: Vec<String>,
    dropped: u64,
}

impl Lines {
    /// Adds a line; when full, the oldest gives its place and its buffers.
    pub(crate) fn push(&mut self, status: Status, category: &[u8], text: &[u8]) {
        let is_asked = |asked: &String| asked.as_bytes() == category;
        if status == Status::Ok && !self.categories.is_empty() && !self.categories.iter().any(is_asked) {
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

/// Copies text, replacing what is not UTF-8 and what could steer a terminal.
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

/// The log of one instance. FMUs may log from threads of their own, hence the mutex.
#[derive(Debug)]
pub(crate) struct Log {
    lines: Mutex<Lines>,
    /// A [`LogFilter`].
    pub(crate) filter: AtomicU8,
    /// Lines that may still be logged; below zero for errors only.
    credit: AtomicI32,
    /// Lines beyond the rate limit.
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

    /// Notes that the FMU is taken to another point of time, or has to do with a step or an event.
    #[inline]
    pub(crate) fn go_on(&self) {
        let credit = self.credit.load(Ordering::Relaxed);
        if credit < BURST {
            self.credit.store((credit + PER_POINT).min(BURST), Ordering::Relaxed);
        }
    }

    /// True if a line is to be expanded and kept.
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

    /// The last `n` lines that were kept, oldest first, and how many others there were.
    pub(crate) fn last(&self, n: usize) -> (Vec<LogLine>, u64) {
        let lines = self.lines();
        let skip = lines.kept.len().saturating_sub(n);
        let others = lines.dropped + skip as u64 + self.refused.load(Ordering::Relaxed);
        (lines.kept.iter().skip(skip).cloned().collect(), others)
    }

    /// Forgets the lines.
    pub(crate) fn clear(&self) {
        let mut lines = self.lines();
        lines.kept.clear();
        lines.dropped = 0;
        self.credit.store(BURST, Ordering::Relaxed);
        self.refused.store(0, Ordering::Relaxed);
    }
}
