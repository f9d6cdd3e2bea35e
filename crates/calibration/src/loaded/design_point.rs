//! Goals, criteria and constraints of a design at a point.

use crate::cost::loaded_problem::LoadedProblem;
use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use base::RunContext;
use ode::Stats;
use serde::{Deserialize, Serialize};

/// Value of a criterion in a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CriterionValue {
    /// The criterion as written.
    pub text: String,
    /// Name of the scenario.
    pub scenario: String,
    /// Value.
    pub value: f64,
}

/// Value of a constraint and its limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LimitedValue {
    /// The constraint as written, with its scenario if there are several.
    pub text: String,
    /// Value of the compared formula.
    pub value: f64,
    /// Smallest allowed value, or `-inf`.
    pub lower: f64,
    /// Largest allowed value, or `inf`.
    pub upper: f64,
}

impl LimitedValue {
    /// Returns the distance beyond the nearest limit; 0 within the limits.
    pub fn violation(&self) -> f64 {
        (self.lower - self.value).max(self.value - self.upper).max(0.0)
    }
}

/// Goals, criteria and constraints at a point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DesignPoint {
    /// Values of the parameters.
    pub x: Vec<f64>,
    /// Values of the goals, combined over the scenarios.
    pub goals: Vec<f64>,
    /// Values of the criteria, scenario by scenario.
    pub criteria: Vec<CriterionValue>,
    /// Values of the nonlinear constraints.
    pub constraints: Vec<LimitedValue>,
}

impl DesignPoint {
    /// Computes the values from the criteria of all scenarios.
    fn new(evaluator: &LoadedProblem, x: &[f64], criteria: &[f64]) -> Self {
        let goals = &evaluator.goals;
        let of_goals = (0..goals.len()).map(|k| goals.value(k, x, criteria));
        let named = evaluator.simulations.iter().flat_map(|simulation| {
            simulation.criteria.texts().iter().map(|text| (text.clone(), simulation.name.clone()))
        });
        let criterion = |((text, scenario), value): ((String, String), &f64)| CriterionValue {
            text,
            scenario,
            value: *value,
        };
        let constraints = &evaluator.constraints;
        let mut values = Vec::new();
        constraints.nonlinear(x, criteria, &mut values);
        let limits = constraints.nonlinear_limits();
        let texts = constraints.texts();
        let texts = &texts[texts.len() - limits.len()..];
        let limited = |((text, value), (lower, upper)): ((&&str, f64), (f64, f64))| LimitedValue {
            text: (*text).to_owned(),
            value,
            lower,
            upper,
        };
        Self {
            x: x.to_vec(),
            goals: of_goals.collect(),
            criteria: named.zip(criteria).map(criterion).collect(),
            constraints: texts.iter().zip(values).zip(limits).map(limited).collect(),
        }
    }
}

impl Calibration {
    /// Simulates all experiments at `x` and returns the goals, criteria and constraints.
    ///
    /// # Errors
    /// Returns the errors of [`cost`](Self::cost).
    pub fn design_point(&self, x: &[f64], context: &RunContext<'_>) -> Result<DesignPoint, CalibrationError> {
        let (_, mut values) = self.evaluate_values(x, context, &mut Stats::default())?;
        let criteria = self.take_criteria(&mut values);
        Ok(DesignPoint::new(self.evaluator(), x, &criteria))
    }
}
