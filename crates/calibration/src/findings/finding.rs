//! Findings about a setup or a fit: sentences with an identifier, a subject, a severity and a remedy.

use crate::findings::display_text::visible_line;
use crate::findings::identifier::FindingId;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// The setup cannot be fitted, or the result of the fit should not be used.
    Error,
    /// The setup is probably not intended, or a value is unreliable.
    Warning,
    /// The finding is informative.
    Note,
}

impl Severity {
    /// Returns the name in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warning => "warning",
            Self::Note => "note",
        }
    }
}

/// Subject area of a finding. Areas are ordered by cause, because a wrong unit can leave a parameter at its
/// bound, and both can leave systematic residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// Model, recording, unit or setting.
    #[default]
    Problem,
    /// Parameters and search: final values, identifiability, and termination.
    Search,
    /// Residuals and standard errors.
    Residuals,
}

/// Finding of a check or about the result of a fit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Finding {
    /// Identifier of the kind of finding.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub id: FindingId,
    /// Severity of the finding.
    pub severity: Severity,
    /// Subject of the finding: a recording, a column, a variable, a parameter.
    pub subject: String,
    /// Symptom with its numbers, and its consequence, without a final full stop.
    pub sentence: String,
    /// Remedy, without a final full stop; may be empty.
    pub remedy: String,
    /// Subject area of the finding.
    #[serde(default)]
    pub origin: Origin,
}

impl Finding {
    pub(crate) fn new(
        severity: Severity,
        id: FindingId,
        subject: impl Into<String>,
        sentence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let line = |text: String| match visible_line(&text) {
            Cow::Borrowed(_) => text,
            Cow::Owned(shown) => shown,
        };
        let (subject, sentence, remedy) = (line(subject.into()), line(sentence.into()), line(remedy.into()));
        Self { id, severity, subject, sentence, remedy, origin: Origin::Problem }
    }

    /// Returns the finding with another origin.
    pub(crate) fn of(self, origin: Origin) -> Self {
        Self { origin, ..self }
    }

    pub(crate) fn warning(
        id: FindingId,
        subject: impl Into<String>,
        sentence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::new(Severity::Warning, id, subject, sentence, remedy)
    }

    pub(crate) fn note(
        id: FindingId,
        subject: impl Into<String>,
        sentence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::new(Severity::Note, id, subject, sentence, remedy)
    }

    /// Returns the sentence and the identifier, preceded by the subject if the sentence does not contain it:
    /// `step: ... [F028 inaccurate-simulation]`.
    pub fn text(&self) -> String {
        match self.subject.is_empty() || self.sentence.contains(&self.subject) {
            true => format!("{} [{}]", self.sentence, self.id),
            false => format!("{}: {} [{}]", self.subject, self.sentence, self.id),
        }
    }

    /// Returns the text and the remedy.
    pub fn advice(&self) -> String {
        if self.remedy.is_empty() { self.text() } else { format!("{}. {}", self.text(), self.remedy) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.severity.name(), self.advice())
    }
}

/// Sorts findings so that causes come before consequences, errors before warnings within one origin, and
/// notes last.
pub(crate) fn sort(findings: &mut [Finding]) {
    findings.sort_by_key(|finding| (finding.severity == Severity::Note, finding.origin, finding.severity));
}

/// Returns the counts, such as "1 error, 2 warnings". Returns an empty string if there are no findings.
pub(crate) fn counts(findings: &[Finding]) -> String {
    let n = |severity| findings.iter().filter(|finding| finding.severity == severity).count();
    [Severity::Error, Severity::Warning, Severity::Note]
        .map(|severity| (n(severity), severity.name()))
        .into_iter()
        .filter(|(n, _)| *n > 0)
        .map(|(n, name)| format!("{n} {name}{}", if n == 1 { "" } else { "s" }))
        .collect::<Vec<_>>()
        .join(", ")
}

/// Merges notes that differ only in their subjects into the first one, which lists the other subjects.
pub(crate) fn merged(findings: &[Finding]) -> Vec<Finding> {
    let common = |finding: &Finding| match finding.subject.as_str() {
        "" => finding.sentence.clone(),
        subject => finding.sentence.replace(&format!("'{subject}'"), "''"),
    };
    let is_same = |a: &Finding, b: &Finding| {
        b.severity == Severity::Note
            && (a.severity, a.id, &a.remedy) == (b.severity, b.id, &b.remedy)
            && common(a) == common(b)
    };
    let mut groups: Vec<Vec<&Finding>> = Vec::new();
    for finding in findings {
        match groups.iter_mut().find(|group| is_same(group[0], finding)) {
            Some(group) => group.push(finding),
            None => groups.push(vec![finding]),
        }
    }
    let one = |group: Vec<&Finding>| {
        let others: Vec<&str> = group[1..].iter().map(|finding| finding.subject.as_str()).collect();
        let sentence = match others.is_empty() {
            true => group[0].sentence.clone(),
            false => format!("{} (also {})", group[0].sentence, others.join(", ")),
        };
        Finding { sentence, ..group[0].clone() }
    };
    groups.into_iter().map(one).collect()
}

/// Returns a line for each finding, with the remedy below it. Each line begins with a line break. Equal notes
/// about several subjects have one line.
pub(crate) fn table(findings: &[Finding]) -> String {
    let lines = |finding: &Finding| {
        let remedy = match finding.remedy.as_str() {
            "" => String::new(),
            remedy => format!("\n         -> {}", visible_line(remedy)),
        };
        format!("\n{:<8} {}{remedy}", finding.severity.name(), visible_line(&finding.text()))
    };
    merged(findings).iter().map(lines).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_notes_about_several_subjects_have_one_line() {
        let note = |subject: &str, sentence: &str| {
            Finding::note(FindingId::ConstantColumn, subject, sentence, "Check it")
        };
        let warning = Finding::warning(FindingId::ConstantColumn, "out.5", "is constant", "Check it");
        let findings = [
            note("out.1", "is constant"),
            note("out.2", "is constant"),
            warning.clone(),
            note("x1", "column 'x1' is constant"),
            note("out.3", "is constant"),
            note("x2", "column 'x2' is constant"),
            note("out.4", "is zero"),
            warning.clone(),
        ];
        let lines: Vec<String> = merged(&findings).iter().map(Finding::text).collect();
        let id = "[F049 constant-column]";
        let expected = [
            format!("out.1: is constant (also out.2, out.3) {id}"),
            format!("out.5: is constant {id}"),
            format!("column 'x1' is constant (also x2) {id}"),
            format!("out.4: is zero {id}"),
            format!("out.5: is constant {id}"),
        ];
        assert_eq!(lines, expected);
        assert_eq!(table(&findings).matches("Check it").count(), 5);
    }
}
