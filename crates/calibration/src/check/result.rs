//! Result of a check.

use crate::findings::finding::{Finding, Severity, counts, sort, table};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Findings of a check: errors and warnings first, notes last. `Display` prints a table.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Check {
    /// Findings of the check.
    pub findings: Vec<Finding>,
    /// Number of evaluations for the check, each with one simulation of every experiment.
    pub n_evaluations: usize,
}

impl Check {
    /// Adds other findings, such as the findings of a preflight, without duplicates.
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
