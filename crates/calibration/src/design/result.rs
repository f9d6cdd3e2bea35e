//! Results of a design optimisation.

use crate::error::CalibrationError;
use crate::findings::finding::Finding;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::loaded::design_point::DesignPoint;
use base::Number;
use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};
use std::fmt;

/// Result of [`Design::optimize`](crate::Design::optimize).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct DesignResult {
    /// Names of the parameters.
    pub names: Vec<String>,
    /// Units of the parameters, if the model states them.
    pub units: Vec<Option<String>>,
    /// Best values of the parameters.
    pub x: Vec<f64>,
    /// Value of the first goal at the best point.
    pub value: f64,
    /// The goals as written.
    pub goals: Vec<String>,
    /// Values at the best point; `None` after an interrupt.
    pub point: Option<DesignPoint>,
    /// Values at the start; `None` if the simulation failed there or after an interrupt.
    pub start: Option<DesignPoint>,
    /// Findings about the search and the model.
    pub findings: Vec<Finding>,
    /// Search, simulations and bounds. Its fields about residuals are empty.
    pub fit: Fit,
}

impl DesignResult {
    pub(super) fn new(
        calibration: &Calibration,
        fit: Fit,
        point: Option<DesignPoint>,
        start: Option<DesignPoint>,
    ) -> Self {
        Self {
            names: fit.names.clone(),
            units: fit.units.clone(),
            x: fit.x.clone(),
            value: calibration.evaluator().goals.value_of_cost(0, fit.cost),
            goals: calibration.problem().goals.iter().map(|goal| goal.text().to_owned()).collect(),
            point,
            start,
            findings: fit.setup_findings.clone(),
            fit,
        }
    }

    /// Returns the result as JSON: parameters, objectives, criteria, constraints and the end of the search.
    /// Numbers that are not finite are null.
    ///
    /// # Errors
    /// Returns an error if the result cannot be serialised.
    pub fn to_json(&self) -> Result<String, CalibrationError> {
        let parameters = self.names.iter().zip(&self.units).zip(&self.x).zip(&self.fit.start);
        let parameters = parameters.map(|(((name, unit), value), start)| {
            json!({ "name": name, "unit": unit, "value": value, "start": start })
        });
        let report = &self.fit.report;
        let findings: Vec<String> = self.findings.iter().map(ToString::to_string).collect();
        let document = json!({
            "objectives": self.goals,
            "value": self.value,
            "parameters": parameters.collect::<Vec<Json>>(),
            "result": self.point,
            "start": self.start,
            "success": self.is_success(),
            "message": report.message,
            "method": report.method,
            "n_evaluations": report.n_evaluations,
            "n_failed": report.n_failed,
            "constraint_violation": report.constr_violation,
            "seed": report.seed,
            "findings": findings,
        });
        serde_json::to_string_pretty(&document)
            .map_err(|e| CalibrationError::Setup(format!("the result cannot be written as JSON: {e}")))
    }

    /// True if the search succeeded and the constraints hold within their tolerance.
    pub fn is_success(&self) -> bool {
        self.fit.is_success()
    }
}

impl fmt::Display for DesignResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let goal = self.goals.first().map_or("", String::as_str);
        let word = if self.is_success() { "optimised" } else { "not converged" };
        write!(f, "{goal} = {:.6} ({word})", Number(self.value))?;
        if let Some(before) = self.start.as_ref().and_then(|start| start.goals.first()) {
            write!(f, ", at the start {:.6}", Number(*before))?;
        }
        let width = self.names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        for ((name, unit), value) in self.names.iter().zip(&self.units).zip(&self.x) {
            let unit = unit.as_ref().map_or_else(String::new, |unit| format!(" {unit}"));
            write!(f, "\n  {name:width$} = {:.6}{unit}", Number(*value))?;
        }
        let several = self.point.iter().flat_map(|point| &point.criteria).any(|c| c.scenario != "run1");
        for criterion in self.point.iter().flat_map(|point| &point.criteria) {
            let scenario = if several { format!(" [{}]", criterion.scenario) } else { String::new() };
            write!(f, "\n  {}{scenario}: {:.6}", criterion.text, Number(criterion.value))?;
        }
        for limited in self.point.iter().flat_map(|point| &point.constraints) {
            let violation = limited.violation();
            let state = if violation > 0.0 {
                format!("violated by {:.6}", Number(violation))
            } else {
                "holds".to_owned()
            };
            write!(f, "\n  constraint {}: {state}", limited.text)?;
        }
        let report = &self.fit.report;
        write!(f, "\n  {} evaluations; {}", report.n_evaluations, report.message)?;
        if let Some(resumed) = &report.resumed {
            write!(f, "\n  {resumed}")?;
        }
        for finding in &self.findings {
            write!(f, "\n  {finding}")?;
        }
        Ok(())
    }
}
