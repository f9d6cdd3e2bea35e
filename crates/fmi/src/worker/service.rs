//! Interface between a worker process and the work that it does.

use super::frame::Frame;
use crate::description::Quirk;
use crate::error::FmiError;
use base::RunContext;

/// Work that a worker does for the process that has started it.
pub trait Service {
    /// Answers a message; once the context is over, the answer is not wanted any more.
    ///
    /// # Errors
    /// Told to the other side.
    fn answer(&mut self, asked: &Frame, context: &RunContext<'_>, answer: &mut Frame)
    -> Result<(), FmiError>;

    /// Has the files of the model unpacked, and its sources compiled: that writes outside of the folder of
    /// the worker. Runs no code of the model.
    fn provide_files(&mut self);

    /// Has the model compiled and loaded, so that the first answer takes less.
    fn prepare(&mut self);

    /// Departures from the standard that have shown in runs since the last call.
    fn new_quirks(&mut self) -> Vec<Quirk>;
}
