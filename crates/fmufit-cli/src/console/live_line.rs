//! Progress line: rewritten on a terminal, printed from time to time otherwise.

use super::messages;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::cell::{Cell, RefCell};
use std::io;
use std::time::{Duration, Instant};
use terminal_size::terminal_size_of;

/// Minimum time between two printed lines.
const PAUSE: Duration = Duration::from_secs(2);

/// Number of free columns at the end of the line, so that the echo of Ctrl-C does not break it.
const MARGIN: usize = 6;

/// The progress line, which disappears when it is dropped.
pub(crate) struct LiveLine {
    bar: Option<ProgressBar>,
    /// Heading and time of the last printed line, if lines are printed.
    printed: Option<(RefCell<String>, Cell<Instant>)>,
    /// True after a request to end the work. The line is then cleared, because a second Ctrl-C would leave it
    /// on the screen.
    is_ending: Cell<bool>,
}

impl LiveLine {
    pub(super) fn new(is_shown: bool, is_rewritten: bool) -> Self {
        let mut line = Self { bar: None, printed: None, is_ending: Cell::new(false) };
        if is_shown && is_rewritten {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
                bar.set_style(style);
            }
            messages::print_above(Some(bar.clone()));
            line.bar = Some(bar);
        } else if is_shown {
            line.printed = Some((RefCell::default(), Cell::new(Instant::now())));
        }
        line
    }

    /// Shows the current work, unless its end was requested. Returns true if it was requested.
    pub(crate) fn show_until(&self, is_requested: bool, heading: &str) -> bool {
        match is_requested {
            true => self.end(),
            false => self.show(heading, String::new),
        }
        is_requested
    }

    /// Announces that the work is about to end, and removes the line.
    pub(crate) fn end(&self) {
        if self.is_ending.replace(true) {
            return;
        }
        if let Some(bar) = &self.bar {
            messages::print_above(None);
            bar.finish_and_clear();
        }
        if self.bar.is_some() || self.printed.is_some() {
            messages::print("ending; press Ctrl-C again to end at once without a result");
        }
    }

    /// Shows the current work and its progress.
    pub(crate) fn show(&self, heading: &str, state: impl Fn() -> String) {
        if self.is_ending.get() {
            return;
        }
        let text =
            |state: String| if state.is_empty() { heading.to_owned() } else { format!("{heading}: {state}") };
        if let Some(bar) = &self.bar {
            let width = terminal_size_of(io::stderr()).map_or(80, |(width, _)| usize::from(width.0));
            let text = calibration::visible_line(&text(state())).into_owned();
            bar.set_message(text.chars().take(width.saturating_sub(MARGIN)).collect::<String>());
            bar.tick();
        }
        if let Some((last, at)) = &self.printed
            && (*last.borrow() != heading || at.get().elapsed() >= PAUSE)
        {
            messages::print(&text(state()));
            heading.clone_into(&mut last.borrow_mut());
            at.set(Instant::now());
        }
    }
}

impl Drop for LiveLine {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.as_ref().filter(|_| !self.is_ending.get()) {
            messages::print_above(None);
            bar.finish_and_clear();
        }
    }
}
