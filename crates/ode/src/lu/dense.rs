//! Dense decomposition with partial pivoting, in place.

use super::scalar::Scalar;
use crate::error::TooLargeForDense;
use crate::system::{CallError, CallResult};

/// Maximum number of rows of a dense matrix: 2 GB each (4 GB if complex), and hours per decomposition.
const MOST_DENSE_ROWS: usize = 16384;

/// Resizes a list to the entries of a dense matrix of `n` rows. Returns an error if memory is insufficient.
pub(crate) fn resize_matrix<T: Clone>(list: &mut Vec<T>, n: usize, zero: T) -> CallResult<()> {
    let entries = n.saturating_mul(n);
    list.clear();
    if n > MOST_DENSE_ROWS || list.try_reserve_exact(entries).is_err() {
        return Err(CallError::failed(TooLargeForDense { states: n }));
    }
    list.resize(entries, zero);
    Ok(())
}

/// The factors of a square matrix `P A = L U` in one matrix, and the row exchanges.
#[derive(Debug)]
pub(super) struct DenseLu<T> {
    a: Vec<T>,
    pub(super) pivots: Vec<usize>,
}

impl<T: Scalar> Default for DenseLu<T> {
    fn default() -> Self {
        Self { a: Vec::new(), pivots: Vec::new() }
    }
}

impl<T: Scalar> DenseLu<T> {
    /// Allocates the work space for `n` rows.
    ///
    /// # Errors
    /// Returns an error if memory is insufficient.
    pub(super) fn resize(&mut self, n: usize) -> CallResult<()> {
        if self.pivots.len() != n {
            resize_matrix(&mut self.a, n, T::zero())?;
            self.pivots = vec![0; n];
        }
        Ok(())
    }

    /// Fills in the matrix entry by entry and decomposes it. Returns `false` if the matrix is singular or has
    /// entries that are not finite.
    pub(super) fn decompose(&mut self, mut entry: impl FnMut(usize, bool) -> T) -> bool {
        let n = self.pivots.len();
        let a = &mut self.a[..];
        for (p, a) in a.iter_mut().enumerate() {
            *a = entry(p, p.is_multiple_of(n + 1));
        }
        for k in 0..n {
            let column = &a[k * n..(k + 1) * n];
            let mut pivot = k;
            let mut largest = column[k].l1_norm();
            for (i, v) in column.iter().enumerate().skip(k + 1) {
                if v.l1_norm() > largest {
                    (pivot, largest) = (i, v.l1_norm());
                }
            }
            // Also false for a NaN.
            if !(largest > 0.0 && largest.is_finite()) {
                return false;
            }
            self.pivots[k] = pivot;
            let (left, right) = a.split_at_mut((k + 1) * n);
            let column = &mut left[k * n..];
            column.swap(k, pivot);
            let inverse = T::one() / column[k];
            column[k + 1..].iter_mut().for_each(|v| *v *= inverse);
            let multipliers = &column[k + 1..];
            for other in right.chunks_exact_mut(n) {
                other.swap(k, pivot);
                let factor = other[k];
                if factor != T::zero() {
                    for (o, m) in other[k + 1..].iter_mut().zip(multipliers) {
                        *o -= *m * factor;
                    }
                }
            }
        }
        true
    }

    /// Solves `A x = b` in place of `b`.
    pub(super) fn solve(&self, b: &mut [T]) {
        let n = self.pivots.len();
        let a = &self.a[..];
        // Row exchanges are not applied to the earlier columns of L, so exchanges and elimination alternate.
        for k in 0..n {
            b.swap(k, self.pivots[k]);
            let factor = b[k];
            if factor != T::zero() {
                for (b, l) in b[k + 1..].iter_mut().zip(&a[k * n + k + 1..(k + 1) * n]) {
                    *b -= *l * factor;
                }
            }
        }
        for k in (0..n).rev() {
            let factor = b[k] / a[k * n + k];
            b[k] = factor;
            for (b, u) in b[..k].iter_mut().zip(&a[k * n..k * n + k]) {
                *b -= *u * factor;
            }
        }
    }
}
