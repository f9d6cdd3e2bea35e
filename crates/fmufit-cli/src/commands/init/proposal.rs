//! Proposal of parameters for a fit.

use crate::error::Error;
use calibration::Preflight;
use fmi::description::{Causality, Variability};
use fmi::{Fmu, Value, Variable};

/// Factor between the start value and a bound that the model does not declare.
const WIDTH: f64 = 10.0;

/// Maximum number of parameters to vary and to propose for a fit.
const MOST: usize = 50;

/// A candidate parameter.
pub(super) struct Candidate {
    pub(super) name: String,
    pub(super) start: f64,
    pub(super) lower: f64,
    pub(super) upper: f64,
    pub(super) unit: Option<String>,
    pub(super) description: Option<String>,
    /// Reason why the parameter should not be fitted.
    pub(super) reason: Option<String>,
}

/// Proposed parameters.
pub(super) struct Proposed {
    pub(super) candidates: Vec<Candidate>,
    /// Remarks on groups of parameters with similar effects on the outputs.
    pub(super) confounded: Vec<String>,
}

impl Proposed {
    /// Returns the parameters with these names, or all parameters if no names are given.
    pub(super) fn of(fmu: &Fmu, names: &[String]) -> Result<Self, Error> {
        let description = fmu.description();
        let mut candidates = Vec::new();
        for name in names {
            let variable = description.variable(name).ok_or_else(|| {
                let nearest = description.nearest_names(name, 3).into_iter().map(str::to_owned).collect();
                Error::input(calibration::visible_error(&fmi::FmiError::UnknownVariable {
                    name: name.clone(),
                    nearest,
                }))
            })?;
            candidates.push(candidate(variable).ok_or_else(|| {
                Error::input(format!(
                    "--parameter {name}: expected a scalar real variable with a start value"
                ))
            })?);
        }
        if names.is_empty() {
            let is_parameter = |variable: &&Variable| {
                variable.causality == Causality::Parameter
                    && matches!(variable.variability, Variability::Fixed | Variability::Tunable)
            };
            candidates = description.variables.iter().filter(is_parameter).filter_map(candidate).collect();
            let beyond = candidates.iter_mut().filter(|candidate| candidate.reason.is_none()).skip(MOST);
            beyond.for_each(|candidate| {
                candidate.reason = Some(format!("not tested because there are more than {MOST} parameters"))
            });
        }
        Ok(Self { candidates, confounded: Vec::new() })
    }

    /// Returns the parameters to fit.
    pub(super) fn active(&self) -> impl Iterator<Item = &Candidate> {
        self.candidates.iter().filter(|candidate| candidate.reason.is_none())
    }

    pub(super) fn n_active(&self) -> usize {
        self.active().count()
    }

    pub(super) fn has_active(&self) -> bool {
        self.n_active() > 0
    }

    /// Excludes parameters that do not affect any output or whose variation makes the simulation fail.
    pub(super) fn judge(&mut self, preflight: &Preflight) {
        for tried in &preflight.parameters {
            let candidate = self.candidates.iter_mut().find(|candidate| candidate.name == tried.name);
            let Some(candidate) = candidate else { continue };
            candidate.reason = match &tried.failure {
                Some(failure) => Some(format!("a small change makes the simulation fail: {failure}")),
                None if !tried.has_effect => Some("no effect on any output at the start values".to_owned()),
                None => None,
            };
        }
        let name = |k: &usize| preflight.parameters[*k].name.as_str();
        let remark = |(group, correlation): (Vec<usize>, f64)| {
            let names: Vec<&str> = group.iter().map(name).collect();
            let correlation = format!("correlation {correlation:.2}");
            match &names[..] {
                [one, other] => {
                    format!(
                        "{one} and {other} have the same effect on the outputs ({correlation}); keep only \
                         one of them"
                    )
                }
                all => format!(
                    "{} have similar effects on the outputs ({correlation} or more); keep only one of them",
                    all.join(", ")
                ),
            }
        };
        self.confounded = groups(&preflight.confounded).into_iter().map(remark).collect();
    }
}

/// Merges connected pairs of parameters into groups. Each group has the smallest absolute correlation of its
/// pairs.
fn groups(pairs: &[(usize, usize, f64)]) -> Vec<(Vec<usize>, f64)> {
    let mut groups: Vec<(Vec<usize>, f64)> = Vec::new();
    for (one, other, correlation) in pairs {
        let (connected, others): (Vec<_>, Vec<_>) =
            groups.into_iter().partition(|(group, _)| group.contains(one) || group.contains(other));
        let mut joined: Vec<usize> = connected.iter().flat_map(|(group, _)| group).copied().collect();
        joined.extend([*one, *other]);
        joined.sort_unstable();
        joined.dedup();
        let least = connected.iter().map(|(_, least)| *least).fold(correlation.abs(), f64::min);
        groups = others;
        groups.push((joined, least));
    }
    groups
}

/// Converts a variable to a parameter of a fit. `None` if it is not a single real number with a start value.
fn candidate(variable: &Variable) -> Option<Candidate> {
    let Some(Value::Real(start)) = variable.start else { return None };
    if !variable.kind.is_float() || !variable.dimensions.is_empty() || !start.is_finite() {
        return None;
    }
    let size = match variable.nominal.map_or(0.0, f64::abs) {
        nominal if nominal.is_finite() && nominal > 0.0 => nominal,
        _ => 1.0,
    };
    let (lower, upper) = match start {
        0.0 => (-WIDTH * size, WIDTH * size),
        start if start > 0.0 => (start / WIDTH, start * WIDTH),
        start => (start * WIDTH, start / WIDTH),
    };
    // Rounds to the digits of the start value.
    let rounded = |bound: f64| format!("{bound:.5e}").parse().unwrap_or(bound);
    let within =
        |bound: f64| rounded(bound).clamp(variable.min.unwrap_or(f64::MIN), variable.max.unwrap_or(f64::MAX));
    Some(Candidate {
        name: variable.name.clone(),
        start,
        lower: within(lower).min(start),
        upper: within(upper).max(start),
        unit: variable.unit.clone(),
        description: variable.description.clone(),
        reason: None,
    })
}
