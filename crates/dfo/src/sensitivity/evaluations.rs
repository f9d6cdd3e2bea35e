//! Values at the points of a design.

use crate::error::Error;
use crate::outcome::answer::Outcome;
use crate::outcome::termination::Termination;
use crate::outcome::trace::TraceEntry;
use crate::run::report::Report;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Values at the points of a [`SensitivityDesign`](crate::SensitivityDesign).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Evaluations {
    /// Values at each point, in the order of the design. Empty if the point failed or was not evaluated. A
    /// value that is not finite is missing.
    pub values: Vec<Vec<f64>>,
    /// Number of evaluations. Repeated points of discrete parameters are evaluated once.
    pub n_evaluations: usize,
    /// Number of points with missing values.
    pub n_failed: usize,
    /// Number of points that were not evaluated, because the run ended before.
    pub n_missing: usize,
    /// Reasons of missing values with the number of points, most frequent first.
    pub failures: Vec<(String, usize)>,
    /// Reason why the run ended; [`Termination::Converged`] if it evaluated all points.
    pub termination: Termination,
}

impl Evaluations {
    /// Reads the values at the points from the result of a run.
    pub(super) fn of<'p>(
        run: Result<Report, Error>,
        points: impl ExactSizeIterator<Item = &'p [f64]>,
    ) -> Result<Self, Error> {
        let (trace, n_evaluations, termination) = match run {
            Ok(report) => {
                let n_evaluations = report.n_evaluations + report.n_speculative;
                (report.trace, n_evaluations, report.termination)
            }
            Err(Error::EndedWithoutPoint { termination, found }) => {
                (found.trace, found.n_evaluations, termination)
            }
            Err(error) => return Err(error),
        };
        let is_evaluated = |entry: &TraceEntry<'_>| match entry.outcome {
            Outcome::Failed(failure) => failure.kind.is_of_point(),
            outcome => outcome.is_conclusive(),
        };
        let entries = trace.iter().chain(trace.speculative()).filter(is_evaluated);
        let known: HashMap<Vec<u64>, TraceEntry<'_>> = entries.map(|entry| (bits(entry.x), entry)).collect();
        let mut found = Self {
            values: Vec::with_capacity(points.len()),
            n_evaluations,
            n_failed: 0,
            n_missing: 0,
            failures: Vec::new(),
            termination,
        };
        for x in points {
            let entry = known.get(&bits(x));
            found.n_missing += usize::from(entry.is_none());
            if let Some(reason) = entry.and_then(reason) {
                found.n_failed += 1;
                match found.failures.iter_mut().find(|(listed, _)| *listed == reason) {
                    Some((_, count)) => *count += 1,
                    None => found.failures.push((reason, 1)),
                }
            }
            found.values.push(entry.map(|entry| entry.residuals.to_vec()).unwrap_or_default());
        }
        found.failures.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        Ok(found)
    }
}

/// Returns the reason why a point has no values or misses one.
fn reason(entry: &TraceEntry<'_>) -> Option<String> {
    let missing = entry.residuals.iter().enumerate().find(|(_, value)| !value.is_finite());
    match (missing, entry.outcome) {
        (Some((k, value)), _) => Some(format!("value {k} is {value}")),
        (None, Outcome::Failed(failure)) if entry.residuals.is_empty() => Some(failure.message.clone()),
        _ => None,
    }
}

fn bits(x: &[f64]) -> Vec<u64> {
    x.iter().map(|value| value.to_bits()).collect()
}
