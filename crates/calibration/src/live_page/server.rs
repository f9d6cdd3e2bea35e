//! The server: a thread that listens on the loopback address, and one for each connection. None of them ever
//! waits for the fit, nor the fit for one of them.
//!
//! The syntax of requests is read by httparse. The servers that exist without an asynchronous runtime
//! (tiny_http and what builds on it) limit neither the size of a head nor the time that a client takes.

use super::page::Page;
use super::request;
use super::response::{Response, Status};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

/// Most connections at a time; browsers open six.
const MOST_CONNECTIONS: usize = 32;

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

/// A connection that counts until it is dropped.
struct Counted(Arc<AtomicUsize>);

impl Counted {
    /// `None`: there are too many.
    fn new(n: &Arc<AtomicUsize>) -> Option<Self> {
        let own = Self(Arc::clone(n));
        (n.fetch_add(1, Ordering::Relaxed) < MOST_CONNECTIONS).then_some(own)
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
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
    let n_open = Arc::new(AtomicUsize::new(0));
    for connection in listener.incoming() {
        if end.is_closed.load(Ordering::Relaxed) {
            return;
        }
        let Ok(stream) = connection else {
            thread::sleep(PAUSE);
            continue;
        };
        let Some(counted) = Counted::new(&n_open) else {
            refuse(stream);
            continue;
        };
        let (end, page) = (Arc::clone(end), Arc::clone(page));
        let serve = move || {
            let _counted = counted;
            if serve(stream, end.address, &page) {
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
fn serve(mut stream: TcpStream, own: SocketAddr, page: &Page) -> bool {
    let (response, is_head) = match request::read(&mut stream) {
        Ok(None) => return false,
        Ok(Some(request)) => (page.answer(&request, own), request.method == "HEAD"),
        Err(status) => (Response::from(status), false),
    };
    // The client may have gone.
    let _ = response.send(&mut stream, is_head);
    response.is_last
}
