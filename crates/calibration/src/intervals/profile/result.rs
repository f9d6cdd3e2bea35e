//! The numbers of a profile likelihood, and how they are printed.

use crate::findings::shown_text::{digits, visible_line};
use crate::uncertainty::stuck_parameters::BoundSide;
use base::Number;
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::fmt;

/// One point of a profile: a parameter held at a value, the others fitted again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProfilePoint {
    /// Where the parameter was held, in the user's units.
    pub value: f64,
    /// The rise of the cost from the optimum, as the square of a distance in standard errors; see
    /// [`Calibration::profile`](crate::Calibration::profile).
    pub statistic: f64,
    /// All parameters there.
    pub x: Vec<f64>,
}

/// End of a profile on one side.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ProfileEnd {
    /// The statistic crosses the threshold at this value: an end of the interval.
    Crossed(f64),
    /// The parameter reaches its bound, at this value, below the threshold: the interval is open.
    AtBound(f64),
    /// The points are used up, at this value, below the threshold: the interval is open.
    PointLimit(f64),
    /// The simulation, or the fit of the others, failed at this value: the interval is open.
    Failed {
        /// Where the parameter was held.
        at: f64,
        /// Why.
        message: String,
    },
    /// The cost is lower at this value than at the optimum, so that this was none.
    LowerCost(f64),
    /// It was interrupted.
    Interrupted,
}

impl ProfileEnd {
    /// The end of the interval; `None`: it is open.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Crossed(value) => Some(*value),
            _ => None,
        }
    }

    /// Why the interval is open on this side, in words; `None`: it is not.
    pub fn why_open(&self, side: BoundSide) -> Option<String> {
        let (bound, toward) = match side {
            BoundSide::Lower => ("lower", "smaller"),
            BoundSide::Upper => ("upper", "larger"),
        };
        let why = match self {
            Self::Crossed(_) => return None,
            Self::AtBound(value) => format!("reaches its {bound} bound, {}", Number(*value)),
            Self::PointLimit(value) => {
                format!("the points are used up at {}, the threshold is not reached", digits(*value))
            }
            Self::Failed { at, message } => format!("no cost at {}: {message}", digits(*at)),
            Self::LowerCost(at) => {
                format!("the cost is lower at {} than at the optimum: fit again from there", digits(*at))
            }
            Self::Interrupted => "interrupted".to_owned(),
        };
        Some(format!("open towards {toward} values: {why}"))
    }
}

/// The profile of one parameter.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ParameterProfile {
    /// Index of the parameter, counted from 0.
    pub parameter: usize,
    /// Its name.
    pub name: String,
    /// Its value at the optimum.
    pub optimum: f64,
    /// The points, by ascending value, the optimum among them.
    pub points: Vec<ProfilePoint>,
    /// End of the profile below the optimum.
    pub lower: ProfileEnd,
    /// End of the profile above the optimum.
    pub upper: ProfileEnd,
}

impl ParameterProfile {
    /// The confidence interval, without an end (infinite) where it is open.
    pub fn interval(&self) -> (f64, f64) {
        (self.lower.value().unwrap_or(f64::NEG_INFINITY), self.upper.value().unwrap_or(f64::INFINITY))
    }

    /// Why the interval is open, in words; empty if it is not.
    pub fn message(&self) -> String {
        let ends = [(&self.lower, BoundSide::Lower), (&self.upper, BoundSide::Upper)];
        ends.iter().filter_map(|(end, side)| end.why_open(*side)).collect::<Vec<_>>().join("; ")
    }
}

/// Profile likelihoods; see [`Calibration::profile`](crate::Calibration::profile). `Display` prints a table.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Profile {
    /// The level of the intervals.
    pub level: f64,
    /// They end where the statistic is this.
    pub threshold: f64,
    /// As those of [`Uncertainty`](crate::Uncertainty::degrees_of_freedom). The statistic of a parameter
    /// whose variance has others is scaled, so that one threshold is that of all.
    pub degrees_of_freedom: f64,
    /// The optimum of the cost, about which the intervals are: that of the fit, found more accurately.
    pub x: Vec<f64>,
    /// The cost there, as the fit has it.
    pub cost: f64,
    /// The profiles, in the order in which they were asked for.
    pub parameters: Vec<ParameterProfile>,
    /// True if the computation was interrupted: some sides are not complete.
    pub is_interrupted: bool,
    /// True if residuals of an output are autocorrelated: the intervals are corrected for that, as those of
    /// [`Uncertainty`](crate::Uncertainty).
    pub is_autocorrelated: bool,
    /// Points that were simulated, those of a file that was continued included.
    pub n_simulations: usize,
    /// Statistics of the simulations, without those of a file that was continued.
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
        if self.is_autocorrelated {
            f.write_str("\n- the residuals are autocorrelated: the intervals are corrected for that")?;
        }
        if self.is_interrupted { f.write_str("\n- interrupted: not all sides are complete") } else { Ok(()) }
    }
}

/// A number with six digits: ends of narrow intervals differ in the last ones.
fn six(value: f64) -> Number {
    Number(format!("{value:.5e}").parse().unwrap_or(value))
}
