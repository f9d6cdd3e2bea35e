//! Messages of this program and log messages of the library, on the standard error stream. They appear above
//! the live line.

use calibration::{SETUP_LOG_TARGET, visible, visible_line};
use indicatif::ProgressBar;
use log::{Level, LevelFilter, Log, Metadata, Record};
use std::io::{self, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};

struct Messages;

/// The current live line.
static LIVE: Mutex<Option<ProgressBar>> = Mutex::new(None);

fn live() -> MutexGuard<'static, Option<ProgressBar>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sets the live line above which messages appear.
pub(super) fn print_above(bar: Option<ProgressBar>) {
    *live() = bar;
}

/// Prints warnings of the library, unless `is_quiet` is true. If the program already has a logger, the logger
/// is kept.
pub(super) fn pass_on(is_quiet: bool) {
    if log::set_logger(&Messages).is_ok() {
        log::set_max_level(if is_quiet { LevelFilter::Off } else { LevelFilter::Warn });
    }
}

/// Prints a message.
pub(super) fn print(text: &str) {
    let bar = live().clone();
    // The reader of the stream may have closed it.
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
            // A warning about a setup contains names and is one line. A model may log several lines.
            let text = if record.target() == SETUP_LOG_TARGET { visible_line(&text) } else { text.into() };
            print(&format!("{level}: {text}"));
        }
    }

    fn flush(&self) {}
}
