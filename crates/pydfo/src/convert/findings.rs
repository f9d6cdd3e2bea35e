//! Findings of checks, fits and validations, as Python takes them.

use calibration::Finding;

/// Severity, subject, sentence, remedy: the fields of `pydfo.Finding`.
pub(crate) type FindingFields = (&'static str, String, String, String);

/// The fields of each.
pub(crate) fn fields(findings: Vec<Finding>) -> Vec<FindingFields> {
    findings.into_iter().map(|f| (f.severity.name(), f.subject, f.sentence, f.remedy)).collect()
}
