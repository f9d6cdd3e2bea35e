//! Sparse decomposition by the library faer. The pattern is analysed once; values can be decomposed
//! repeatedly.
//!
//! Unlike the dense decomposition, this one allocates: 39 times per decomposition (factors and work space)
//! and once per solution. The next decomposition frees all of it.

use super::scalar::Scalar;
use crate::sparsity::JacobianPattern;
use faer::linalg::solvers::Solve;
use faer::mat::MatMut;
use faer::sparse::linalg::solvers::{Lu, SymbolicLu};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use num_complex::ComplexFloat;

/// The factors of a sparse matrix.
#[derive(Debug)]
pub(crate) struct SparseLu<T> {
    /// The pattern as given.
    pattern: JacobianPattern,
    /// The pattern with the diagonal.
    places: SymbolicSparseColMat<usize>,
    analysis: SymbolicLu<usize>,
    /// For each entry, true if it is on the diagonal.
    on_diagonal: Vec<bool>,
    values: Vec<T>,
    factors: Option<Lu<usize, T>>,
}

impl<T: Scalar> SparseLu<T> {
    /// Analyses matrices of this pattern and a full diagonal. Returns `None` if the library fails to analyse
    /// it.
    pub(crate) fn new(pattern: &JacobianPattern) -> Option<Self> {
        let n = pattern.n_states();
        let whole = pattern.with_diagonal();
        let on_diagonal: Vec<bool> =
            (0..n).flat_map(|k| whole.column(k).iter().map(move |i| *i == k)).collect();
        let (starts, rows) = whole.into_columns();
        let places = SymbolicSparseColMat::new_checked(n, n, starts, None, rows);
        let analysis = SymbolicLu::try_new(places.as_ref()).ok()?;
        let values = vec![T::zero(); on_diagonal.len()];
        Some(Self { pattern: pattern.clone(), places, analysis, on_diagonal, values, factors: None })
    }

    pub(crate) fn pattern(&self) -> &JacobianPattern {
        &self.pattern
    }

    /// Reads the entries of the pattern and decomposes the matrix. Returns `false` if some entries are not
    /// finite or the matrix is singular. A numerically singular matrix is detected by a solution that is not
    /// finite.
    pub(crate) fn decompose(&mut self, mut entry: impl FnMut(usize, bool) -> T) -> bool {
        for (p, (value, on_diagonal)) in self.values.iter_mut().zip(&self.on_diagonal).enumerate() {
            *value = entry(p, *on_diagonal);
            if !ComplexFloat::is_finite(*value) {
                return false;
            }
        }
        let matrix = SparseColMatRef::new(self.places.as_ref(), &self.values[..]);
        self.factors = Lu::try_new_with_symbolic(self.analysis.clone(), matrix).ok();
        let mut probe = vec![T::one(); self.pattern.n_states()];
        self.solve(&mut probe);
        self.factors.is_some() && probe.into_iter().all(ComplexFloat::is_finite)
    }

    /// Solves `A x = b` in place of `b`.
    pub(crate) fn solve(&self, b: &mut [T]) {
        let n = b.len();
        if let Some(factors) = &self.factors {
            factors.solve_in_place(MatMut::from_column_major_slice_mut(b, n, 1));
        }
    }
}
