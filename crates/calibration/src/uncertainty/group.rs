//! Outputs whose residuals have the same noise.

use std::ops::Range;

/// Outputs that share a variance and an autocorrelation.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Group {
    /// Numbers of the outputs.
    pub(crate) outputs: Vec<usize>,
    /// Runs of neighbouring rows of which the weight is not zero.
    pub(crate) series: Vec<Range<usize>>,
    /// The rows among them from which simulations start: their residuals are zero whatever the noise is.
    pub(crate) starts: Vec<usize>,
}

impl Group {
    /// The rows of all series, except those from which simulations start.
    pub(crate) fn rows(&self) -> impl Iterator<Item = usize> + '_ {
        self.series.iter().cloned().flatten().filter(|row| !self.starts.contains(row))
    }

    /// Number of rows of all series.
    pub(crate) fn n_rows(&self) -> usize {
        self.series.iter().map(Range::len).sum()
    }

    /// Number of pairs of neighbours.
    pub(crate) fn n_pairs(&self) -> usize {
        self.series.iter().map(|range| range.len().saturating_sub(1)).sum()
    }
}
