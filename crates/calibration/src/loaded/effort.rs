//! Computing effort of a part of a fit.

use ode::{Seconds, Stats};
use serde::{Deserialize, Serialize};
use std::ops::AddAssign;
use std::time::Duration;

/// Computing effort of a part of a fit. All values compare equal, because wall-clock times differ between
/// runs.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Effort {
    /// Number of simulations, without the additional [checks](ode::Checks).
    pub simulations: u64,
    /// Number of right-hand sides in these simulations.
    pub right_hand_sides: u64,
    /// Wall-clock time.
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub seconds: Seconds,
}

impl Effort {
    pub(crate) fn of(stats: &Stats, elapsed: Duration) -> Self {
        Self {
            simulations: stats.runs,
            right_hand_sides: stats.right_hand_sides,
            seconds: Seconds::new(elapsed.as_secs_f64()),
        }
    }
}

impl PartialEq for Effort {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl AddAssign for Effort {
    fn add_assign(&mut self, other: Self) {
        self.simulations += other.simulations;
        self.right_hand_sides += other.right_hand_sides;
        self.seconds += other.seconds;
    }
}
