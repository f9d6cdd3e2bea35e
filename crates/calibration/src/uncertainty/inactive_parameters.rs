//! Parameters that a search could not move: they ended at a bound or did not change the cost.

use crate::cost::failure::CostFailure;
use crate::cost::residual::CostRule;
use crate::loaded::budget::{Budget, Extra};
use crate::loaded::calibration::Calibration;
use crate::problem::objective::CostKind;
use crate::problem::parameter::{Parameter, inner, outer};
use base::RunContext;
use dfo::{FailureKind, Outcome, ParameterKind, Report, Termination, ToleranceMeasure, Tolerances};
use ode::Stats;
use serde::{Deserialize, Serialize};

/// One of the two bounds of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum BoundSide {
    /// The smallest value.
    Lower,
    /// The largest value.
    Upper,
}

impl BoundSide {
    /// Returns "lower" or "upper".
    pub fn name(self) -> &'static str {
        match self {
            Self::Lower => "lower",
            Self::Upper => "upper",
        }
    }

    fn of(self, parameter: &Parameter) -> f64 {
        match self {
            Self::Lower => parameter.lower(),
            Self::Upper => parameter.upper(),
        }
    }
}

/// Parameters of a fit that ended at a bound or did not change the cost.
#[derive(Debug, Clone, Default)]
pub(crate) struct InactiveParameters {
    /// Indices of parameters that ended at a bound, with the bound.
    pub(crate) at_bound: Vec<(usize, BoundSide)>,
    /// Indices of parameters that did not change the cost.
    pub(crate) without_effect: Vec<usize>,
    /// Number of simulations for these checks.
    pub(crate) n_checks: usize,
    /// Checks that the budget did not allow.
    pub(crate) skipped: Vec<Extra>,
}

/// Distance to a bound, relative to the size, below which a parameter is at the bound. The scaling of the
/// optimiser rounds.
pub(crate) const AT: f64 = 1e-9;

/// Distance to a bound, relative to the size, above which a parameter is not at the bound, however wide the
/// search still is.
const NEAR: f64 = 1e-3;

/// Step, relative to the size, that tests whether a parameter changes the cost.
const MOVE: f64 = 0.1;

/// A parameter that may be at its bound.
struct Candidate {
    index: usize,
    side: BoundSide,
    /// True if the distance to the bound is within the width of the final simplex or population.
    is_likely: bool,
    is_sure: bool,
}

/// A parameter that may have no effect. `is_seen` is true if an evaluation of the fit has shown this.
struct Suspect {
    index: usize,
    is_seen: bool,
}

/// A finished run and its settings.
pub(crate) struct EndedRun<'a> {
    pub(crate) start: &'a [f64],
    /// Indices of parameters held fixed at the start.
    pub(crate) held: &'a [usize],
    pub(crate) report: &'a Report,
    pub(crate) kind: &'a CostKind,
    pub(crate) tolerances: &'a Tolerances,
    /// True if standard errors are estimated as well. Their simulations show which parameters have an effect.
    pub(crate) has_errors: bool,
}

impl Calibration {
    /// Finds parameters at their bounds and parameters without effect. Cases that the evaluations of the run
    /// do not decide are simulated within the budget, unless time or an interrupt ended the run:
    ///
    /// - One simulation at the bound for each parameter that ended within the tolerance of the run.
    /// - One simulation with the parameter moved, if an evaluation has shown that the parameter does not
    ///   change the cost.
    /// - Without standard errors, also one for each parameter that no evaluation has shown to change the
    ///   cost.
    ///
    /// The evaluation limits of the search do not include these simulations.
    pub(crate) fn inactive_parameters(
        &self,
        run: &EndedRun<'_>,
        budget: &mut Budget,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> InactiveParameters {
        let EndedRun { start, held, report, kind, tolerances, has_errors } = *run;
        let mut candidates = self.near_bound(report, tolerances);
        candidates.retain(|c| !held.contains(&c.index));
        let mut suspects = self.suspects(start, report, kind);
        suspects.retain(|s| !held.contains(&s.index) && (s.is_seen || !has_errors));
        let found = InactiveParameters {
            at_bound: candidates.iter().filter(|c| c.is_likely).map(|c| (c.index, c.side)).collect(),
            without_effect: suspects.iter().filter(|s| s.is_seen).map(|s| s.index).collect(),
            ..InactiveParameters::default()
        };
        if !report.termination.cause().allows_evaluations() {
            return found;
        }
        let (mut at_bound, mut without_effect) = (Vec::new(), Vec::new());
        let mut n_checks = 0;
        let mut values = Vec::new();
        let mut is_allowed = || budget.allows(Extra::StuckParameter, 1.0);
        let mut cost_with = |index: usize, value: f64| {
            n_checks += 1;
            let mut x = report.x.clone();
            x[index] = value;
            let rule = CostRule::whole(report.loss, context);
            values.resize(self.n_values(), 0.0);
            let sum = self.evaluate_into(&x, rule, &mut values, stats)?;
            let criteria = self.take_criteria(&mut values);
            let outcome = self.outcome_of(kind, &x, sum, (&values, &criteria), &mut Vec::new());
            outcome
                .value()
                .ok_or_else(|| CostFailure::failed(FailureKind::Error, "the cost is not a number".to_owned()))
        };
        // The evaluation limit of the search does not apply here, but no simulation is spent on
        // what an evaluation has already shown.
        let is_spent = *report.termination.ended() == Termination::MaxEvaluations;
        for Candidate { index, side, is_likely, is_sure } in candidates {
            let is_at = if is_sure || is_spent && is_likely {
                true
            } else if !is_allowed() {
                is_likely
            } else {
                let parameter = &self.parameters()[index];
                match cost_with(index, side.of(parameter)) {
                    Ok(cost) => cost <= report.fun || self.is_equal_cost(kind, report.fun, cost),
                    Err(CostFailure::Cancelled) => break,
                    Err(_) => false,
                }
            };
            if is_at {
                at_bound.push((index, side));
            }
        }
        for Suspect { index, is_seen } in suspects {
            // Evaluations from another start may be far from the result.
            if is_seen && is_spent && report.optima.len() < 2 {
                without_effect.push(index);
                continue;
            }
            if !is_allowed() {
                without_effect.extend(is_seen.then_some(index));
                continue;
            }
            match cost_with(index, self.moved(&self.parameters()[index], report.x[index])) {
                Ok(cost) if self.is_equal_cost(kind, report.fun, cost) => without_effect.push(index),
                Err(CostFailure::Cancelled) => break,
                _ => {}
            }
        }
        if context.is_over() {
            return InactiveParameters { n_checks, ..found };
        }
        let skipped = budget.skipped().to_vec();
        InactiveParameters { at_bound, without_effect, n_checks, skipped }
    }

    /// Returns the parameters that ended near a bound.
    fn near_bound(&self, report: &Report, tolerances: &Tolerances) -> Vec<Candidate> {
        let vertices =
            report.final_simplex.as_ref().or(report.final_population.as_ref()).map(|s| &s.vertices);
        let candidate = |(index, p): (usize, &Parameter)| {
            let x = inner(p, report.x[index]);
            let (lower, upper) = (inner(p, p.lower()), inner(p, p.upper()));
            if p.is_fixed() || p.is_periodic() || lower == upper {
                return None;
            }
            let (side, distance) = match x - lower <= upper - x {
                true => (BoundSide::Lower, x - lower),
                false => (BoundSide::Upper, upper - x),
            };
            let of = vertices.into_iter().flatten().map(|v| inner(p, v[index]));
            let (low, high) = of.fold((x, x), |(low, high), v| (low.min(v), high.max(v)));
            let size = self.size_of(p, report.x[index]);
            let resolved = match tolerances.measure {
                ToleranceMeasure::Relative => tolerances.x_tol * size,
                ToleranceMeasure::Absolute => tolerances.x_tol,
            };
            let is_sure = distance <= AT * size;
            let is_likely = is_sure || distance <= (high - low).min(NEAR * size);
            let is_near = is_likely || distance <= resolved.min(NEAR * size);
            is_near.then_some(Candidate { index, side, is_likely, is_sure })
        };
        self.parameters().iter().enumerate().filter_map(candidate).collect()
    }

    /// Returns the parameters that no evaluation has shown to change the cost. The evidence is pairs of
    /// evaluations that differ in one parameter only; most methods start with such pairs.
    fn suspects(&self, start: &[f64], report: &Report, kind: &CostKind) -> Vec<Suspect> {
        let free = |(i, p): (usize, &Parameter)| (p.lower() < p.upper() && !p.is_fixed()).then_some(i);
        let mut suspects: Vec<Suspect> = (self.parameters().iter().enumerate().filter_map(free))
            .map(|index| Suspect { index, is_seen: false })
            .collect();
        let at_start = report.trace.iter().find(|e| e.x == start);
        let Some(cost) = at_start.and_then(|e| e.outcome.value()) else { return suspects };
        for entry in report.trace.iter() {
            let mut moved = (0..start.len()).filter(|&i| entry.x[i] != start[i]);
            let (Some(index), None) = (moved.next(), moved.next()) else { continue };
            let Some(place) = suspects.iter().position(|s| s.index == index) else { continue };
            match entry.outcome {
                Outcome::Value(other) if self.is_equal_cost(kind, cost, *other) => {
                    suspects[place].is_seen = true;
                }
                Outcome::Above(cutoff) if *cutoff < cost => {}
                Outcome::Abort(_) | Outcome::Skipped => {}
                _ => drop(suspects.remove(place)),
            }
        }
        suspects
    }

    /// True if two costs differ by no more than the integration error.
    fn is_equal_cost(&self, kind: &CostKind, a: f64, b: f64) -> bool {
        let tolerance = self.relative_tolerance();
        (a - b).abs() <= tolerance * kind.size(a, self.n_measurements())
    }

    /// Returns a value of a parameter at a fraction of its size from `x`, towards the farther bound.
    fn moved(&self, parameter: &Parameter, x: f64) -> f64 {
        let (lower, upper) = (inner(parameter, parameter.lower()), inner(parameter, parameter.upper()));
        let from = inner(parameter, x);
        let mut by = MOVE * self.size_of(parameter, x);
        if parameter.value_kind() != ParameterKind::Continuous {
            by = by.round().max(1.0);
        }
        let to = if upper - from >= from - lower { (from + by).min(upper) } else { (from - by).max(lower) };
        outer(parameter, to)
    }
}
