//! Log lines of the libraries (mostly warnings about models) for Python's `logging`, logger "pydfo".
//!
//! Lines are stored until the calling thread next checks for signals or returns, because simulating threads
//! must not wait for the interpreter lock.

use crate::interrupt::lock::lock;
use calibration::SETUP_LOG_TARGET;
use log::{Level, LevelFilter, Log, Metadata, Record};
use pyo3::prelude::*;
use std::sync::Mutex;

/// Maximum number of stored lines; further lines are dropped.
const MOST_LINES: usize = 1000;

struct Keeper {
    lines: Mutex<Vec<(Level, String)>>,
}

static KEEPER: Keeper = Keeper { lines: Mutex::new(Vec::new()) };

impl Log for Keeper {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        // Doubts about a setup are shown as Python warnings.
        metadata.level() <= Level::Info && metadata.target() != SETUP_LOG_TARGET
    }

    fn log(&self, record: &Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let line = calibration::visible(&record.args().to_string()).into_owned();
        let mut lines = lock(&self.lines);
        if lines.len() < MOST_LINES {
            lines.push((record.level(), line));
        }
    }

    fn flush(&self) {}
}

/// Installs the logger for the libraries.
pub(crate) fn install() {
    if fmi::worker::is_worker_start() {
        // A worker process has a separate logger.
        return;
    }
    // Fails if a logger is already set. In this extension module, it can only be this one.
    if log::set_logger(&KEEPER).is_ok() {
        log::set_max_level(LevelFilter::Info);
    }
}

/// Passes the lines since the last call to Python.
pub(crate) fn pass_on(py: Python<'_>) -> PyResult<()> {
    let lines = std::mem::take(&mut *lock(&KEEPER.lines));
    if lines.is_empty() {
        return Ok(());
    }
    let logger = py.import("logging")?.call_method1("getLogger", ("pydfo",))?;
    for (level, line) in lines {
        let method = match level {
            Level::Error => "error",
            Level::Warn => "warning",
            _ => "info",
        };
        logger.call_method1(method, ("%s", line))?;
    }
    Ok(())
}
