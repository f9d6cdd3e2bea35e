//! What a worker does.

use super::frame::Frame;
use crate::description::Quirk;
use crate::error::FmiError;
use base::RunContext;

/// What a worker does for who has started it.
pub trait Service {
    /// Answers a message; once the context is over, the answer is not wanted any more.
    ///
    /// # Errors
    /// Told to the other side.
    fn answer(&mut self, asked: &Frame, context: &RunContext<'_>, answer: &mut Frame)
    -> Result<(), FmiError>;

    /// Departures from the standard that have shown in runs since the last call.
    fn new_quirks(&mut self) -> Vec<Quirk>;
}
