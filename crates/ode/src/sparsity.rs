//! Sparsity patterns of Jacobians and their colouring.

/// Sparsity pattern of a Jacobian: the positions that may be nonzero. Row `i` is the derivative of state `i`,
/// and column `k` is the state it depends on.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct JacobianPattern {
    /// The rows of column `k` are `rows[starts[k]..starts[k + 1]]`, ascending.
    pub(crate) starts: Vec<usize>,
    rows: Vec<usize>,
}

impl JacobianPattern {
    /// Creates the pattern of `n` states from pairs `(i, k)`: the derivative of state `i` depends on state
    /// `k`. Pairs may repeat. Returns `None` if an index is not below `n`.
    ///
    /// ```
    /// let tridiagonal = (0..5usize).flat_map(|k| (k.saturating_sub(1)..(k + 2).min(5)).map(move |i| (i, k)));
    /// let pattern = ode::JacobianPattern::new(5, tridiagonal).ok_or("out of range")?;
    /// assert_eq!(pattern.n_colours(), 3);
    /// # Ok::<(), &str>(())
    /// ```
    pub fn new(n: usize, entries: impl IntoIterator<Item = (usize, usize)>) -> Option<Self> {
        let mut columns = vec![Vec::new(); n];
        for (i, k) in entries {
            if i >= n {
                return None;
            }
            columns.get_mut(k)?.push(i);
        }
        let mut pattern = Self { starts: vec![0], rows: Vec::new() };
        for mut column in columns {
            column.sort_unstable();
            column.dedup();
            pattern.rows.extend(column);
            pattern.starts.push(pattern.rows.len());
        }
        Some(pattern)
    }

    /// Returns this pattern with all positions of the diagonal added.
    pub(crate) fn with_diagonal(&self) -> Self {
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for k in 0..self.n_states() {
            let column = self.column(k);
            let at = column.partition_point(|&i| i < k);
            rows.extend(&column[..at]);
            rows.push(k);
            rows.extend(column[at..].iter().filter(|&&i| i != k));
            starts.push(rows.len());
        }
        Self { starts, rows }
    }

    /// Returns the start of each column and the rows of all columns.
    #[cfg(feature = "sparse")]
    pub(crate) fn into_columns(self) -> (Vec<usize>, Vec<usize>) {
        (self.starts, self.rows)
    }

    /// Number of states.
    pub fn n_states(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Number of positions that may be nonzero.
    pub fn n_entries(&self) -> usize {
        self.rows.len()
    }

    /// Row and column of all positions, column by column, with ascending rows.
    pub fn entries(&self) -> impl Iterator<Item = (usize, usize)> {
        (0..self.n_states()).flat_map(|k| self.column(k).iter().map(move |&i| (i, k)))
    }

    /// Index of a position in the list of all positions.
    pub(crate) fn place(&self, i: usize, k: usize) -> usize {
        self.starts[k] + self.column(k).partition_point(|&row| row < i)
    }

    /// Rows of column `k`, ascending.
    pub(crate) fn column(&self, k: usize) -> &[usize] {
        &self.rows[self.starts[k]..self.starts[k + 1]]
    }

    /// Largest number of rows in a column: the minimum number of evaluations of a Jacobian.
    pub(crate) fn widest_column(&self) -> usize {
        self.starts.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0)
    }

    /// Number of evaluations that a Jacobian of this pattern requires.
    pub fn n_colours(&self) -> usize {
        Groups::new(self).len()
    }
}

/// Groups of columns that share no row, so that one evaluation yields the whole group. A. R. Curtis, M. J. D.
/// Powell, J. K. Reid, On the estimation of sparse Jacobian matrices, IMA Journal of Applied Mathematics 13
/// (1974) 117-119; greedy, columns with most rows first.
#[derive(Debug, Default)]
pub(crate) struct Groups {
    /// The columns of group `g` are `columns[starts[g]..starts[g + 1]]`.
    starts: Vec<usize>,
    pub(crate) columns: Vec<usize>,
}

impl Groups {
    /// Puts each of `n` columns into a separate group.
    pub(crate) fn single(n: usize) -> Self {
        Self { starts: (0..=n).collect(), columns: (0..n).collect() }
    }

    pub(crate) fn new(pattern: &JacobianPattern) -> Self {
        let n = pattern.n_states();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_key(|&k| std::cmp::Reverse(pattern.column(k).len()));
        // `taken`: groups with an entry in each row. `refused_by`: last column that did not fit into each
        // group.
        let mut taken = vec![Vec::new(); n];
        let mut refused_by: Vec<usize> = Vec::new();
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for k in order {
            for &i in pattern.column(k) {
                taken[i].iter().for_each(|&g: &usize| refused_by[g] = k);
            }
            let g = refused_by.iter().position(|&by| by != k).unwrap_or(groups.len());
            if g == groups.len() {
                groups.push(Vec::new());
                refused_by.push(usize::MAX);
            }
            pattern.column(k).iter().for_each(|&i| taken[i].push(g));
            groups[g].push(k);
        }
        let mut lists = Self { starts: vec![0], columns: Vec::new() };
        for columns in groups {
            lists.columns.extend(columns);
            lists.starts.push(lists.columns.len());
        }
        lists
    }

    pub(crate) fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Range of the columns of a group in `columns`.
    pub(crate) fn range(&self, g: usize) -> std::ops::Range<usize> {
        self.starts[g]..self.starts[g + 1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_validated_and_coloured() {
        assert!(JacobianPattern::new(2, [(2, 0)]).is_none());
        assert!(JacobianPattern::new(2, [(0, 2)]).is_none());
        let arrow = (0..6).flat_map(|i| [(i, i), (0, i), (i, 0)]);
        assert_eq!(JacobianPattern::new(6, arrow).unwrap().n_colours(), 6);
        let diagonal = JacobianPattern::new(6, (0..6).map(|i| (i, i)).chain([(1, 1)])).unwrap();
        assert_eq!((diagonal.n_colours(), diagonal.n_entries(), diagonal.n_states()), (1, 6, 6));
        assert_eq!(JacobianPattern::new(0, []).unwrap().n_colours(), 0);
    }
}
