//! Output: results on the standard output, everything else on the standard error stream.

mod live_line;
mod messages;
mod table;

pub(crate) use live_line::LiveLine;
pub(crate) use table::Table;

use crate::error::Error;
use calibration::visible;
use std::cell::RefCell;
use std::io::{self, ErrorKind, IsTerminal, Write};

/// Both output streams of a command.
pub(crate) struct Console {
    is_quiet: bool,
    /// Error of the last failed write.
    lost: RefCell<Option<io::Error>>,
}

impl Console {
    /// Creates a console. With `is_quiet`, only results and errors are printed. From now on, messages of the
    /// library are printed on the standard error stream.
    pub(crate) fn new(is_quiet: bool) -> Self {
        messages::pass_on(is_quiet);
        Self { is_quiet, lost: RefCell::default() }
    }

    /// Prints a result and a line break.
    pub(crate) fn result(&self, text: &str) {
        self.data(&format!("{}\n", visible(text.trim_end_matches('\n'))));
    }

    /// Prints data for other programs, unchanged.
    pub(crate) fn data(&self, text: &str) {
        let mut out = io::stdout().lock();
        match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            // The reader of the stream may have closed it.
            Err(error) if error.kind() != ErrorKind::BrokenPipe => _ = self.lost.replace(Some(error)),
            _ => {}
        }
    }

    /// Returns an error if a result could not be printed.
    pub(crate) fn finish(&self) -> Result<(), Error> {
        match self.lost.take() {
            Some(error) => Err(Error::input(format!("cannot write to the standard output: {error}"))),
            None => Ok(()),
        }
    }

    /// Prints a JSON document for other programs.
    pub(crate) fn json(&self, document: &impl serde::Serialize) -> Result<(), Error> {
        let text = serde_json::to_string_pretty(document);
        self.data(&(text.map_err(|e| Error::work(format!("cannot write JSON: {e}")))? + "\n"));
        Ok(())
    }

    /// Prints additional information, unless the console is quiet.
    pub(crate) fn note(&self, text: &str) {
        if !self.is_quiet {
            messages::print(text);
        }
    }

    /// Prints requested information that is not a result, even if the console is quiet.
    pub(crate) fn say(&self, text: &str) {
        messages::print(text);
    }

    /// True if the standard error stream is a terminal.
    pub(crate) fn is_terminal(&self) -> bool {
        io::stderr().is_terminal()
    }

    /// Prints an error.
    pub(crate) fn error(&self, error: &Error) {
        messages::print(&format!("error: {error}"));
    }

    /// Creates a progress line, which is shown unless the console is quiet.
    pub(crate) fn live_line(&self) -> LiveLine {
        LiveLine::new(!self.is_quiet, io::stderr().is_terminal())
    }

    /// Returns the width of the standard output in characters; `None` if it is not a terminal.
    pub(crate) fn width(&self) -> Option<u16> {
        let size = terminal_size::terminal_size_of(io::stdout());
        size.filter(|_| io::stdout().is_terminal()).map(|(width, _)| width.0)
    }
}
