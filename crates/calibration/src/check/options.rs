//! Options of a check.

use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use base::Number;
use std::time::Duration;

/// Options of a check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckOptions {
    /// True to simulate at the start values; default: true.
    pub simulate: bool,
    /// Wall-clock limit of the whole check; default: none. If it expires, the result contains the findings so
    /// far and a finding about the limit.
    pub max_time: Option<Duration>,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { simulate: true, max_time: None }
    }
}

impl CheckOptions {
    /// Returns the finding that the time limit ended the check.
    pub(super) fn out_of_time(&self, is_start_simulated: bool) -> Finding {
        let limit = Number(self.max_time.unwrap_or_default().as_secs_f64());
        let until = match is_start_simulated {
            true => "before the last simulation",
            false => "during the simulation at the start values",
        };
        Finding::warning(
            FindingId::IncompleteAssessment,
            "max_time",
            format!(
                "the time limit of {limit} s ended the check {until}. Findings of these simulations are missing"
            ),
            "Set a larger max_time, or simulate=False",
        )
    }
}
