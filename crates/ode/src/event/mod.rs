//! State events: the domain memory of the indicators, and root location.
//!
//! An indicator is in the domain `z > 0` or `z <= 0` (the rule of FMI 2.0, 3.2.1). A state event happens if
//! an indicator changes its domain in a direction that its system reports as an event. Signs are compared,
//! not multiplied, because products underflow.

mod crossings;
mod domains;
mod locate;
mod returns_within_step;

pub(crate) use domains::Domains;
pub(crate) use returns_within_step::SLOPE_STEP;
