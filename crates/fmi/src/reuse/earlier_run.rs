//! What a runner keeps while it makes a run again elsewhere.

use super::lend::CopyLease;
use crate::simulation::digest::Digest;
use crate::sys::RawInstance;

/// A copy that a runner goes back to after a run in another one.
#[derive(Debug)]
pub(crate) struct PreviousCopy {
    // Given back after the instance.
    pub(super) instance: Option<RawInstance>,
    pub(super) lease: CopyLease,
}

/// What a run in a used copy showed, before it is made in a new one.
pub(crate) struct EarlierRun {
    pub(super) digest: Digest,
    /// The run was too long to be made twice.
    pub(super) is_stopped: bool,
    pub(super) wants_steps: bool,
    /// The other run is made in another copy, not by a new instance in the same one.
    pub(super) is_other_copy: bool,
}
