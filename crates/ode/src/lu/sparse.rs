//! Sparse decomposition by the library faer: the pattern is analysed once, numbers are decomposed as often as wanted.
//!
//! Unlike the dense one it allocates: 37 times for a decomposition (its factors, and room to work in), once for a solution.
//! Everything is given back with the next decomposition.

use super::Scalar;
use crate::jacobian::JacobianPattern;
use faer::linalg::solvers::Solve;
use faer::mat::MatMut;
use faer::sparse::linalg::solvers::{Lu, SymbolicLu};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};

/// The factors of a sparse matrix.
#[derive(Debug)]
pub(crate) struct SparseLu<T> {
    /// As it was given.
    pattern: JacobianPattern,
    /// With the diagonal.
    places: SymbolicSparseColMat<usize>,
    analysis: SymbolicLu<usize>,
    /// Of each place its position in a list of all entries by columns, and its number.
    positions: Vec<usize>,
    values: Vec<T>,
    factors: Option<Lu<usize, T>>,
}

impl<T: Scalar> SparseLu<T> {
    /// For matrices of this pattern and a full diagonal. `None`: the library cannot take it.
    pub(crate) fn new(pattern: &JacobianPattern) -> Option<Self> {
        let n = pattern.n_states();
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for k in 0..n {
            let column = pattern.column(k);
            let at = column.partition_point(|&i| i < k);
            rows.extend(&column[..at]);
            rows.push(k);
            rows.extend(column[at..].iter().filter(|&&i| i != k));
            starts.push(rows.len());
        }
        let column_of = |k: usize| starts[k]..starts[k + 1];
        let positions: Vec<usize> =
            (0..n).flat_map(|k| rows[column_of(k)].iter().map(move |i| i + n * k)).collect();
        let places = SymbolicSparseColMat::new_checked(n, n, starts, None, rows);
        let analysis = SymbolicLu::try_new(places.as_ref()).ok()?;
        let values = vec![<T as nalgebra::ComplexField>::from_real(0.0); positions.len()];
        Some(Self { pattern: pattern.clone(), places, analysis, positions, values, factors: None })
    }

    pub(crate) fn pattern(&self) -> &JacobianPattern {
        &self.pattern
    }

    /// Reads the entries of the pattern and decomposes; `false`: some are not finite, or the pattern is singular. A
    /// matrix that is singular by its numbers gives solutions that are not finite.
    pub(crate) fn decompose(&mut self, mut entry: impl FnMut(usize) -> T) -> bool {
        for (value, p) in self.values.iter_mut().zip(&self.positions) {
            *value = entry(*p);
            if !nalgebra::ComplexField::is_finite(value) {
                return false;
            }
        }
        let matrix = SparseColMatRef::new(self.places.as_ref(), &self.values[..]);
        self.factors = Lu::try_new_with_symbolic(self.analysis.clone(), matrix).ok();
        self.factors.is_some()
    }

    /// Solves `A x = b` in place of `b`.
    pub(crate) fn solve(&self, b: &mut [T]) {
        let n = b.len();
        if let Some(factors) = &self.factors {
            factors.solve_in_place(MatMut::from_column_major_slice_mut(b, n, 1));
        }
    }
}
