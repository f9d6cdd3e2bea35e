//! Named choices: scale and kind of a parameter, treatment of bounds, goal of the search, and measure of
//! tolerances.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Scale on which a parameter is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Transform {
    /// Search the parameter itself.
    #[default]
    Linear,
    /// Search its natural logarithm; only for positive parameters.
    Log,
}

/// Kind of the values of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ParameterKind {
    /// Any value within the bounds.
    #[default]
    Continuous,
    /// Integers.
    Integer,
    /// Integers that represent choices: 3 is no closer to 2 than to 7.
    Categorical,
}

impl fmt::Display for ParameterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Continuous => "continuous",
            Self::Integer => "integer",
            Self::Categorical => "categorical",
        })
    }
}

/// Treatment of points outside the bounds by a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum BoundsHandling {
    /// No point is outside. The search uses an angle whose sine determines the position between two bounds,
    /// and a hyperbola for one bound. Source: MINUIT (James and Roos, Comput. Phys. Commun. 10, 1975). A cost
    /// that decreases towards a bound is smooth as a function of the angle, with its minimum at the bound.
    /// With mirroring, the cost has a kink there; with clamping, a simplex becomes flat. Of 126 runs in boxes
    /// (`benches/simplex.rs`), 125 are solved with a mean of 788 evaluations. Mirroring solves 94 with 5385,
    /// and clamping 84 with 4578.
    #[default]
    Sine,
    /// Points are mirrored at the bound, repeatedly if necessary, and once at each linear constraint.
    Mirror,
    /// Points are moved onto the bound.
    Clamp,
}

/// Goal of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Search {
    /// The minimum nearest to the start.
    #[default]
    Local,
    /// The lowest minimum in a box.
    Global,
}

/// Measure of the tolerances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ToleranceMeasure {
    /// `x_tol` in units of the parameter's size, `f_tol` as a fraction of |f_best|.
    #[default]
    Relative,
    /// Both tolerances are absolute, in the user's units.
    Absolute,
}

/// Number of tolerance tests that must pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum StopRule {
    /// Either test ends the run.
    Any,
    /// Both tests must pass at the same time.
    #[default]
    All,
}
