//! Pareto fronts of designs.

use crate::error::CalibrationError;
use crate::findings::display_text::visible_line;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use base::Number;
use dfo::{ParetoFront, ParetoPoint};
use serde_json::{Value as Json, json};
use std::fmt;

/// Result of [`Design::pareto`](crate::Design::pareto). `Display` prints a table.
#[derive(Debug, Clone)]
pub struct DesignFront {
    /// The goals as written.
    pub goals: Vec<String>,
    /// Designs of which none is better in all goals. Their criteria are the values to minimise, so a goal to
    /// maximise has the opposite sign; see [`values`](Self::values).
    pub front: ParetoFront,
    /// Search and simulations, with the names and units of the parameters. Its own parameters are those of
    /// the best value of the first goal.
    pub fit: Fit,
    /// True for goals that are maximised.
    is_maximum: Vec<bool>,
}

/// Maximum number of rows that `Display` prints.
const MOST_ROWS: usize = 20;

impl DesignFront {
    pub(super) fn new(calibration: &Calibration, mut fit: Fit) -> Self {
        let goals = &calibration.problem().goals;
        Self {
            goals: goals.iter().map(|goal| goal.text().to_owned()).collect(),
            front: fit.report.front.take().unwrap_or_default(),
            fit,
            is_maximum: goals.iter().map(|goal| goal.is_maximum()).collect(),
        }
    }

    /// Returns the values of the goals at a point of the front.
    pub fn values(&self, point: &ParetoPoint) -> Vec<f64> {
        let signed = point.criteria.iter().zip(&self.is_maximum);
        signed.map(|(criterion, is_maximum)| if *is_maximum { -criterion } else { *criterion }).collect()
    }

    /// True if there is a design that satisfies the constraints. The usual end of the search is its limit of
    /// evaluations: NSGA-II has no other criterion.
    pub fn is_success(&self) -> bool {
        !self.front.points.is_empty()
    }

    /// Returns the front as JSON: objectives, and the values and parameters of each design. Numbers that are
    /// not finite are null.
    ///
    /// # Errors
    /// Returns an error if the front cannot be serialised.
    pub fn to_json(&self) -> Result<String, CalibrationError> {
        let points = self.front.points.iter().map(|point| {
            json!({
                "objectives": self.values(point),
                "parameters": point.x,
                "constraint_violation": point.constr_violation,
            })
        });
        let parameters = self.fit.names.iter().zip(&self.fit.units);
        let parameters = parameters.map(|(name, unit)| json!({ "name": name, "unit": unit }));
        let report = &self.fit.report;
        let findings: Vec<String> = self.fit.setup_findings.iter().map(ToString::to_string).collect();
        let document = json!({
            "objectives": self.goals,
            "parameters": parameters.collect::<Vec<Json>>(),
            "front": points.collect::<Vec<Json>>(),
            "compromise": self.compromise(),
            "success": self.is_success(),
            "message": report.message,
            "method": report.method,
            "n_evaluations": report.n_evaluations,
            "n_failed": report.n_failed,
            "seed": report.seed,
            "findings": findings,
        });
        serde_json::to_string_pretty(&document)
            .map_err(|e| CalibrationError::Setup(format!("the front cannot be written as JSON: {e}")))
    }

    /// Returns the index of the [compromise](ParetoFront::compromise); `None` if the front is empty.
    pub fn compromise(&self) -> Option<usize> {
        let (compromise, _) = self.front.compromise()?;
        self.front.points.iter().position(|point| point == compromise)
    }

    /// Returns the front as comma-separated values: a column for each goal, then one for each parameter. All
    /// numbers have enough digits to be read back exactly.
    ///
    /// # Errors
    /// Returns an error if the text cannot be written.
    pub fn to_csv(&self) -> Result<String, CalibrationError> {
        let failed =
            |e: &dyn fmt::Display| CalibrationError::Setup(format!("the front cannot be written: {e}"));
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(self.goals.iter().chain(&self.fit.names)).map_err(|e| failed(&e))?;
        for point in &self.front.points {
            let values = self.values(point);
            let row = values.iter().chain(&point.x).map(|value| Number(*value).to_string());
            writer.write_record(row).map_err(|e| failed(&e))?;
        }
        let bytes = writer.into_inner().map_err(|e| failed(&e))?;
        String::from_utf8(bytes).map_err(|e| failed(&e))
    }

    /// Draws each further goal over the first one as SVG, one panel per goal. The compromise has another
    /// colour. Returns `None` if there are no finite values to draw.
    #[cfg(feature = "report")]
    pub fn plot(&self) -> Option<String> {
        let values: Vec<Vec<f64>> = self.front.points.iter().map(|point| self.values(point)).collect();
        crate::report::plot_front(&self.goals, &values, self.compromise())
    }
}

impl fmt::Display for DesignFront {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.front.points.len();
        write!(f, "Pareto front with {n} design{}", if n == 1 { "" } else { "s" })?;
        if n > 0 {
            let titles = self.goals.iter().chain(&self.fit.names);
            let titles: Vec<String> = titles.map(|title| visible_line(title).into_owned()).collect();
            let rows: Vec<usize> = match n {
                0..=MOST_ROWS => (0..n).collect(),
                // Evenly spaced, with both ends.
                _ => (0..MOST_ROWS).map(|k| k * (n - 1) / (MOST_ROWS - 1)).collect(),
            };
            let cells = |row: &usize| -> Vec<String> {
                let point = &self.front.points[*row];
                let values = self.values(point);
                values.iter().chain(&point.x).map(|value| format!("{:.6}", Number(*value))).collect()
            };
            let cells: Vec<Vec<String>> = rows.iter().map(cells).collect();
            let width = |k: usize| cells.iter().map(|row| row[k].chars().count()).max().unwrap_or(0);
            let widths: Vec<usize> =
                titles.iter().enumerate().map(|(k, title)| title.chars().count().max(width(k))).collect();
            let line = |f: &mut fmt::Formatter<'_>, row: &mut dyn Iterator<Item = &String>| {
                f.write_str("\n ")?;
                row.zip(&widths).try_for_each(|(cell, width)| write!(f, " {cell:>width$}"))
            };
            line(f, &mut titles.iter())?;
            cells.iter().try_for_each(|row| line(f, &mut row.iter()))?;
            if n > MOST_ROWS {
                write!(f, "\n  {MOST_ROWS} of {n} designs are shown")?;
            }
        }
        if let Some((compromise, _)) = self.front.compromise() {
            let values = self.values(compromise);
            let of = |names: &[String], values: &[f64]| {
                let pairs = names.iter().zip(values);
                pairs
                    .map(|(name, v)| format!("{} = {:.6}", visible_line(name), Number(*v)))
                    .collect::<Vec<_>>()
                    .join(", ")
            };
            let (goals, parameters) = (of(&self.goals, &values), of(&self.fit.names, &compromise.x));
            write!(f, "\n  compromise (nearest to the best value of each goal): {goals} at {parameters}")?;
        }
        let report = &self.fit.report;
        write!(f, "\n  {} evaluations; {}", report.n_evaluations, report.message)?;
        if let Some(resumed) = &report.resumed {
            write!(f, "\n  {resumed}")?;
        }
        for finding in &self.fit.setup_findings {
            write!(f, "\n  {finding}")?;
        }
        Ok(())
    }
}
