//! Measurements that are there more than once: a recording given twice, a column for two outputs.

use super::subject::Subject;
use crate::cost::calibration::Calibration;
use crate::findings::finding::{Finding, Severity};
use crate::problem::residual_layout::OutputResiduals;

/// Fewer equal measurements may be chance.
const FEWEST: usize = 3;

/// Outputs of several experiments, or of one, with the same times and the same measurements. Windows that do
/// not overlap are others.
pub(super) fn findings(calibration: &Calibration, subjects: &[Subject<'_>]) -> Vec<Finding> {
    let outputs = &calibration.residual_layout().outputs;
    let is_same = |a: &OutputResiduals, b: &OutputResiduals| a.times == b.times && a.measured == b.measured;
    let varies = |a: &OutputResiduals| a.measured.iter().any(|m| *m != a.measured[0]);
    let mut findings: Vec<Finding> = Vec::new();
    let names = calibration.problem().experiment_names();
    for (k, b) in outputs.iter().enumerate() {
        if b.measured.len() < FEWEST || !varies(b) {
            continue;
        }
        let is_twice = |a: &&OutputResiduals| {
            is_same(a, b) && (a.experiment == b.experiment) == (a.variable != b.variable)
        };
        let Some(a) = outputs[..k].iter().find(is_twice) else { continue };
        let (subject, sentence, remedy) = match a.experiment == b.experiment {
            true => (
                format!("{}outputs '{}' and '{}'", subjects[b.experiment].prefix, a.variable, b.variable),
                format!(
                    "both have the same {} measurements (columns '{}' and '{}')",
                    b.measured.len(),
                    a.column,
                    b.column
                ),
                "give each output its own column",
            ),
            false => (
                format!("experiments {} and {}", names[a.experiment], names[b.experiment]),
                format!(
                    "output '{}' has the same {} measurements at the same times in both: the recording counts twice, and standard errors \
                     are too small",
                    b.variable,
                    b.measured.len()
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
