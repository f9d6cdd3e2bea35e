//! Goals resolved to functions of the parameters and of the criteria of simulations.

use crate::error::CalibrationError;
use crate::expression::{Criterion, Expression, ExpressionError, nearest};
use crate::problem::definition::{Element, Problem};
use crate::problem::derived::{Argument, Derivation, entry, inputs};
use crate::problem::goal::{Combination, Goal};

impl Problem {
    /// Returns the criteria of all goals and constraints, without duplicates. A simulation computes their
    /// values in this order.
    pub(crate) fn criteria(&self) -> Vec<Criterion> {
        let mut all: Vec<Criterion> = Vec::new();
        let of_constraints = self.constraints.iter().flat_map(|constraint| constraint.criteria());
        for criterion in self.goals.iter().flat_map(Goal::criteria).chain(of_constraints) {
            if all.iter().all(|listed| listed.text() != criterion.text()) {
                all.push(criterion.clone());
            }
        }
        all
    }
}

/// Goals resolved to functions of `x` and of the criteria.
#[derive(Debug, Default)]
pub(crate) struct Goals {
    goals: Vec<ResolvedGoal>,
    derivations: Vec<Derivation>,
    /// Weights of the scenarios.
    weights: Vec<f64>,
    combination: Combination,
    /// Number of criteria of each scenario.
    n_criteria: usize,
}

#[derive(Debug)]
struct ResolvedGoal {
    expression: Expression,
    is_maximum: bool,
    /// Arguments in each scenario.
    arguments: Vec<Vec<Argument>>,
}

impl Goals {
    /// Resolves the names of the goals.
    ///
    /// # Errors
    /// Returns an error for an unknown parameter, with its column and the nearest name.
    pub(crate) fn new(problem: &Problem, elements: &[Element]) -> Result<Self, CalibrationError> {
        if problem.goals.is_empty() {
            return Ok(Self::default());
        }
        if let (Some(goal), None) =
            (problem.goals.first(), problem.goals.iter().flat_map(Goal::criteria).next())
        {
            return Err(CalibrationError::Setup(format!(
                "objective '{goal}': it contains no criterion of the simulation, such as max(y) or ise(y, 1)"
            )));
        }
        let texts: Vec<String> = problem.criteria().iter().map(Criterion::text).collect();
        let n = problem.experiments.len();
        let derivations: Vec<Derivation> =
            (0..n).map(|k| Derivation::new(problem, k, elements)).collect::<Result<_, _>>()?;
        let mut goals = Vec::with_capacity(problem.goals.len());
        for goal in &problem.goals {
            let bad =
                |error: ExpressionError| CalibrationError::Setup(format!("objective '{goal}': {error}"));
            let names: Vec<&str> = problem.parameters.iter().map(|p| p.name()).collect();
            goal.expression().check_constants(|name| names.contains(&name)).map_err(bad)?;
            let argument = |name: &String, k: usize| -> Result<Argument, CalibrationError> {
                if let Some(c) = texts.iter().position(|text| text == name) {
                    return Ok((derivations[k].len() + c, None));
                }
                let Some(i) = names.iter().position(|listed| listed == name) else {
                    let near = nearest(name, names.iter().copied());
                    let near = near.map_or_else(String::new, |near| format!(" ('{near}'?)"));
                    let message = format!(
                        "'{name}'{near} is not a parameter; available: {}. A variable of the model needs a criterion, such as final({name})",
                        names.join(", ")
                    );
                    return Err(bad(goal.error_at_name(name, message)));
                };
                let at = derivations[k].entry_of(i).or_else(|| entry(elements, i, k)).ok_or_else(|| {
                    let message = format!("'{name}' does not act in {}", problem.experiment_names()[k]);
                    bad(goal.error_at_name(name, message))
                })?;
                Ok((at, problem.parameters[i].cycle()))
            };
            let arguments = (0..n)
                .map(|k| goal.expression().names().iter().map(|name| argument(name, k)).collect())
                .collect::<Result<Vec<Vec<Argument>>, _>>()?;
            goals.push(ResolvedGoal {
                expression: goal.expression().clone(),
                is_maximum: goal.is_maximum(),
                arguments,
            });
        }
        let weights = problem.experiments.iter().map(|experiment| experiment.weight.unwrap_or(1.0)).collect();
        Ok(Self { goals, derivations, weights, combination: problem.combination, n_criteria: texts.len() })
    }

    /// Returns the number of goals.
    pub(crate) fn len(&self) -> usize {
        self.goals.len()
    }

    /// Returns the value to minimise of goal `k`: the combined value, with the opposite sign for a goal to
    /// maximise. `criteria` contains the criteria of all scenarios.
    pub(crate) fn cost(&self, k: usize, x: &[f64], criteria: &[f64]) -> f64 {
        let Some(goal) = self.goals.get(k) else { return f64::NAN };
        let sign = if goal.is_maximum { -1.0 } else { 1.0 };
        let of = |(scenario, arguments): (usize, &Vec<Argument>)| {
            let values = with_criteria(&self.derivations[scenario], x, criteria, scenario, self.n_criteria);
            sign * self.weights[scenario] * goal.expression.value(&inputs(arguments, &values))
        };
        self.combination.of(goal.arguments.iter().enumerate().map(of))
    }

    /// Returns the combined value of goal `k`.
    pub(crate) fn value(&self, k: usize, x: &[f64], criteria: &[f64]) -> f64 {
        self.value_of_cost(k, self.cost(k, x, criteria))
    }

    /// Returns the value of goal `k` that belongs to a [cost](Self::cost).
    pub(crate) fn value_of_cost(&self, k: usize, cost: f64) -> f64 {
        if self.goals.get(k).is_some_and(|goal| goal.is_maximum) { -cost } else { cost }
    }
}

/// Returns the extended values of `x` in an experiment, followed by its criteria.
pub(crate) fn with_criteria(
    derivation: &Derivation,
    x: &[f64],
    criteria: &[f64],
    experiment: usize,
    n_criteria: usize,
) -> Vec<f64> {
    let mut values = derivation.extended(x).into_owned();
    values.extend(criteria.iter().skip(experiment * n_criteria).take(n_criteria));
    values
}
