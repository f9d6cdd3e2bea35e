//! Connection with a worker that connects after its start.

use super::super::order::Key;
use rustix::net::sockopt::{Timeout, set_socket_timeout, socket_timeout};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::OnceLock;
use std::time::Duration;

/// Maximum time for the key, which the worker sends at once.
const KEY: Duration = Duration::from_secs(1);

/// The caller's end of a channel. Until the worker has connected, reading and writing wait for it.
#[derive(Debug)]
pub(in crate::worker) struct Connection {
    /// Its time limits are those of the channel.
    listener: TcpListener,
    key: Key,
    connected: OnceLock<TcpStream>,
}

impl Connection {
    /// Waits at a port. Returns the port and the key that the worker must send.
    pub(super) fn new() -> io::Result<(Self, u16, Key)> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let port = listener.local_addr()?.port();
        let mut key = Key::default();
        File::open("/dev/urandom")?.read_exact(&mut key)?;
        Ok((Self { listener, key, connected: OnceLock::new() }, port, key))
    }

    pub(in crate::worker) fn set_read_timeout(&self, longest: Option<Duration>) -> io::Result<()> {
        self.set_timeout(Timeout::Recv, longest)
    }

    pub(in crate::worker) fn set_write_timeout(&self, longest: Option<Duration>) -> io::Result<()> {
        self.set_timeout(Timeout::Send, longest)
    }

    fn set_timeout(&self, timeout: Timeout, longest: Option<Duration>) -> io::Result<()> {
        set_socket_timeout(&self.listener, timeout, longest)?;
        self.connected.get().map_or(Ok(()), |stream| Ok(set_socket_timeout(stream, timeout, longest)?))
    }

    /// Returns the channel, after the worker has connected.
    fn stream(&self) -> io::Result<&TcpStream> {
        if let Some(stream) = self.connected.get() {
            return Ok(stream);
        }
        let (mut stream, _) = self.listener.accept()?;
        stream.set_read_timeout(Some(KEY))?;
        let mut key = Key::default();
        if stream.read_exact(&mut key).is_err() || key != self.key {
            // Another process has connected.
            return Err(ErrorKind::WouldBlock.into());
        }
        for timeout in [Timeout::Recv, Timeout::Send] {
            set_socket_timeout(&stream, timeout, socket_timeout(&self.listener, timeout)?)?;
        }
        stream.set_nodelay(true)?;
        Ok(self.connected.get_or_init(|| stream))
    }
}

impl Read for &Connection {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        self.stream()?.read(to)
    }
}

impl Write for &Connection {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        self.stream()?.write(from)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
