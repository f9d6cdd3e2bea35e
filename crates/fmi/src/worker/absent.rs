//! Replacement of the worker processes on systems that do not support them.

use super::frame::Frame;
use super::isolation::{AskedProcess, Question, Repeat};
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
    /// Returns `None`.
    pub fn new(_: WorkerLimits) -> Option<Arc<Self>> {
        None
    }

    /// Returns the limits.
    pub fn limits(&self) -> &WorkerLimits {
        match *self {}
    }

    /// Unreachable.
    pub fn prepare(&self, _: &Load) {
        match *self {}
    }

    /// Unreachable.
    pub fn prepare_second(&self, _: &Load) {
        match *self {}
    }

    /// Unreachable.
    pub fn hold(self: &Arc<Self>) -> Held {
        match **self {}
    }

    /// Unreachable.
    pub fn n_changes(&self) -> u64 {
        match *self {}
    }
    /// Unreachable.
    pub fn n_idle(&self, _: &Load) -> usize {
        match *self {}
    }

    /// Unreachable.
    pub fn forget(&self, _: &Load) {
        match *self {}
    }

    /// Unreachable.
    ///
    /// # Errors
    /// None.
    pub fn pinned(self: &Arc<Self>, _: &Load, _: &RunContext<'_>) -> Result<PinnedProcess, FmiError> {
        match **self {}
    }

    /// Unreachable.
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
        _: Option<&mut Repeat<'_>>,
    ) -> Result<(T, Vec<Quirk>), FmiError> {
        match **self {}
    }
}

/// No worker process.
#[derive(Debug)]
pub enum PinnedProcess {}

impl PinnedProcess {
    /// Unreachable.
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

    /// Unreachable.
    pub fn limits(&self) -> &WorkerLimits {
        match *self {}
    }

    /// Unreachable.
    pub fn is_own(&self) -> bool {
        match *self {}
    }

    /// Unreachable.
    pub fn has_ended(&self) -> bool {
        match *self {}
    }
}

/// Never constructed.
#[derive(Debug)]
pub enum Held {}

/// Returns immediately.
pub fn serve_if_worker(_: impl FnOnce() -> Box<dyn Service + Send>) {}

/// Never constructed, because no process can be started.
#[derive(Debug)]
pub enum ForkServer {}

/// Returns `None`, because no process can be started.
pub fn start_fork_server() -> Option<Arc<ForkServer>> {
    None
}
