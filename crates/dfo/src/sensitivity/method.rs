//! Methods of a sensitivity analysis.

use super::sobol;
use serde::{Deserialize, Serialize};

/// Method of a sensitivity analysis. Fixed parameters (with equal bounds) have no effect and no points; `D`
/// is the number of free parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(tag = "method", rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SensitivityMethod {
    /// Screening by elementary effects (Morris, Technometrics 33, 1991), with `n (D + 1)` points.
    Morris {
        /// Number of trajectories, at least 2.
        n: usize,
        /// Number of levels of each parameter, even.
        levels: usize,
    },
    /// Sobol' indices (Saltelli et al., Comput. Phys. Commun. 181, 2010), with `n (D + 2)` points, or `n (2
    /// D + 2)` for the second order. At most 20 free parameters.
    Sobol {
        /// Number of rows of the design, at least 2. Powers of two fill the box most evenly.
        n: usize,
        /// True to estimate the effects of pairs of parameters, too.
        second_order: bool,
    },
}

impl SensitivityMethod {
    /// Morris screening with 4 levels. With 10 trajectories, the effects rank the parameters in the examples
    /// of Campolongo, Cariboni and Saltelli (Environ. Modell. Softw. 22, 2007), who use 4 levels.
    pub const MORRIS: Self = Self::Morris { n: 10, levels: 4 };

    /// First- and total-order indices from 1024 rows, the number in the examples of SALib.
    pub const SOBOL: Self = Self::Sobol { n: 1024, second_order: false };

    /// Returns the name of the method, as users write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Morris { .. } => "morris",
            Self::Sobol { .. } => "sobol",
        }
    }

    /// Returns the number of points of one trajectory or row for `d` free parameters.
    pub(super) fn row_length(self, d: usize) -> usize {
        match self {
            Self::Morris { .. } => d + 1,
            Self::Sobol { second_order, .. } => sobol::row_length(d, second_order),
        }
    }

    /// Returns the word for the rows of the design.
    pub(super) fn rows(self) -> &'static str {
        match self {
            Self::Morris { .. } => "trajectories",
            Self::Sobol { .. } => "rows",
        }
    }
}
