//! The values that the variables of a run start with.

use crate::instance::assignments::Assignments;

/// The values that variables start with.
#[derive(Debug, Clone, Default)]
pub(crate) struct StartValues {
    /// Set before the initialization.
    pub(crate) early: Assignments,
    /// Of inputs. The standard allows them before the initialization and in it; models are known that refuse them before.
    pub(crate) inputs: Assignments,
}

/// What a run sets besides the settings of its plan: variables that were set in the copy by earlier runs with other plans.
#[derive(Debug, Default)]
pub(crate) struct Unset {
    pub(crate) structural: Assignments,
    /// Set before the initialization.
    pub(crate) early: Assignments,
    /// Of inputs.
    pub(crate) inputs: Assignments,
}
