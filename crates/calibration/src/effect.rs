//! What a fit leaves open: parameters that ended at a bound, and parameters that did not change the cost.

use crate::calibration::{Calibration, NoCost};
use crate::parameter::{Parameter, Scale};
use dfo::{Kind, Outcome, Report, Termination};
use ode::{Number, Stats};

/// One of the two bounds of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BoundSide {
    /// The smallest value.
    Lower,
    /// The largest value.
    Upper,
}

impl BoundSide {
    /// "lower" or "upper".
    pub fn name(self) -> &'static str {
        match self {
            Self::Lower => "lower",
            Self::Upper => "upper",
        }
    }
}

/// A parameter counts as at its bound if it is nearer than the final simplex or population is wide, but within these shares
/// of the parameter's size: a search that has not narrowed down says nothing about the bound, and one that has collapsed
/// leaves the rounding of its scaling.
const NEAR: (f64, f64) = (1e-9, 1e-3);

/// A parameter is moved by this share of its size to see whether it changes the cost.
const MOVE: f64 = 0.1;

/// A parameter that may be without effect, by number; whether an evaluation of the fit has shown it.
struct Suspect {
    index: usize,
    is_seen: bool,
}

impl Calibration {
    /// Parameters that ended at a bound, by number.
    pub(crate) fn at_bound(&self, report: &Report) -> Vec<(usize, BoundSide)> {
        let vertices =
            report.final_simplex.as_ref().or(report.final_population.as_ref()).map(|s| &s.vertices);
        let side = |(i, p): (usize, &Parameter)| {
            let x = inner(p, report.x[i]);
            let (lower, upper) = (inner(p, p.lower()), inner(p, p.upper()));
            let of = vertices.into_iter().flatten().map(|v| inner(p, v[i]));
            let (low, high) = of.fold((x, x), |(low, high), v| (low.min(v), high.max(v)));
            let size = self.size_of(p, report.x[i]);
            let near = (high - low).clamp(NEAR.0 * size, NEAR.1 * size);
            match () {
                () if p.is_fixed() || lower == upper => None,
                () if x - lower <= near => Some((i, BoundSide::Lower)),
                () if upper - x <= near => Some((i, BoundSide::Upper)),
                () => None,
            }
        };
        self.parameters().iter().enumerate().filter_map(side).collect()
    }

    /// Parameters of which no evaluation shows that they change the cost, as far as two evaluations differ from each other
    /// in one parameter alone: most methods begin with such.
    fn suspects(&self, start: &[f64], report: &Report) -> Vec<Suspect> {
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
                Outcome::Value(other) if self.is_equal_cost(cost, *other) => suspects[place].is_seen = true,
                Outcome::Above(cutoff) if *cutoff < cost => {}
                Outcome::Abort(_) | Outcome::Skipped => {}
                _ => drop(suspects.remove(place)),
            }
        }
        suspects
    }

    /// Whether two costs differ by no more than the integration leaves uncertain.
    fn is_equal_cost(&self, a: f64, b: f64) -> bool {
        (a - b).abs() <= self.pool_of_settings(0).plan().relative_tolerance() * a
    }

    /// Parameters that did not change the cost, by number, and how many simulations were made to see it: one for each
    /// suspect, if nobody ended the run early and all of them fit into its budget.
    pub(crate) fn without_effect(
        &self,
        start: &[f64],
        report: &Report,
        budget: Option<usize>,
        cancelled: &dyn Fn() -> bool,
        stats: &mut Stats,
    ) -> (Vec<usize>, usize) {
        let suspects = self.suspects(start, report);
        let is_in_budget = budget.is_none_or(|most| report.n_evaluations + suspects.len() <= most);
        let seen = suspects.iter().filter(|s| s.is_seen).map(|s| s.index).collect();
        let is_over = matches!(report.termination, Termination::MaxEvaluations | Termination::MaxIterations);
        if !(report.is_success() || is_over) || !is_in_budget {
            return (seen, 0);
        }
        let (mut inert, mut n_checks) = (Vec::new(), 0);
        for Suspect { index, .. } in suspects {
            if cancelled() {
                return (seen, n_checks);
            }
            n_checks += 1;
            let mut x = report.x.clone();
            x[index] = self.moved(&self.parameters()[index], x[index]);
            match self.evaluate_into(&x, (f64::INFINITY, cancelled), None, stats) {
                Ok(cost) if self.is_equal_cost(report.fun, cost) => inert.push(index),
                Err(NoCost::Cancelled) => return (seen, n_checks),
                _ => {}
            }
        }
        (inert, n_checks)
    }

    /// What is to be said about them behind the message of a fit.
    pub(crate) fn remarks(&self, at_bound: &[(usize, BoundSide)], without_effect: &[usize]) -> String {
        let name = |i: &usize| self.parameters()[*i].name();
        let bound = |(i, side): &(usize, BoundSide)| {
            let p = &self.parameters()[*i];
            let value = if *side == BoundSide::Lower { p.lower() } else { p.upper() };
            format!("; {} is at its {} bound {}", name(i), side.name(), Number(value))
        };
        let inert = |i: &usize| format!("; {} did not change the cost", name(i));
        at_bound.iter().map(bound).chain(without_effect.iter().map(inert)).collect()
    }

    /// A value of a parameter some way from `x`, towards the bound that is farther.
    fn moved(&self, parameter: &Parameter, x: f64) -> f64 {
        let (lower, upper) = (inner(parameter, parameter.lower()), inner(parameter, parameter.upper()));
        let from = inner(parameter, x);
        let mut by = MOVE * self.size_of(parameter, x);
        if parameter.value_kind() != Kind::Continuous {
            by = by.round().max(1.0);
        }
        let to = if upper - from >= from - lower { (from + by).min(upper) } else { (from - by).max(lower) };
        match parameter.scale_kind() {
            Scale::Linear => to,
            Scale::Log => to.exp().clamp(parameter.lower(), parameter.upper()),
        }
    }
}

/// A value as the optimiser sees it.
fn inner(parameter: &Parameter, value: f64) -> f64 {
    match parameter.scale_kind() {
        Scale::Linear => value,
        Scale::Log => value.max(0.0).ln(),
    }
}
