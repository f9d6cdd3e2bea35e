//! The server: a thread that listens on the loopback address, and one for each connection. None of them ever
//! waits for the fit, nor the fit for one of them.
//!
//! The syntax of requests is read by httparse. The servers that exist without an asynchronous runtime
//! (tiny_http and what builds on it) limit neither the size of a head nor the time that a client takes.

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

/// Most connections at a time; browsers open six.
const MOST_CONNECTIONS: usize = 32;

/// A connection that has sent no request for so long makes room for another one where there are too many.
const MOST_SILENCE: Duration = Duration::from_secs(1);

/// After a connection that failed the next one is waited for a little: open files may be short.
const PAUSE: Duration = Duration::from_millis(100);

/// A server; dropping it ends it.
#[derive(Debug)]
pub(super) struct Server {
    end: Arc<End>,
}

/// What ends a server.
#[derive(Debug)]
struct End {
    address: SocketAddr,
    is_closed: AtomicBool,
}

impl End {
    /// Closes the server; its thread notices by a connection.
    fn close(&self) {
        if !self.is_closed.swap(true, Ordering::Relaxed) {
            let _ = TcpStream::connect_timeout(&self.address, PAUSE);
        }
    }
}

/// The connections that are served, the oldest first.
#[derive(Debug, Default)]
struct Connections(Mutex<Vec<Connection>>);

#[derive(Debug)]
struct Connection {
    id: u64,
    stream: TcpStream,
    since: Instant,
    /// True until its request has come.
    is_silent: bool,
}

/// A connection that counts until this is dropped.
struct Counted {
    all: Arc<Connections>,
    id: u64,
}

impl Connections {
    /// Counts a connection, which is the one of this number. Where there are too many, one that has sent no
    /// request for [`MOST_SILENCE`] is closed for it; `None`: there is no such.
    fn add(all: &Arc<Self>, stream: &TcpStream, id: u64, now: Instant) -> Option<Counted> {
        let stream = stream.try_clone().ok()?;
        let mut open = lock(&all.0);
        if open.len() >= MOST_CONNECTIONS {
            let is_long_silent =
                |c: &Connection| c.is_silent && now.saturating_duration_since(c.since) >= MOST_SILENCE;
            let at = open.iter().position(is_long_silent)?;
            let silent = open.remove(at);
            // Its thread reads that it has ended.
            let _ = silent.stream.shutdown(Shutdown::Both);
        }
        open.push(Connection { id, stream, since: now, is_silent: true });
        Some(Counted { all: Arc::clone(all), id })
    }
}

impl Counted {
    /// Notes that its request has come.
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
        let own = Arc::clone(&end);
        thread::Builder::new()
            .name("fmufit-watch".to_owned())
            .spawn(move || listen(&listener, &own, &page))?;
        Ok(Self { end })
    }

    pub(super) fn address(&self) -> SocketAddr {
        self.end.address
    }

    /// True once it serves no more.
    pub(super) fn is_closed(&self) -> bool {
        self.end.is_closed.load(Ordering::Relaxed)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Its threads end by themselves: a client that hangs keeps nobody waiting.
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
        // No thread can be had: the connection is closed.
        let _ = thread::Builder::new().name("fmufit-watch".to_owned()).spawn(serve);
    }
}

/// Tells a client that there are too many, without waiting for it.
fn refuse(mut stream: TcpStream) {
    if stream.set_nonblocking(true).is_ok() {
        let _ = Response::from(Status::Busy).send(&mut stream, false);
    }
}

/// Answers the request of a connection. Returns whether it is the last one.
fn serve(mut stream: TcpStream, counted: &Counted, own: SocketAddr, page: &Page) -> bool {
    let read = request::read(&mut stream);
    counted.has_come();
    let (response, is_head) = match read {
        Ok(None) => return false,
        Ok(Some(request)) => (page.answer(&request, own), request.method == "HEAD"),
        Err(status) => (Response::from(status), false),
    };
    // The client may have gone.
    let _ = response.send(&mut stream, is_head);
    response.is_last
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn the_longest_silent_connection_makes_room() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let pair = || {
            let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
            (client, listener.accept().unwrap().0)
        };
        let (open, now) = (Arc::new(Connections::default()), Instant::now());
        let mut held: Vec<(TcpStream, TcpStream, Counted)> = (0..32)
            .map(|id| {
                let (client, own) = pair();
                let counted = Connections::add(&open, &own, id, now).unwrap();
                (client, own, counted)
            })
            .collect();
        held[0].2.has_come();
        let (_client, own) = pair();
        assert!(Connections::add(&open, &own, 32, now + MOST_SILENCE / 2).is_none());
        // The first one has sent its request: it is the second one that goes.
        let _counted = Connections::add(&open, &own, 33, now + MOST_SILENCE).unwrap();
        assert_eq!(held[1].0.read(&mut [0]).unwrap(), 0);
        held[0].1.set_nonblocking(true).unwrap();
        assert!(held[0].1.read(&mut [0]).is_err());
        assert_eq!(lock(&open.0).len(), MOST_CONNECTIONS);
        drop(held);
        assert_eq!(lock(&open.0).len(), 1);
    }
}
