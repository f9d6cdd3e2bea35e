//! Outputs whose residuals have the same noise.

use std::ops::Range;

/// Outputs that share a variance and an autocorrelation.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Group {
    /// Indices of the outputs.
    pub(crate) outputs: Vec<usize>,
    /// Ranges of consecutive rows whose weight is not zero.
    pub(crate) series: Vec<Range<usize>>,
    /// Rows that simulations start from. Their residuals are zero for any noise.
    pub(crate) starts: Vec<usize>,
    /// True if the standard deviation of the residuals is known to be 1.
    pub(crate) is_known: bool,
}

impl Group {
    /// Returns the rows of all series, except rows that simulations start from.
    pub(crate) fn rows(&self) -> impl Iterator<Item = usize> + '_ {
        self.series.iter().cloned().flatten().filter(|row| !self.starts.contains(row))
    }

    /// Returns the number of rows of all series.
    pub(crate) fn n_rows(&self) -> usize {
        self.series.iter().map(Range::len).sum()
    }

    /// Returns the number of pairs of neighbouring rows.
    pub(crate) fn n_pairs(&self) -> usize {
        self.series.iter().map(|range| range.len().saturating_sub(1)).sum()
    }
}
