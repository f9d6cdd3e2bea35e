//! Messages on the standard error stream: those of this program, and those that the library logs. They stand
//! above the live line.

use calibration::{SETUP_LOG_TARGET, visible, visible_line};
use indicatif::ProgressBar;
use log::{Level, LevelFilter, Log, Metadata, Record};
use std::io::{self, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};

struct Messages;

/// The live line that is shown.
static LIVE: Mutex<Option<ProgressBar>> = Mutex::new(None);

fn live() -> MutexGuard<'static, Option<ProgressBar>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Says which live line messages are to stand above.
pub(super) fn stand_above(bar: Option<ProgressBar>) {
    *live() = bar;
}

/// Has warnings of the library printed, unless nothing is to be said. A program that has a logger keeps it.
pub(super) fn pass_on(is_quiet: bool) {
    if log::set_logger(&Messages).is_ok() {
        log::set_max_level(if is_quiet { LevelFilter::Off } else { LevelFilter::Warn });
    }
}

/// Prints a message.
pub(super) fn print(text: &str) {
    let bar = live().clone();
    // Nobody may be there to read it any more.
    let write = || _ = writeln!(io::stderr(), "{}", visible(text));
    match bar {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

impl Log for Messages {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.level() <= log::max_level()
    }

    fn log(&self, record: &Record<'_>) {
        if self.enabled(record.metadata()) {
            let level = if record.level() == Level::Error { "error" } else { "warning" };
            let text = record.args().to_string();
            // A warning about a setup holds names; a model may log several lines.
            let text = if record.target() == SETUP_LOG_TARGET { visible_line(&text) } else { text.into() };
            print(&format!("{level}: {text}"));
        }
    }

    fn flush(&self) {}
}
