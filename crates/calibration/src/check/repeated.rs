//! Measurements that are there more than once: a recording given twice, a column for two outputs.

use super::subject::Subject;
use crate::cost::calibration::Calibration;
use crate::findings::finding::{Finding, Severity};
use crate::problem::residual_layout::OutputResiduals;

/// Fewer equal measurements at equal times may be chance.
const FEWEST_AT_EQUAL_TIMES: usize = 3;
/// Fewer equal measurements at other times may be chance.
const FEWEST_IN_A_ROW: usize = 10;

/// Number of measurements that two recordings share: the first of the second are the last of the first, or a
/// part of them. 0 where the first ones are all the same.
fn shared(a: &[f64], b: &[f64]) -> usize {
    if b.len() < FEWEST_IN_A_ROW || b[..FEWEST_IN_A_ROW].iter().all(|m| *m == b[0]) {
        return 0;
    }
    let common = |k: usize| a[k..].len().min(b.len());
    let starts = 0..(a.len() + 1).saturating_sub(FEWEST_IN_A_ROW);
    starts.into_iter().find(|k| a[*k..*k + common(*k)] == b[..common(*k)]).map_or(0, common)
}

/// Outputs of several experiments with the same measurements, or of one with the same times and the same
/// measurements. Windows that do not overlap are others.
pub(super) fn findings(calibration: &Calibration, subjects: &[Subject<'_>]) -> Vec<Finding> {
    let outputs = &calibration.residual_layout().outputs;
    let is_same = |a: &OutputResiduals, b: &OutputResiduals| a.times == b.times && a.measured == b.measured;
    let n_shared = |a: &OutputResiduals, b: &OutputResiduals| match is_same(a, b) {
        true => b.measured.len(),
        false if a.experiment == b.experiment => 0,
        false => shared(&a.measured, &b.measured).max(shared(&b.measured, &a.measured)),
    };
    let varies = |a: &OutputResiduals| a.measured.iter().any(|m| *m != a.measured[0]);
    let mut findings: Vec<Finding> = Vec::new();
    let names = calibration.problem().experiment_names();
    for (k, b) in outputs.iter().enumerate() {
        if b.measured.len() < FEWEST_AT_EQUAL_TIMES || !varies(b) {
            continue;
        }
        let is_twice = |a: &&OutputResiduals| {
            (a.experiment == b.experiment) == (a.variable != b.variable) && n_shared(a, b) > 0
        };
        let Some(a) = outputs[..k].iter().find(is_twice) else { continue };
        let n = n_shared(a, b);
        let (subject, sentence, remedy) = match a.experiment == b.experiment {
            true => (
                format!("{}outputs '{}' and '{}'", subjects[b.experiment].prefix, a.variable, b.variable),
                format!("both have the same {n} measurements (columns '{}' and '{}')", a.column, b.column),
                "give each output its own column",
            ),
            false => (
                format!("experiments {} and {}", names[a.experiment], names[b.experiment]),
                format!(
                    "output '{}' has the same {n} measurements{} in both: they count twice, and standard errors are too small",
                    b.variable,
                    if is_same(a, b) { " at the same times" } else { "" }
                ),
                "leave one of them out, or name the right file",
            ),
        };
        // Of a recording with several outputs the first says it.
        if findings.iter().all(|known| known.subject != subject) {
            findings.push(Finding::new(Severity::Warning, subject, sentence, remedy));
        }
    }
    findings
}
