//! Interface between a worker process and the work that it performs.

use super::frame::Frame;
use crate::description::Quirk;
use crate::error::FmiError;
use base::RunContext;

/// Work that a worker performs for its parent process.
pub trait Service {
    /// Answers a message. After the context has ended, the answer is no longer needed.
    ///
    /// # Errors
    /// Returns any error that must be sent to the caller.
    fn answer(
        &mut self,
        requested: &Frame,
        context: &RunContext<'_>,
        answer: &mut Frame,
    ) -> Result<(), FmiError>;

    /// Unpacks the files of the model, and compiles its sources. This writes outside the folder of the
    /// worker. Runs no code of the model.
    fn provide_files(&mut self);

    /// Compiles and loads the model, so that the first answer is faster.
    fn prepare(&mut self);

    /// Returns the departures from the standard detected in runs since the last call.
    fn new_quirks(&mut self) -> Vec<Quirk>;
}
