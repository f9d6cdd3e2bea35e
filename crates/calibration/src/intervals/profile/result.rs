//! Results of a profile likelihood, and their display.

use crate::findings::display_text::{digits, visible_line};
use crate::uncertainty::inactive_parameters::BoundSide;
use base::Number;
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Point of a profile, with one parameter fixed and the others fitted again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProfilePoint {
    /// Value of the fixed parameter in the user's units.
    pub value: f64,
    /// Rise of the cost from the optimum, as the square of a distance in standard errors; see
    /// [`Calibration::profile`](crate::Calibration::profile).
    pub statistic: f64,
    /// Values of all parameters at this point.
    pub x: Vec<f64>,
}

/// End of a profile on one side.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ProfileEnd {
    /// The statistic crosses the threshold at this value, which is an end of the interval.
    Crossed(f64),
    /// The parameter reaches its bound at this value, below the threshold. The interval is open.
    AtBound(f64),
    /// The maximum number of points is reached at this value, below the threshold. The interval is open.
    PointLimit(f64),
    /// The simulation or the fit of the other parameters failed at this value. The interval is open.
    Failed {
        /// Value of the fixed parameter.
        at: f64,
        /// Reason for the failure.
        message: String,
    },
    /// The cost at this value is below the cost at the presumed optimum.
    LowerCost(f64),
    /// The computation was interrupted.
    Interrupted,
}

impl ProfileEnd {
    /// Returns the end of the interval, or `None` if it is open.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Crossed(value) => Some(*value),
            _ => None,
        }
    }

    /// Returns the reason why the interval is open on this side, or `None` if it is not.
    pub fn why_open(&self, side: BoundSide) -> Option<String> {
        let (bound, toward) = match side {
            BoundSide::Lower => ("lower", "smaller"),
            BoundSide::Upper => ("upper", "larger"),
        };
        let why = match self {
            Self::Crossed(_) => return None,
            Self::AtBound(value) => format!("reaches its {bound} bound, {}", Number(*value)),
            Self::PointLimit(value) => {
                format!("the maximum number of points was reached at {} before the threshold", digits(*value))
            }
            Self::Failed { at, message } => format!("no cost at {}: {message}", digits(*at)),
            Self::LowerCost(at) => {
                format!("the cost is lower at {} than at the optimum. Fit again from there", digits(*at))
            }
            Self::Interrupted => "interrupted".to_owned(),
        };
        Some(format!("open towards {toward} values: {why}"))
    }
}

/// Profile of one parameter.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ParameterProfile {
    /// Index of the parameter, counted from 0.
    pub parameter: usize,
    /// Name of the parameter.
    pub name: String,
    /// Value of the parameter at the optimum.
    pub optimum: f64,
    /// Points in ascending order of the value, including the optimum.
    pub points: Vec<ProfilePoint>,
    /// Statistic divided by the statistic of a single variance, `(N - p) (cost / cost_min - 1)` with the cost
    /// as a sum of squares. It differs from 1 if outputs have separate variances, which are estimated without
    /// bias, or if residuals are autocorrelated; see [`Calibration::profile`](crate::Calibration::profile).
    pub factor: f64,
    /// End of the profile below the optimum.
    pub lower: ProfileEnd,
    /// End of the profile above the optimum.
    pub upper: ProfileEnd,
}

impl ParameterProfile {
    /// Returns the confidence interval. Open ends are infinite.
    pub fn interval(&self) -> (f64, f64) {
        (self.lower.value().unwrap_or(f64::NEG_INFINITY), self.upper.value().unwrap_or(f64::INFINITY))
    }

    /// Returns the reason why the interval is open, or an empty string if it is not.
    pub fn message(&self) -> String {
        let ends = [(&self.lower, BoundSide::Lower), (&self.upper, BoundSide::Upper)];
        ends.iter().filter_map(|(end, side)| end.why_open(*side)).collect::<Vec<_>>().join("; ")
    }
}

/// Profile likelihoods; see [`Calibration::profile`](crate::Calibration::profile). `Display` prints a table.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Profile {
    /// Confidence level of the intervals.
    pub level: f64,
    /// Statistic at which the intervals end.
    pub threshold: f64,
    /// Degrees of freedom, as in [`Uncertainty`](crate::Uncertainty::degrees_of_freedom). If the variance of
    /// a parameter has other degrees of freedom, its statistic is scaled so that one threshold applies to all
    /// parameters.
    pub degrees_of_freedom: f64,
    /// Optimum of the cost and center of the intervals. It is the optimum of the fit, located more
    /// accurately.
    pub x: Vec<f64>,
    /// Cost at the optimum, by the definition of the fit.
    pub cost: f64,
    /// Profiles in the order of the request.
    pub parameters: Vec<ParameterProfile>,
    /// True if the computation was interrupted and some sides are incomplete.
    pub is_interrupted: bool,
    /// True if residuals of an output are autocorrelated. The intervals are then corrected as in
    /// [`Uncertainty`](crate::Uncertainty).
    pub is_autocorrelated: bool,
    /// Number of simulated points, including the points of a resumed file.
    pub n_simulations: usize,
    /// Statistics of the simulations since the file was resumed.
    pub stats: Stats,
}

impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |profile: &ParameterProfile| visible_line(&profile.name).into_owned();
        let width = self.parameters.iter().map(|p| shown(p).chars().count()).max().unwrap_or(0).max(9);
        let level = Number(100.0 * self.level);
        writeln!(
            f,
            "profile likelihood: {level} % intervals, {} degrees of freedom, threshold {}",
            digits(self.degrees_of_freedom),
            digits(self.threshold)
        )?;
        write!(f, "{:<width$}  {:>12}  {:>12}  {:>12}", "parameter", "optimum", "lower", "upper")?;
        for profile in &self.parameters {
            let end = |end: &ProfileEnd| end.value().map_or("open".to_owned(), |v| six(v).to_string());
            let (optimum, lower, upper) = (six(profile.optimum), end(&profile.lower), end(&profile.upper));
            let name = shown(profile);
            write!(f, "\n{name:<width$}  {:>12}  {lower:>12}  {upper:>12}", optimum.to_string())?;
        }
        for profile in self.parameters.iter().filter(|p| !p.message().is_empty()) {
            write!(f, "\n- {}: {}", shown(profile), visible_line(&profile.message()))?;
        }
        let is_scaled = |p: &&ParameterProfile| (p.factor - 1.0).abs() > 0.005;
        let scaled: Vec<&ParameterProfile> = self.parameters.iter().filter(is_scaled).collect();
        if !scaled.is_empty() {
            let factor = |p: &&ParameterProfile| format!("{} ({})", digits(p.factor), shown(p));
            let factors = scaled.iter().map(factor).collect::<Vec<_>>().join(", ");
            write!(
                f,
                "\n- the threshold applies to the rise of the cost, divided by one variance of all residuals, times a factor that \
                 accounts for the estimated variance of each parameter: {factors}"
            )?;
        }
        if self.is_autocorrelated {
            f.write_str("\n- the residuals are autocorrelated, and the intervals are corrected for this")?;
        }
        if self.is_interrupted { f.write_str("\n- interrupted: not all sides are complete") } else { Ok(()) }
    }
}

/// Rounds a number to six digits because the ends of narrow intervals differ only in the last digits.
fn six(value: f64) -> Number {
    Number(format!("{value:.5e}").parse().unwrap_or(value))
}
