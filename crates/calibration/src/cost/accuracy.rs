//! Settings of simulations that are more accurate than those of a fit, for comparison with them.

use base::Number;
use serde::{Deserialize, Serialize};

/// Setting by which a simulation is more accurate than those of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) enum Accuracy {
    /// With this relative tolerance.
    Tolerance(f64),
    /// With each step in two halves, of fixed-step methods, on which a tolerance has no effect; of a
    /// co-simulation with half the communication step.
    HalfStep,
}

impl Accuracy {
    /// What to do about a step that is too large.
    pub(crate) fn smaller_step(step_size: Option<f64>) -> String {
        let than = step_size.map_or_else(String::new, |step| format!(" than the {} s of now", Number(step)));
        format!("give a smaller step_size{than}")
    }

    /// Name of the setting, for messages.
    pub(crate) fn words(is_step_halved: bool) -> &'static str {
        if is_step_halved { "half the step" } else { "a tenth of the relative tolerance" }
    }
}
