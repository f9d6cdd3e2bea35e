//! State events: the domain memory of the indicators, and root location.
//!
//! An indicator is in the domain `z > 0` or `z <= 0` (the rule of FMI 2.0, 3.2.1). A state event happens when
//! one changes its domain, in a direction that its system wants to know of. Signs are never multiplied:
//! products underflow.

mod crossings;
mod domains;
mod locate;
mod returns_within_step;

pub(crate) use domains::Domains;
pub(crate) use returns_within_step::SLOPE_STEP;
