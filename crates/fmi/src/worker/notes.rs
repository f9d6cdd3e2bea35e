//! Notes that a worker sends with its answers: lines for the program's logger, and departures from the
//! standard detected in runs.

use crate::description::Quirk;
use log::{Level, Log, Metadata, Record};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Maximum number of lines between two answers. Further lines are dropped.
const MOST_LINES: usize = 1000;

/// A line for the program's logger.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Line {
    level: Level,
    target: String,
    text: String,
}

/// Notes since the last answer.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Notes {
    pub(crate) lines: Vec<Line>,
    pub(crate) quirks: Vec<Quirk>,
}

impl Notes {
    pub(crate) fn is_empty(&self) -> bool {
        self.lines.is_empty() && self.quirks.is_empty()
    }

    /// Sends the lines to the logger of this program. Warnings that another worker has already logged
    /// (`said`) are not repeated.
    pub(crate) fn pass_on(&self, reported: &Mutex<HashSet<String>>) {
        for Line { level, target, text } in &self.lines {
            let mut reported = reported.lock().unwrap_or_else(PoisonError::into_inner);
            let is_new = *level > Level::Warn || !reported.contains(text);
            if *level <= Level::Warn && reported.len() < MOST_LINES {
                reported.insert(text.clone());
            }
            drop(reported);
            if is_new {
                log::log!(target: target, *level, "{text}");
            }
        }
    }
}

/// The logger of a worker.
struct Keeper {
    lines: Mutex<Vec<Line>>,
}

static KEEPER: Keeper = Keeper { lines: Mutex::new(Vec::new()) };

fn lines() -> MutexGuard<'static, Vec<Line>> {
    KEEPER.lines.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Log for Keeper {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &Record<'_>) {
        let (level, target) = (record.level(), record.target().to_owned());
        let mut lines = lines();
        if lines.len() < MOST_LINES {
            lines.push(Line { level, target, text: record.args().to_string() });
        }
    }

    fn flush(&self) {}
}

/// Stores log records up to this level, unless the program already has a logger.
pub(crate) fn keep_lines(level: log::LevelFilter) {
    if log::set_logger(&KEEPER).is_ok() {
        log::set_max_level(level);
    }
}

/// Returns the lines since the last call.
pub(crate) fn take_lines() -> Vec<Line> {
    std::mem::take(&mut *lines())
}
