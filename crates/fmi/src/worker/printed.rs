//! The last part of the printed output of a process.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, PipeWriter, Read};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Number of bytes that are kept.
const KEPT: usize = 16 << 10;

/// Maximum number of characters in an error.
const IN_ERRORS: usize = 400;

/// Maximum time to wait for the last output of a process after its end.
const LAST_WORDS: Duration = Duration::from_millis(100);

/// The last bytes that processes write to a pipe.
#[derive(Debug)]
pub(super) struct Printed {
    kept: Arc<Mutex<VecDeque<u8>>>,
    /// Reads until all writers have ended. Without the reader, the writers would block when the pipe is full.
    reader: JoinHandle<()>,
}

impl Printed {
    /// Creates a reader, and returns the pipe for the output.
    pub(super) fn pipe() -> io::Result<(Self, PipeWriter)> {
        let (from, to) = io::pipe()?;
        let kept = Arc::default();
        let reader = std::thread::Builder::new().name("fmufit-worker-output".to_owned());
        let keep = Arc::clone(&kept);
        Ok((Self { reader: reader.spawn(move || keep_printed(from, &keep))?, kept }, to))
    }

    /// Returns the last output after the end of the process. Other processes may keep the pipe open for
    /// longer.
    pub(super) fn last_words(&self) -> String {
        let began = Instant::now();
        while !self.reader.is_finished() && began.elapsed() < LAST_WORDS {
            std::thread::sleep(Duration::from_millis(1));
        }
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes: Vec<u8> = kept.iter().copied().collect();
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        let text = lines.join(" | ");
        let n = text.chars().count();
        let cut: String = text.chars().skip(n.saturating_sub(IN_ERRORS)).collect();
        if n > IN_ERRORS { format!("... {cut}") } else { cut }
    }
}

fn keep_printed(mut from: impl Read, to: &Mutex<VecDeque<u8>>) {
    let mut buffer = [0; 4096];
    loop {
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => {
                let mut kept = to.lock().unwrap_or_else(PoisonError::into_inner);
                kept.extend(&buffer[..n]);
                let surplus = kept.len().saturating_sub(KEPT);
                kept.drain(..surplus);
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => break,
        }
    }
}
