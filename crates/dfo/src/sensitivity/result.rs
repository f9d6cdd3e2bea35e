//! Result of a sensitivity analysis.

use super::method::SensitivityMethod;
use super::morris::MorrisEffects;
use super::sobol::SobolIndices;
use crate::error::Error;
use base::Number;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Options of the estimates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct IntervalOptions {
    /// Level of the confidence intervals, between 0 and 1.
    pub level: f64,
    /// Number of resamples of the bootstrap, at least 2.
    pub n_resamples: usize,
}

impl Default for IntervalOptions {
    /// Returns a level of 0.95 and 1000 resamples, the default of SALib for Morris screening.
    fn default() -> Self {
        Self { level: 0.95, n_resamples: 1000 }
    }
}

impl IntervalOptions {
    /// Checks the options.
    ///
    /// # Errors
    /// Returns an error if an option is out of range.
    pub fn check(&self) -> Result<(), Error> {
        let Self { level, n_resamples } = *self;
        if !(level > 0.0 && level < 1.0) {
            return Err(Error::Option { name: "level", value: level, range: "between 0 and 1" });
        }
        if n_resamples < 2 {
            let range = "at least 2";
            return Err(Error::Option { name: "n_resamples", value: n_resamples as f64, range });
        }
        Ok(())
    }
}

/// Effects of the parameters on one value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Effects {
    /// Elementary effects.
    Morris(MorrisEffects),
    /// Sobol' indices.
    Sobol(SobolIndices),
}

/// Effects of the parameters on one value, with the extent of the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct OutputEffects {
    /// Name of the value.
    pub name: String,
    /// Number of trajectories or rows used.
    pub n_used: usize,
    /// Number of trajectories or rows left out because a value is missing.
    pub n_left_out: usize,
    /// Reason why the effects are NaN.
    pub reason: Option<String>,
    /// Effects.
    pub effects: Effects,
}

/// Effects of the parameters on each value. `Display` prints tables.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Sensitivity {
    /// Method with its numbers.
    pub method: SensitivityMethod,
    /// Names of the free parameters.
    pub parameters: Vec<String>,
    /// Effects on each value.
    pub outputs: Vec<OutputEffects>,
    /// Level of the confidence intervals.
    pub level: f64,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Number of evaluations.
    pub n_evaluations: usize,
    /// Number of points with missing values.
    pub n_failed: usize,
    /// Number of points that were not evaluated.
    pub n_missing: usize,
    /// Reasons of missing values with the number of points, most frequent first.
    pub failures: Vec<(String, usize)>,
    /// Points of the design, in the user's units: trajectory by trajectory, or row by row.
    pub points: Vec<Vec<f64>>,
    /// Values at the points; empty if a point failed or was not evaluated.
    pub values: Vec<Vec<f64>>,
}

impl Sensitivity {
    /// Returns the tables as text. `shown` converts names, which may come from a file, to printable text.
    pub fn to_text(&self, shown: impl Fn(&str) -> String) -> String {
        let names: Vec<String> = self.parameters.iter().map(|name| shown(name)).collect();
        let titles: Vec<String> = self.outputs.iter().map(|output| shown(&output.name)).collect();
        let width = names.iter().chain(&titles).map(|name| name.chars().count()).max().unwrap_or(0);
        let level = Number(100.0 * self.level);
        let (method, n) = (self.method.name(), self.n_evaluations);
        let mut text = format!("sensitivity ({method}): {n} evaluations, {level} % intervals");
        for (output, title) in self.outputs.iter().zip(&titles) {
            match &output.reason {
                Some(reason) => text += &format!("\n{title}: no result, because {reason}"),
                None => text += &output.effects.rows(&names, width, title),
            }
            if output.n_left_out > 0 {
                let rows = self.method.rows();
                text += &format!("\n- {} {rows} left out because of missing values", output.n_left_out);
            }
        }
        if self.n_missing > 0 {
            text += &format!("\n- incomplete: {} points were not evaluated", self.n_missing);
        }
        for (reason, count) in &self.failures {
            text += &format!("\n- {count} points with missing values: {}", shown(reason));
        }
        text
    }
}

impl fmt::Display for Sensitivity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.to_text(str::to_owned))
    }
}

impl Effects {
    /// Returns the lines of the table, each after a line break.
    fn rows(&self, names: &[String], width: usize, title: &str) -> String {
        match self {
            Self::Morris(found) => {
                let MorrisEffects { mu, mu_star, sigma, mu_star_conf } = found;
                let columns = [("mu*", mu_star), ("+-", mu_star_conf), ("mu", mu), ("sigma", sigma)];
                table(names, width, title, &columns)
            }
            Self::Sobol(found) => {
                let SobolIndices { s1, s1_conf, st, st_conf, s2, s2_conf } = found;
                let columns = [("S1", s1), ("+-", s1_conf), ("ST", st), ("+-", st_conf)];
                let mut text = table(names, width, title, &columns);
                if names.len() > 1 && !s2.is_empty() {
                    let d = names.len();
                    let pairs = || (0..d).flat_map(|j| (j + 1..d).map(move |k| (j, k)));
                    let of = |matrix: &[f64]| pairs().map(|(j, k)| matrix[j * d + k]).collect::<Vec<_>>();
                    let names: Vec<String> =
                        pairs().map(|(j, k)| format!("{}, {}", names[j], names[k])).collect();
                    let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(width);
                    text += &table(&names, width, title, &[("S2", &of(s2)), ("+-", &of(s2_conf))]);
                }
                text
            }
        }
    }
}

fn table(names: &[String], width: usize, title: &str, columns: &[(&str, &Vec<f64>)]) -> String {
    let mut text = format!("\n{title:<width$}");
    columns.iter().for_each(|(title, _)| text += &format!("  {title:>10}"));
    for (i, name) in names.iter().enumerate() {
        text += &format!("\n{name:<width$}");
        columns.iter().for_each(|(_, values)| text += &format!("  {:>10}", digits(values[i])));
    }
    text
}

/// Rounds a number to four digits.
fn digits(value: f64) -> String {
    Number(format!("{value:.3e}").parse().unwrap_or(value)).to_string()
}
