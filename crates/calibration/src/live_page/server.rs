//! The server: a thread that listens on the loopback address, and one thread for each connection. These
//! threads never wait for the fit, and the fit never waits for them.
//!
//! Requests are parsed by httparse. Existing servers without an asynchronous runtime are tiny_http and
//! servers based on it. They limit neither the size of a header nor the time of a client.

use super::page::Page;
use super::request;
use super::response::{Response, Status};
use crate::fit::live::lock;
use std::io;
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Maximum number of connections; browsers open six.
const MOST_CONNECTIONS: usize = 32;

/// Time without a request after which a connection may be closed for a new one if there are too many.
const MOST_SILENCE: Duration = Duration::from_secs(1);

/// Pause after a failed connection, because file descriptors may be scarce.
const PAUSE: Duration = Duration::from_millis(100);

/// A server; dropping it stops it.
#[derive(Debug)]
pub(super) struct Server {
    end: Arc<End>,
}

/// Shared state that stops a server.
#[derive(Debug)]
struct End {
    address: SocketAddr,
    is_closed: AtomicBool,
}

impl End {
    /// Closes the server. A connection wakes up its thread.
    fn close(&self) {
        if !self.is_closed.swap(true, Ordering::Relaxed) {
            let _ = TcpStream::connect_timeout(&self.address, PAUSE);
        }
    }
}

/// Open connections, the oldest first.
#[derive(Debug, Default)]
struct Connections(Mutex<Vec<Connection>>);

#[derive(Debug)]
struct Connection {
    id: u64,
    stream: TcpStream,
    since: Instant,
    /// True until the request of the connection has arrived.
    is_silent: bool,
}

/// A connection that is counted until this value is dropped.
struct Counted {
    all: Arc<Connections>,
    id: u64,
}

impl Connections {
    /// Counts the connection with this number. If there are too many, it closes one that has sent no request
    /// for [`MOST_SILENCE`]. Returns `None` if there is none to close.
    fn add(all: &Arc<Self>, stream: &TcpStream, id: u64, now: Instant) -> Option<Counted> {
        let stream = stream.try_clone().ok()?;
        let mut open = lock(&all.0);
        if open.len() >= MOST_CONNECTIONS {
            let is_long_silent =
                |c: &Connection| c.is_silent && now.saturating_duration_since(c.since) >= MOST_SILENCE;
            let at = open.iter().position(is_long_silent)?;
            let silent = open.remove(at);
            // The thread of the connection reads its end.
            let _ = silent.stream.shutdown(Shutdown::Both);
        }
        open.push(Connection { id, stream, since: now, is_silent: true });
        Some(Counted { all: Arc::clone(all), id })
    }
}

impl Counted {
    /// Records that the request has arrived.
    fn has_come(&self) {
        let mut open = lock(&self.all.0);
        open.iter_mut().filter(|c| c.id == self.id).for_each(|c| c.is_silent = false);
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        lock(&self.all.0).retain(|c| c.id != self.id);
    }
}

impl Server {
    /// Serves the page at a free port.
    pub(super) fn start(page: Arc<Page>) -> io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let end = Arc::new(End { address: listener.local_addr()?, is_closed: AtomicBool::new(false) });
        let end_of_listener = Arc::clone(&end);
        thread::Builder::new()
            .name("fmufit-watch".to_owned())
            .spawn(move || listen(&listener, &end_of_listener, &page))?;
        Ok(Self { end })
    }

    pub(super) fn address(&self) -> SocketAddr {
        self.end.address
    }

    /// True after the server has stopped.
    pub(super) fn is_closed(&self) -> bool {
        self.end.is_closed.load(Ordering::Relaxed)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // The threads end by themselves, so a hanging client blocks nothing.
        self.end.close();
    }
}

fn listen(listener: &TcpListener, end: &Arc<End>, page: &Arc<Page>) {
    let open = Arc::new(Connections::default());
    for (id, connection) in (0..).zip(listener.incoming()) {
        if end.is_closed.load(Ordering::Relaxed) {
            return;
        }
        let Ok(stream) = connection else {
            thread::sleep(PAUSE);
            continue;
        };
        let Some(counted) = Connections::add(&open, &stream, id, Instant::now()) else {
            refuse(stream);
            continue;
        };
        let (end, page) = (Arc::clone(end), Arc::clone(page));
        let serve = move || {
            if serve(stream, &counted, end.address, &page) {
                end.close();
            }
        };
        // If no thread is available, the connection is closed.
        let _ = thread::Builder::new().name("fmufit-watch".to_owned()).spawn(serve);
    }
}

/// Reports to a client that there are too many connections, without waiting for the client.
fn refuse(mut stream: TcpStream) {
    if stream.set_nonblocking(true).is_ok() {
        let _ = Response::from(Status::Busy).send(&mut stream, false);
    }
}

/// Answers the request of a connection. Returns true if it is the last one.
fn serve(mut stream: TcpStream, counted: &Counted, address: SocketAddr, page: &Page) -> bool {
    let read = request::read(&mut stream);
    counted.has_come();
    let (response, is_head) = match read {
        Ok(None) => return false,
        Ok(Some(request)) => (page.answer(&request, address), request.method == "HEAD"),
        Err(status) => (Response::from(status), false),
    };
    // The client may have disconnected.
    let _ = response.send(&mut stream, is_head);
    response.is_last
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn oldest_silent_connection_is_closed_when_server_is_full() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let pair = || {
            let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
            (client, listener.accept().unwrap().0)
        };
        let (open, now) = (Arc::new(Connections::default()), Instant::now());
        let mut held: Vec<(TcpStream, TcpStream, Counted)> = (0..32)
            .map(|id| {
                let (client, connection) = pair();
                let counted = Connections::add(&open, &connection, id, now).unwrap();
                (client, connection, counted)
            })
            .collect();
        held[0].2.has_come();
        let (_client, connection) = pair();
        assert!(Connections::add(&open, &connection, 32, now + MOST_SILENCE / 2).is_none());
        // The first connection has sent its request, so the second one is closed.
        let _counted = Connections::add(&open, &connection, 33, now + MOST_SILENCE).unwrap();
        assert_eq!(held[1].0.read(&mut [0]).unwrap(), 0);
        held[0].1.set_nonblocking(true).unwrap();
        assert!(held[0].1.read(&mut [0]).is_err());
        assert_eq!(lock(&open.0).len(), MOST_CONNECTIONS);
        drop(held);
        assert_eq!(lock(&open.0).len(), 1);
    }
}
