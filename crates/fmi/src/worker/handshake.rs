//! Messages and environment variables that a process and its worker agree on.

use super::limits::WorkerLimits;
use super::surroundings::Surroundings;
use crate::error::FmiError;
use crate::sys::Page;
use log::LevelFilter;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::PathBuf;

/// Version that must be identical in both processes.
pub(super) const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "/4");

/// Environment variable that requests a process to serve; the value is the version.
pub(super) const WORKER_VARIABLE: &str = "FMUFIT_WORKER";

/// Environment variable with the maximum log level.
pub(super) const LEVEL: &str = "FMUFIT_WORKER_LOG";

/// True if this process was started to serve.
pub fn is_worker_start() -> bool {
    std::env::var_os(WORKER_VARIABLE).is_some()
}

/// Order to start a worker.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Start {
    pub(super) limits: WorkerLimits,
    pub(super) level: LevelFilter,
    /// True if the worker [prepares](super::Service::prepare) before it reports that it is ready.
    pub(super) is_prepared: bool,
    pub(super) surroundings: Surroundings,
    /// Functions that are not called because they have ended a worker (see
    /// [`WorkerEnd::call_at_end_of_run`](crate::error::WorkerEnd::call_at_end_of_run)).
    pub(super) avoided_calls: Vec<String>,
    /// Number from 0, different for all workers of this program that run at the same time.
    pub(super) place: u32,
}

/// A worker as seen by its own process, before any foreign code runs in it.
#[derive(Debug)]
pub(super) struct Assigned<Channel> {
    pub(super) start: Start,
    pub(super) channel: Channel,
    /// Memory shared with the caller, in which this process records its calls.
    pub(super) page: &'static Page,
    /// Folder that belongs to this worker.
    pub(super) folder: PathBuf,
    /// True if this process already has the problem loaded for all workers.
    pub(super) has_loaded: bool,
}

/// First message of a worker, before any foreign code runs in it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Arrival {
    /// Number with which the system identifies the process.
    pub(super) id: u32,
}

/// Second message of a worker, which is then ready for its first request.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Hello {
    /// See [`Assigned`].
    pub(super) has_loaded: bool,
}

/// Returns the error for a worker that cannot be started.
pub(super) fn no_worker(error: io::Error) -> FmiError {
    FmiError::NoWorker { reason: error.to_string() }
}
