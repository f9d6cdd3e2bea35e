//! An experiment as a check looks at it.

use crate::experiment::Experiment;
use fmi::ModelDescription;

/// An experiment that is looked at.
pub(super) struct Subject<'a> {
    /// What its findings begin with: its name and a colon, where there are several.
    pub(super) prefix: String,
    pub(super) experiment: &'a Experiment,
    pub(super) description: &'a ModelDescription,
    /// Where its simulation starts, in s.
    pub(super) start_time: f64,
}
