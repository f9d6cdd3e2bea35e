//! Global sensitivity analysis: the effect of each parameter on the cost and on the error of each output,
//! over the whole box of the bounds.

mod analysis;
mod quantities;

pub use analysis::{SensitivityOptions, SensitivityProgress};
