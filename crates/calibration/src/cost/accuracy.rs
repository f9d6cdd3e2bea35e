//! Settings of simulations that are more accurate than the simulations of a fit, for comparison.

use base::Number;
use serde::{Deserialize, Serialize};

/// Setting that makes a simulation more accurate than the simulations of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) enum Accuracy {
    /// Relative tolerance of the simulation.
    Tolerance(f64),
    /// Half of each step for fixed-step methods, on which a tolerance has no effect. Half of the
    /// communication step for a co-simulation.
    HalfStep,
}

impl Accuracy {
    /// Returns the remedy for a step that is too large.
    pub(crate) fn smaller_step(step_size: Option<f64>) -> String {
        let than = step_size.map_or_else(String::new, |step| format!(" than {}", Number(step)));
        format!("Set a smaller step_size{than}")
    }

    /// Returns the name of the setting for messages.
    pub(crate) fn words(is_step_halved: bool) -> &'static str {
        if is_step_halved { "half the step" } else { "a tenth of the relative tolerance" }
    }
}
