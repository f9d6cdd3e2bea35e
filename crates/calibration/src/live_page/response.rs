//! Responses.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time limit for a client to receive a response.
const TIME: Duration = Duration::from_secs(30);

/// Limits of time and size for reading what a client still sends after its response. If the connection were
/// closed immediately, the client would lose the response.
const DRAIN_TIME: Duration = Duration::from_millis(500);
const MOST_DRAINED: usize = 1 << 20;

/// Outcome of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    Ok,
    /// The page must be loaded again.
    Reset,
    /// The page has not moved.
    SeePage,
    BadRequest,
    Forbidden,
    NotFound,
    WrongMethod,
    Timeout,
    TooLarge,
    Busy,
}

impl Status {
    fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::Reset => "205 Reset Content",
            Self::SeePage => "303 See Other",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::WrongMethod => "405 Method Not Allowed",
            Self::Timeout => "408 Request Timeout",
            Self::TooLarge => "413 Content Too Large",
            Self::Busy => "503 Service Unavailable",
        }
    }
}

/// A response.
#[derive(Debug)]
pub(super) struct Response {
    pub(super) status: Status,
    /// HTML page.
    pub(super) body: Arc<str>,
    /// Nonce of the only scripts that may run.
    pub(super) nonce: Option<String>,
    /// Methods that the path supports, if the requested method is not one of them.
    pub(super) allowed: &'static str,
    /// True if this is the last response.
    pub(super) is_last: bool,
}

impl Response {
    pub(super) fn page(body: Arc<str>) -> Self {
        Self { body, ..Self::from(Status::Ok) }
    }

    fn head(&self) -> String {
        let script =
            self.nonce.as_ref().map_or_else(|| "'none'".to_owned(), |nonce| format!("'nonce-{nonce}'"));
        let more = match self.status {
            Status::SeePage => "Location: ./\r\n".to_owned(),
            Status::WrongMethod => format!("Allow: {}\r\n", self.allowed),
            _ => String::new(),
        };
        format!(
            "HTTP/1.1 {}\r\nContent-Type: text/html; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\
             Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: same-origin\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\nContent-Security-Policy: default-src 'none'; script-src {script}; \
             style-src 'unsafe-inline'; img-src data:; connect-src 'self'; form-action 'self'; base-uri 'none'; \
             frame-ancestors 'none'\r\n{more}\r\n",
            self.status.line(),
            self.body.len(),
        )
    }

    /// Sends the response, without its body for a HEAD request.
    pub(super) fn send(&self, stream: &mut TcpStream, is_head: bool) -> io::Result<()> {
        let mut text = self.head();
        if !is_head {
            text += &self.body;
        }
        let (mut rest, end) = (text.as_bytes(), Instant::now() + TIME);
        while !rest.is_empty() {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(io::ErrorKind::TimedOut.into());
            }
            stream.set_write_timeout(Some(left))?;
            match stream.write(rest) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(n) => rest = &rest[n..],
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        stream.shutdown(Shutdown::Write)?;
        drain(stream)
    }
}

impl From<Status> for Response {
    fn from(status: Status) -> Self {
        let body = match status {
            Status::Ok | Status::Reset | Status::SeePage => "",
            other => other.line(),
        };
        Self { status, body: body.into(), nonce: None, allowed: "", is_last: false }
    }
}

fn drain(stream: &mut TcpStream) -> io::Result<()> {
    let (end, mut n) = (Instant::now() + DRAIN_TIME, 0);
    let mut bytes = [0; 4096];
    while n < MOST_DRAINED {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut bytes)? {
            0 => break,
            more => n += more,
        }
    }
    Ok(())
}
