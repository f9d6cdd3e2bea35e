//! Printing: results on the standard output, all else on the standard error stream.

mod live_line;
mod messages;
mod table;

pub(crate) use live_line::LiveLine;
pub(crate) use table::Table;

use crate::error::Error;
use calibration::visible;
use std::cell::RefCell;
use std::io::{self, ErrorKind, IsTerminal, Write};

/// The two streams of a command.
pub(crate) struct Console {
    is_quiet: bool,
    /// Why something was not printed.
    lost: RefCell<Option<io::Error>>,
}

impl Console {
    /// With `is_quiet` only results and errors are printed. Messages of the library go to the standard error
    /// stream from now on.
    pub(crate) fn new(is_quiet: bool) -> Self {
        messages::pass_on(is_quiet);
        Self { is_quiet, lost: RefCell::default() }
    }

    /// Prints a result, with a line break at its end.
    pub(crate) fn result(&self, text: &str) {
        self.data(&format!("{}\n", visible(text.trim_end_matches('\n'))));
    }

    /// Prints data for other programs, as they are.
    pub(crate) fn data(&self, text: &str) {
        let mut out = io::stdout().lock();
        match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            // Nobody may be there to read it any more.
            Err(error) if error.kind() != ErrorKind::BrokenPipe => _ = self.lost.replace(Some(error)),
            _ => {}
        }
    }

    /// Makes sure that all results were printed.
    pub(crate) fn finish(&self) -> Result<(), Error> {
        match self.lost.take() {
            Some(error) => Err(Error::input(format!("cannot write to the standard output: {error}"))),
            None => Ok(()),
        }
    }

    /// Prints a JSON document for other programs.
    pub(crate) fn json(&self, document: &impl serde::Serialize) -> Result<(), Error> {
        let text = serde_json::to_string_pretty(document);
        self.data(&(text.map_err(|e| Error::work(format!("no JSON can be made: {e}")))? + "\n"));
        Ok(())
    }

    /// Prints what is said beside the result, unless the console is quiet.
    pub(crate) fn note(&self, text: &str) {
        if !self.is_quiet {
            messages::print(text);
        }
    }

    /// Prints what is asked for and no result, even if the console is quiet.
    pub(crate) fn say(&self, text: &str) {
        messages::print(text);
    }

    /// True if somebody at a terminal reads what is said.
    pub(crate) fn is_terminal(&self) -> bool {
        io::stderr().is_terminal()
    }

    /// Prints an error.
    pub(crate) fn error(&self, error: &Error) {
        messages::print(&format!("error: {error}"));
    }

    /// Progress of work, shown unless the console is quiet.
    pub(crate) fn live_line(&self) -> LiveLine {
        LiveLine::new(!self.is_quiet, io::stderr().is_terminal())
    }

    /// Number of characters in a line of the standard output; `None`: it is no terminal.
    pub(crate) fn width(&self) -> Option<u16> {
        let size = terminal_size::terminal_size_of(io::stdout());
        size.filter(|_| io::stdout().is_terminal()).map(|(width, _)| width.0)
    }
}
