//! Content of the server: the page of the running fit, its variable part, its buttons, and the report.

use super::request::Request;
use super::response::{Response, Status};
use crate::fit::live::{LiveFit, lock};
use crate::fit::phase::CurrentPhase;
use crate::loaded::calibration::Calibration;
use crate::report::ExperimentCurves;
use crate::report::live_content::LiveSubject;
use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Minimum time between two drawings of the state, for any number of readers. Drawing uses at most a
/// tenth of the time.
const PAUSE: Duration = Duration::from_millis(900);
const SHARE: u32 = 10;

/// Content after the report.
const CLOSE: &str = "<form method=\"post\" action=\"close\"><p>This page is served by the program that made the fit, until it ends. \
                     <button>Close the page</button></p></form>\n</main>";

/// Content shown after the reader has closed the page.
const CLOSED: &str = "<!DOCTYPE html><html lang=\"en\"><meta charset=\"utf-8\"><link rel=\"icon\" href=\"data:,\"><title>closed</title>\
                      <p>The page is closed.</p></html>";

/// The page of a fit.
#[derive(Debug)]
pub(super) struct Page {
    token: String,
    nonce: String,
    subject: LiveSubject,
    live: Arc<LiveFit>,
    phase: Arc<CurrentPhase>,
    is_stop_requested: AtomicBool,
    drawn: Mutex<Option<Drawn>>,
    report: Mutex<Option<Arc<str>>>,
    /// True if the report was requested.
    is_report_read: AtomicBool,
}

/// The last drawn state.
#[derive(Debug)]
struct Drawn {
    text: Arc<str>,
    at: Instant,
    took: Duration,
}

/// Returns an unguessable string.
pub(super) fn token() -> io::Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// True if two strings are equal. The comparison time does not reveal where they differ.
fn is_same(one: &str, other: &str) -> bool {
    let differ = one.bytes().zip(other.bytes()).fold(0, |differ, (a, b)| differ | (a ^ b));
    one.len() == other.len() && differ == 0
}

impl Page {
    pub(super) fn new(calibration: &Calibration, token: String, nonce: String) -> Self {
        Self {
            token,
            nonce,
            subject: LiveSubject::new(calibration),
            live: Arc::default(),
            phase: Arc::default(),
            is_stop_requested: AtomicBool::new(false),
            drawn: Mutex::default(),
            report: Mutex::default(),
            is_report_read: AtomicBool::new(false),
        }
    }

    pub(super) fn token(&self) -> &str {
        &self.token
    }

    pub(super) fn live(&self) -> &Arc<LiveFit> {
        &self.live
    }

    pub(super) fn phase(&self) -> &Arc<CurrentPhase> {
        &self.phase
    }

    pub(super) fn is_stop_requested(&self) -> bool {
        self.is_stop_requested.load(Ordering::Relaxed)
    }

    /// True if a reader has recently requested the running fit, but not yet its end.
    pub(super) fn has_reader(&self) -> bool {
        let is_looked_at = lock(&self.drawn).as_ref().is_some_and(|drawn| drawn.at.elapsed() < 3 * PAUSE);
        is_looked_at && !self.is_report_read.load(Ordering::Relaxed)
    }

    /// Returns the responses that the search has simulated so far at its start and at the best point.
    pub(super) fn curves(&self) -> Vec<ExperimentCurves> {
        self.subject.curves(&self.live)
    }

    pub(super) fn set_report(&self, report: String) {
        *lock(&self.report) = Some(report.replacen("</main>", CLOSE, 1).into());
    }

    /// Answers a request received at the address of the server.
    pub(super) fn answer(&self, request: &Request, address: SocketAddr) -> Response {
        // Another host name for this address belongs to a site that tries to reach the server through its
        // visitors' browsers.
        let is_this_server = |host: &str| {
            [address.to_string(), format!("localhost:{}", address.port())]
                .iter()
                .any(|name| host.eq_ignore_ascii_case(name))
        };
        if !is_this_server(&request.host) {
            return Status::Forbidden.into();
        }
        let path = request.path.strip_prefix('/').and_then(|path| path.split_once('/'));
        let Some((_, path)) = path.filter(|(token, _)| is_same(token, &self.token)) else {
            return Status::NotFound.into();
        };
        match (path, request.method.as_str()) {
            ("", "GET" | "HEAD") => self.page(),
            ("state", "GET" | "HEAD") => self.state(),
            ("stop" | "close", "POST") => {
                let from = request.origin.as_ref();
                if from.is_some_and(|origin| !origin.strip_prefix("http://").is_some_and(is_this_server)) {
                    return Status::Forbidden.into();
                }
                if path == "stop" {
                    self.is_stop_requested.store(true, Ordering::Relaxed);
                    return Status::SeePage.into();
                }
                match *lock(&self.report) {
                    Some(_) => Response { is_last: true, ..Response::page(CLOSED.into()) },
                    // A running fit must not lose its page.
                    None => Status::SeePage.into(),
                }
            }
            ("" | "state", _) => Response { allowed: "GET, HEAD", ..Status::WrongMethod.into() },
            ("stop" | "close", _) => Response { allowed: "POST", ..Status::WrongMethod.into() },
            _ => Status::NotFound.into(),
        }
    }

    fn page(&self) -> Response {
        let report = lock(&self.report).clone();
        match report {
            Some(report) => {
                self.is_report_read.store(true, Ordering::Relaxed);
                Response::page(report)
            }
            None => {
                let text = self.subject.page(&self.nonce, &self.drawn());
                Response { nonce: Some(self.nonce.clone()), ..Response::page(text.into()) }
            }
        }
    }

    fn state(&self) -> Response {
        match lock(&self.report).is_some() {
            true => Status::Reset.into(),
            false => Response::page(self.drawn()),
        }
    }

    /// Returns the variable part of the page.
    fn drawn(&self) -> Arc<str> {
        let mut drawn = lock(&self.drawn);
        if let Some(drawn) = &*drawn
            && drawn.at.elapsed() < PAUSE.max(drawn.took * SHARE)
        {
            return Arc::clone(&drawn.text);
        }
        let began = Instant::now();
        let phase = self.phase.get().name();
        let text: Arc<str> = match self.is_stop_requested() {
            true => self.subject.state(&self.live, &format!("ending ({phase})")),
            false => self.subject.state(&self.live, phase),
        }
        .into();
        let at = Instant::now();
        *drawn = Some(Drawn { text: Arc::clone(&text), at, took: at - began });
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_long_and_distinct() {
        let (one, other) = (token().unwrap(), token().unwrap());
        assert!(one.len() == 32 && one != other);
        assert!(is_same(&one, &one.clone()) && !is_same(&one, &other));
        assert!(!is_same(&one, &one[..31]) && !is_same("", &one));
    }
}
