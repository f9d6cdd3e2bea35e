//! Replacement of worker processes on systems that do not support them: none can be started.

use crate::error::FmiError;
use crate::sys::Page;
use crate::worker::frame::Frame;
use crate::worker::handshake::{Assigned, Start};
use crate::worker::launcher::Launcher;
use crate::worker::limits::WorkerLimits;
use std::convert::Infallible;
use std::io::{self, PipeWriter};
use std::time::Duration;

pub(in crate::worker) const HAS_WORKERS: bool = false;

/// Has the required functions. No value is created.
pub(in crate::worker) type Channel = std::net::TcpStream;
pub(in crate::worker) type Connection = Channel;

const REASON: &str = "worker processes are not supported on this system";

#[derive(Debug)]
pub(in crate::worker) struct Absent(Infallible);

pub(in crate::worker) use Absent as Starter;
pub(in crate::worker) use Absent as ProcessHandle;

impl Absent {
    pub(in crate::worker) fn start(_: &Launcher) -> Result<Self, FmiError> {
        Err(FmiError::NoWorker { reason: REASON.to_owned() })
    }

    pub(in crate::worker) fn load(&self, _: &Frame) -> io::Result<()> {
        match self.0 {}
    }

    pub(in crate::worker) fn is_broken(&self) -> bool {
        match self.0 {}
    }

    pub(in crate::worker) fn end(&self) {
        match self.0 {}
    }

    pub(in crate::worker) fn start_worker(
        &self,
        _: &Start,
        _: PipeWriter,
    ) -> Result<(Self, Channel, Page), FmiError> {
        match self.0 {}
    }

    pub(in crate::worker) fn arrived(&mut self, _: u32) -> bool {
        match self.0 {}
    }

    pub(in crate::worker) fn has_ended_within(&self, _: Duration) -> bool {
        match self.0 {}
    }

    pub(in crate::worker) fn memory(&self) -> Option<u64> {
        match self.0 {}
    }

    pub(in crate::worker) fn kill(&self) -> Option<String> {
        match self.0 {}
    }

    pub(in crate::worker) fn unknown_end(&self) -> String {
        match self.0 {}
    }

    pub(in crate::worker) fn not_started(&self, _: &str) -> FmiError {
        match self.0 {}
    }
}

pub(in crate::worker) fn await_order(
    _: &mut dyn FnMut(&Frame) -> io::Result<bool>,
) -> io::Result<Option<Assigned<Channel>>> {
    Err(io::Error::other(REASON))
}

pub(in crate::worker) fn limit_self(_: &WorkerLimits) -> io::Result<()> {
    Err(io::Error::other(REASON))
}

pub(in crate::worker) fn wait_until_closed(_: &Channel) {}
