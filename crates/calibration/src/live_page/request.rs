//! Requests, read with limits of size and time.

use super::response::Status;
use httparse::{EMPTY_HEADER, Header};
use std::io::{ErrorKind, Read};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Maximum size of a request including its body, in bytes; browsers send a tenth of that.
const MOST_BYTES: usize = 8192;

/// Maximum number of headers of a request.
const MOST_HEADERS: usize = 64;

/// Time limit for receiving a complete request.
const TIME: Duration = Duration::from_secs(10);

/// A request.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Request {
    pub(super) method: String,
    pub(super) path: String,
    /// Header `Host`; empty if it is missing or repeated.
    pub(super) host: String,
    pub(super) origin: Option<String>,
}

/// Reads a request. Returns `None` if no request arrives.
pub(super) fn read(stream: &mut TcpStream) -> Result<Option<Request>, Status> {
    let end = Instant::now() + TIME;
    let (mut bytes, mut n) = (vec![0; MOST_BYTES], 0);
    loop {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
            return if n == 0 { Ok(None) } else { Err(Status::Timeout) };
        }
        match stream.read(&mut bytes[n..]) {
            Ok(0) => return Ok(None),
            Ok(more) => n += more,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            // The loop checks the time limit again.
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return Ok(None),
        }
        match parse(&bytes[..n])? {
            Some(request) => return Ok(Some(request)),
            None if n == MOST_BYTES => return Err(Status::TooLarge),
            None => {}
        }
    }
}

/// Parses the request in these bytes. Returns `None` if it is incomplete.
fn parse(bytes: &[u8]) -> Result<Option<Request>, Status> {
    let mut headers = [EMPTY_HEADER; MOST_HEADERS];
    let mut parsed = httparse::Request::new(&mut headers);
    let head = match parsed.parse(bytes) {
        Ok(httparse::Status::Complete(head)) => head,
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(httparse::Error::TooManyHeaders) => return Err(Status::TooLarge),
        Err(_) => return Err(Status::BadRequest),
    };
    let text = |header: &Header<'_>| std::str::from_utf8(header.value).ok().map(str::to_owned);
    let only = |name: &str| {
        let mut found = parsed.headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
        found.next().filter(|_| found.next().is_none()).and_then(text)
    };
    let is_there = |name: &str| parsed.headers.iter().any(|header| header.name.eq_ignore_ascii_case(name));
    if is_there("transfer-encoding") {
        return Err(Status::TooLarge);
    }
    let body = match is_there("content-length") {
        true => {
            only("content-length").and_then(|text| text.parse::<usize>().ok()).ok_or(Status::BadRequest)?
        }
        false => 0,
    };
    match head.checked_add(body) {
        Some(whole) if whole <= bytes.len() => {}
        Some(whole) if whole <= MOST_BYTES => return Ok(None),
        _ => return Err(Status::TooLarge),
    }
    Ok(Some(Request {
        method: parsed.method.unwrap_or_default().to_owned(),
        path: parsed.path.unwrap_or_default().to_owned(),
        host: only("host").unwrap_or_default(),
        origin: is_there("origin").then(|| only("origin").unwrap_or_default()),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parse_returns_complete_request_or_rejects_it() {
        let parsed = |text: &str| parse(text.as_bytes());
        let whole =
            parsed("POST /a/stop HTTP/1.1\r\nhOsT: x:1\r\nContent-Length: 2\r\nOrigin: null\r\n\r\nab");
        let request = Request {
            method: "POST".to_owned(),
            path: "/a/stop".to_owned(),
            host: "x:1".to_owned(),
            origin: Some("null".to_owned()),
        };
        assert_eq!(whole, Ok(Some(request)));
        for part in
            ["", "GET /", "GET / HTTP/1.1\r\nHost: x\r\n", "POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nab"]
        {
            assert_eq!(parsed(part), Ok(None), "{part}");
        }
        for (text, status) in [
            ("\0\0", Status::BadRequest),
            ("GET / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", Status::BadRequest),
            ("GET / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 1\r\n\r\n", Status::BadRequest),
            ("GET / HTTP/1.1\r\nContent-Length: 9000\r\n\r\n", Status::TooLarge),
            ("GET / HTTP/1.1\r\nContent-Length: 18446744073709551615\r\n\r\n", Status::TooLarge),
            ("POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", Status::TooLarge),
            (&format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(65)), Status::TooLarge),
        ] {
            assert_eq!(parsed(text), Err(status), "{text}");
        }
        let two = parsed("GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n").unwrap().unwrap();
        assert_eq!((two.host.as_str(), two.origin), ("", None));
    }
}
