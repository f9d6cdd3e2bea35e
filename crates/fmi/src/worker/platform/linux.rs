//! Worker processes on Linux: forks of a template, or Windows programs under Wine.

use super::{separate, unix, wine};
use crate::error::FmiError;
use crate::sys::Page;
use crate::worker::frame::Frame;
use crate::worker::handshake::Start;
use crate::worker::launcher::Launcher;
use std::io::{self, PipeWriter, Read, Write};
use std::sync::Arc;
use std::time::Duration;

pub(in crate::worker) use unix::{Channel, HAS_WORKERS, await_order, limit_self, wait_until_closed};

/// Starts workers with one program.
#[derive(Debug)]
pub(in crate::worker) enum Starter {
    Native(Arc<unix::Starter>),
    Wine(Arc<separate::Starter>),
}

/// Handle of a worker process.
#[derive(Debug)]
pub(in crate::worker) enum ProcessHandle {
    Native(unix::ProcessHandle),
    Wine(separate::ProcessHandle),
}

/// The caller's end of a channel.
#[derive(Debug)]
pub(in crate::worker) enum Connection {
    Native(Channel),
    Wine(wine::Connection),
}

/// Calls a function of the value in either variant.
macro_rules! either {
    ($value:expr, $inner:ident => $call:expr) => {
        match $value {
            Self::Native($inner) => $call,
            Self::Wine($inner) => $call,
        }
    };
}

impl Starter {
    pub(in crate::worker) fn start(launcher: &Launcher) -> Result<Self, FmiError> {
        Ok(match launcher.wine {
            Some(_) => Self::Wine(Arc::new(separate::Starter::start(launcher)?)),
            None => Self::Native(Arc::new(unix::Starter::start(launcher)?)),
        })
    }

    pub(in crate::worker) fn load(&self, load: &Frame) -> io::Result<()> {
        either!(self, starter => starter.load(load))
    }

    pub(in crate::worker) fn is_broken(&self) -> bool {
        either!(self, starter => starter.is_broken())
    }

    pub(in crate::worker) fn start_worker(
        &self,
        start: &Start,
        printed: PipeWriter,
    ) -> Result<(ProcessHandle, Connection, Page), FmiError> {
        Ok(match self {
            Self::Native(starter) => {
                let (handle, channel, page) = starter.start_worker(start, printed)?;
                (ProcessHandle::Native(handle), Connection::Native(channel), page)
            }
            Self::Wine(starter) => {
                let (handle, connection, page) = starter.start_worker(start, printed)?;
                (ProcessHandle::Wine(handle), Connection::Wine(connection), page)
            }
        })
    }

    pub(in crate::worker) fn end(&self) {
        either!(self, starter => starter.end());
    }
}

impl ProcessHandle {
    pub(in crate::worker) fn arrived(&mut self, id: u32) -> bool {
        either!(self, handle => handle.arrived(id))
    }

    pub(in crate::worker) fn has_ended_within(&self, longest: Duration) -> bool {
        either!(self, handle => handle.has_ended_within(longest))
    }

    pub(in crate::worker) fn memory(&self) -> Option<u64> {
        either!(self, handle => handle.memory())
    }

    pub(in crate::worker) fn kill(&self) -> Option<String> {
        either!(self, handle => handle.kill())
    }

    pub(in crate::worker) fn unknown_end(&self) -> String {
        either!(self, handle => handle.unknown_end())
    }

    pub(in crate::worker) fn not_started(&self, error: &str) -> FmiError {
        either!(self, handle => handle.not_started(error))
    }
}

impl Connection {
    pub(in crate::worker) fn set_read_timeout(&self, longest: Option<Duration>) -> io::Result<()> {
        either!(self, connection => connection.set_read_timeout(longest))
    }

    pub(in crate::worker) fn set_write_timeout(&self, longest: Option<Duration>) -> io::Result<()> {
        either!(self, connection => connection.set_write_timeout(longest))
    }
}

impl Read for Connection {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        either!(self, connection => (&mut &*connection).read(to))
    }
}

impl Write for &Connection {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        match self {
            Connection::Native(channel) => (&mut &*channel).write(from),
            Connection::Wine(connection) => (&mut &*connection).write(from),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worker::handshake::Arrival;
    use crate::worker::limits::WorkerLimits;
    use crate::worker::load::Load;
    use crate::worker::surroundings::Surroundings;
    use crate::worker::worker_process::{Places, Process};
    use base::RunContext;
    use std::io::BufReader;
    use std::os::unix::net::UnixStream;

    #[test]
    fn worker_must_be_child_of_template() {
        let template = Arc::new(Starter::start(&Launcher::of("/bin/cat")).unwrap());
        let place = Places::default().take();
        let start = Start {
            limits: WorkerLimits::default(),
            level: log::max_level(),
            is_prepared: false,
            surroundings: Surroundings::present(),
            avoided_calls: Vec::new(),
            place: place.number,
        };
        let load = Load::new(|| Ok(Frame::default()));
        let mut process = Process::begin(&template, load.id, start, place).unwrap();
        let context = RunContext::new();
        for id in [u32::MAX, 0, i32::MIN.cast_unsigned(), 1, std::process::id()] {
            let (socket, theirs) = UnixStream::pair().unwrap();
            process.channel = BufReader::new(Connection::Native(socket));
            Frame::of(&Arrival { id }).unwrap().write(0, &mut &theirs, &mut Vec::new()).unwrap();
            let error = process.arrive(&context, Duration::from_secs(10)).unwrap_err().to_string();
            assert!(error.contains("its process is not a child of that program"), "{id}: {error}");
            let ProcessHandle::Native(handle) = &process.handle else { unreachable!() };
            assert_eq!(handle.pid, None, "{id}");
        }
        template.end();
    }
}
