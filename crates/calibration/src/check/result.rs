//! Result of a check.

use crate::findings::finding::{Finding, Severity, counts, sort, table};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Findings of a check, the most severe first, notes last. Its `Display` is a table.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Check {
    /// The findings.
    pub findings: Vec<Finding>,
    /// Evaluations that were made for it, each a simulation of every experiment.
    pub n_evaluations: usize,
}

impl Check {
    /// The same with other findings, those of a preflight.
    #[must_use]
    pub fn with(mut self, others: &[Finding]) -> Self {
        let others = others.iter().filter(|finding| !self.findings.contains(finding));
        let others: Vec<Finding> = others.cloned().collect();
        self.findings.extend(others);
        sort(&mut self.findings);
        self
    }

    /// True if there are no errors and no warnings.
    pub fn is_ok(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity == Severity::Note)
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = counts(&self.findings);
        f.write_str(if counts.is_empty() { "nothing found" } else { &counts })?;
        f.write_str(&table(&self.findings))
    }
}
