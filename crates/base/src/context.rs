//! Context of a long operation: cancellation and time limit.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Conditions under which an operation may continue: it has not been cancelled, and its time limit has not
/// expired. The context is passed by reference to every long operation, which checks
/// [`is_over`](Self::is_over) between its steps.
///
/// ```
/// use base::RunContext;
/// use std::time::Duration;
///
/// let context = RunContext::new();
/// assert!(!context.is_over() && context.left().is_none());
/// let short = context.within(Some(Duration::ZERO));
/// assert!(short.is_over() && !short.is_cancelled());
/// ```
#[derive(Clone, Copy)]
pub struct RunContext<'a> {
    ask: Option<&'a dyn Fn() -> bool>,
    flag: Option<&'a AtomicBool>,
    began: Instant,
    end: Option<Instant>,
}

impl<'a> RunContext<'a> {
    /// Creates a context without cancellation and without a time limit.
    pub fn new() -> Self {
        Self { ask: None, flag: None, began: Instant::now(), end: None }
    }

    /// Adds a function that cancels the operation when it returns true. It is called on the working thread.
    #[must_use]
    pub fn polling(self, ask: &'a dyn Fn() -> bool) -> Self {
        Self { ask: Some(ask), ..self }
    }

    /// Adds a flag with which another thread cancels the operation.
    #[must_use]
    pub fn flagged(self, flag: &'a AtomicBool) -> Self {
        Self { flag: Some(flag), ..self }
    }

    /// Limits the remaining time, unless an earlier deadline is already set. A limit beyond the range of the
    /// clock means no limit. Also restarts [`elapsed`](Self::elapsed).
    #[must_use]
    pub fn within(self, limit: Option<Duration>) -> Self {
        let began = Instant::now();
        Self { began, ..self }.until(limit.and_then(|limit| began.checked_add(limit)))
    }

    /// Sets the deadline, unless an earlier one is already set.
    #[must_use]
    pub fn until(self, end: Option<Instant>) -> Self {
        let end = match (self.end, end) {
            (Some(outer), Some(inner)) => Some(outer.min(inner)),
            (outer, inner) => outer.or(inner),
        };
        Self { end, ..self }
    }

    /// True if the flag or the function has cancelled the operation.
    pub fn is_cancelled(&self) -> bool {
        self.flag.is_some_and(|flag| flag.load(Ordering::Relaxed)) || self.function().is_some_and(|ask| ask())
    }

    /// Returns the function that can cancel the operation.
    pub fn function(&self) -> Option<&'a dyn Fn() -> bool> {
        self.ask
    }

    /// Returns the flag that can cancel the operation.
    pub fn flag(&self) -> Option<&'a AtomicBool> {
        self.flag
    }

    /// True if the time limit has expired.
    pub fn is_late(&self) -> bool {
        self.end.is_some_and(|end| Instant::now() >= end)
    }

    /// True if the operation must end because it was cancelled or its time limit has expired.
    pub fn is_over(&self) -> bool {
        self.is_late() || self.is_cancelled()
    }

    /// Returns the remaining time; `None` without a limit.
    pub fn left(&self) -> Option<Duration> {
        self.end.map(|end| end.saturating_duration_since(Instant::now()))
    }

    /// Returns the deadline; `None` without a limit.
    pub fn end(&self) -> Option<Instant> {
        self.end
    }

    /// Returns the time since the operation began.
    pub fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }
}

impl Default for RunContext<'_> {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Debug for RunContext<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RunContext")
            .field("elapsed", &self.elapsed())
            .field("left", &self.left())
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn context_ends_when_cancelled_or_late() {
        let flag = AtomicBool::new(false);
        let requested = std::cell::Cell::new(false);
        let ask = || requested.get();
        let (by_flag, by_polling) = (RunContext::new().flagged(&flag), RunContext::new().polling(&ask));
        assert!(!by_flag.is_over() && !by_polling.is_over());
        flag.store(true, Ordering::Relaxed);
        requested.set(true);
        assert!(by_flag.is_cancelled() && by_polling.is_cancelled() && !by_polling.is_late());
    }

    #[test]
    fn shorter_limit_applies_and_none_is_unlimited() {
        let none = RunContext::new().within(None);
        assert!(!none.is_late() && none.left().is_none());
        assert!(none.within(Some(Duration::MAX)).left().is_none());
        let over = none.within(Some(Duration::ZERO));
        assert!(over.is_over() && over.left() == Some(Duration::ZERO));
        assert!(over.within(Some(Duration::from_secs(3600))).is_late());
        assert!(over.within(None).is_late() && !none.within(Some(Duration::from_secs(3600))).is_late());
    }
}
