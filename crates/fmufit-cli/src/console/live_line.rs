//! A line that shows how far work is: rewritten on a terminal, printed from time to time elsewhere.

use super::messages;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::cell::{Cell, RefCell};
use std::io;
use std::time::{Duration, Instant};
use terminal_size::terminal_size_of;

/// Least time between two lines where none is rewritten.
const PAUSE: Duration = Duration::from_secs(2);

/// Columns of a terminal that the line leaves free: the echo of Ctrl-C must not break it.
const MARGIN: usize = 6;

/// The line; it goes away when it is dropped.
pub(crate) struct LiveLine {
    bar: Option<ProgressBar>,
    /// Of lines that are printed: the heading of the last one, and when it was.
    printed: Option<(RefCell<String>, Cell<Instant>)>,
}

impl LiveLine {
    pub(super) fn new(is_shown: bool, is_rewritten: bool) -> Self {
        let mut line = Self { bar: None, printed: None };
        if is_shown && is_rewritten {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
                bar.set_style(style);
            }
            messages::stand_above(Some(bar.clone()));
            line.bar = Some(bar);
        } else if is_shown {
            line.printed = Some((RefCell::default(), Cell::new(Instant::now())));
        }
        line
    }

    /// Shows what is done, and how far it is.
    pub(crate) fn show(&self, heading: &str, state: impl Fn() -> String) {
        let text =
            |state: String| if state.is_empty() { heading.to_owned() } else { format!("{heading}: {state}") };
        if let Some(bar) = &self.bar {
            let width = terminal_size_of(io::stderr()).map_or(80, |(width, _)| usize::from(width.0));
            let text = calibration::visible(&text(state())).into_owned();
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
        if let Some(bar) = &self.bar {
            messages::stand_above(None);
            bar.finish_and_clear();
        }
    }
}
