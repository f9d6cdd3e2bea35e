//! What a check finds: sentences with a subject, how grave they are, and what to do.

use serde::{Deserialize, Serialize};
use std::fmt;

/// What warnings of the construction are about.
pub(super) const SETUP: &str = "setup";

/// How grave a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Nothing can be fitted as it is.
    Error,
    /// It is likely not what is meant.
    Warning,
    /// Worth knowing.
    Note,
}

impl Severity {
    /// In lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warning => "warning",
            Self::Note => "note",
        }
    }
}

/// Something that a check has found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Finding {
    /// How grave it is.
    pub severity: Severity,
    /// What it is about: a recording, a column, a variable, a parameter.
    pub subject: String,
    /// What was found, with its numbers.
    pub sentence: String,
    /// What to do about it; may be empty.
    pub remedy: String,
}

impl Finding {
    pub(super) fn new(
        severity: Severity,
        subject: impl Into<String>,
        sentence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self { severity, subject: subject.into(), sentence: sentence.into(), remedy: remedy.into() }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.severity.name(), self.subject, self.sentence)?;
        if self.remedy.is_empty() { Ok(()) } else { write!(f, "; {}", self.remedy) }
    }
}

/// What a check has found, the gravest first. Its `Display` is a table.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Check {
    /// The findings.
    pub findings: Vec<Finding>,
    /// Evaluations that were made for it, each a simulation of every experiment.
    pub n_evaluations: usize,
}

impl Check {
    /// What is likely not meant: no notes, and not what was said already when the calibration was built.
    pub(crate) fn into_doubts(self) -> Vec<Finding> {
        let is_doubt = |finding: &Finding| finding.severity != Severity::Note && finding.subject != SETUP;
        self.findings.into_iter().filter(is_doubt).collect()
    }

    /// Whether there are no errors and no warnings.
    pub fn is_ok(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity == Severity::Note)
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = |severity| self.findings.iter().filter(|finding| finding.severity == severity).count();
        let counts = [Severity::Error, Severity::Warning, Severity::Note]
            .map(|severity| (n(severity), severity.name()))
            .into_iter()
            .filter(|(n, _)| *n > 0)
            .map(|(n, name)| format!("{n} {name}{}", if n == 1 { "" } else { "s" }))
            .collect::<Vec<_>>()
            .join(", ");
        f.write_str(if counts.is_empty() { "nothing found" } else { &counts })?;
        for Finding { severity, subject, sentence, remedy } in &self.findings {
            write!(f, "\n{:<8} {subject}: {sentence}", severity.name())?;
            if !remedy.is_empty() {
                write!(f, "\n         -> {remedy}")?;
            }
        }
        Ok(())
    }
}
