//! Outputs whose residuals have the same noise.

use std::ops::Range;

/// Outputs that share a variance and an autocorrelation.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Group {
    /// Numbers of the outputs.
    pub(crate) outputs: Vec<usize>,
    /// Runs of neighbouring rows that have noise of their own. Rows of weight zero have none, nor have the
    /// rows from which a simulation starts.
    pub(crate) series: Vec<Range<usize>>,
}

impl Group {
    /// The rows of all series.
    pub(crate) fn rows(&self) -> impl Iterator<Item = usize> + '_ {
        self.series.iter().cloned().flatten()
    }

    /// Number of rows.
    pub(crate) fn n_rows(&self) -> usize {
        self.series.iter().map(Range::len).sum()
    }

    /// Number of pairs of neighbours.
    pub(crate) fn n_pairs(&self) -> usize {
        self.series.iter().map(|range| range.len().saturating_sub(1)).sum()
    }

    /// Length of the longest series.
    pub(crate) fn longest(&self) -> usize {
        self.series.iter().map(Range::len).max().unwrap_or(0)
    }
}
