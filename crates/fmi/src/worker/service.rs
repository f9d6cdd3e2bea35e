//! What a worker does.

use super::frame::Frame;
use crate::description::Quirk;
use crate::error::FmiError;

/// What a worker does for who has started it.
pub trait Service {
    /// Answers a message. `cancelled`: the answer is not wanted any more.
    ///
    /// # Errors
    /// Told to the other side.
    fn answer(
        &mut self,
        asked: &Frame,
        cancelled: &dyn Fn() -> bool,
        answer: &mut Frame,
    ) -> Result<(), FmiError>;

    /// Departures from the standard that have shown in runs since the last call.
    fn new_quirks(&mut self) -> Vec<Quirk>;
}
