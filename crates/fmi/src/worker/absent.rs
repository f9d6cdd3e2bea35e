//! Where processes cannot be started as workers: there are none.

use super::frame::Frame;
use super::isolation::{AskedProcess, Question};
use super::limits::WorkerLimits;
use super::load::Load;
use super::service::Service;
use crate::description::Quirk;
use crate::error::FmiError;
use base::RunContext;
use std::io;
use std::sync::Arc;

/// No worker processes.
#[derive(Debug)]
pub enum Workers {}

impl Workers {
    /// `None`.
    pub fn new(_: WorkerLimits) -> Option<Arc<Self>> {
        None
    }

    /// The limits.
    pub fn limits(&self) -> &WorkerLimits {
        match *self {}
    }

    /// Not reached.
    pub fn prepare(&self, _: &Load) {
        match *self {}
    }

    /// Not reached.
    pub fn prepare_second(&self, _: &Load) {
        match *self {}
    }

    /// Not reached.
    pub fn hold(self: &Arc<Self>) -> Held {
        match **self {}
    }

    /// Not reached.
    pub fn n_changes(&self) -> u64 {
        match *self {}
    }
    /// Not reached.
    pub fn n_idle(&self, _: &Load) -> usize {
        match *self {}
    }

    /// Not reached.
    pub fn forget(&self, _: &Load) {
        match *self {}
    }

    /// Not reached.
    ///
    /// # Errors
    /// None.
    pub fn pinned(self: &Arc<Self>, _: &Load, _: &RunContext<'_>) -> Result<PinnedProcess, FmiError> {
        match **self {}
    }

    /// Not reached.
    ///
    /// # Errors
    /// None.
    pub fn call<T>(
        self: &Arc<Self>,
        _: &Load,
        _: &Question<'_>,
        _: &mut Frame,
        _: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
        _: AskedProcess,
    ) -> Result<(T, Vec<Quirk>), FmiError> {
        match **self {}
    }
}

/// No worker process.
#[derive(Debug)]
pub enum PinnedProcess {}

impl PinnedProcess {
    /// Not reached.
    ///
    /// # Errors
    /// None.
    pub fn call<T>(
        &mut self,
        _: &Question<'_>,
        _: &mut Frame,
        _: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
    ) -> Result<(T, Vec<Quirk>), FmiError> {
        match *self {}
    }

    /// Not reached.
    pub fn limits(&self) -> &WorkerLimits {
        match *self {}
    }

    /// Not reached.
    pub fn is_own(&self) -> bool {
        match *self {}
    }

    /// Not reached.
    pub fn has_ended(&self) -> bool {
        match *self {}
    }
}

/// Not made.
#[derive(Debug)]
pub enum Held {}

/// Returns at once.
pub fn serve_if_worker(_: impl FnOnce() -> Box<dyn Service + Send>) {}

/// Nothing can be started.
#[derive(Debug)]
pub enum ForkServer {}

/// `None`: nothing can be started.
pub fn start_fork_server() -> Option<Arc<ForkServer>> {
    None
}
