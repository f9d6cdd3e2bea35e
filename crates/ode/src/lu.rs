//! Dense decomposition with partial pivoting, in place: real and complex, no allocation once there is room.

use nalgebra::{ComplexField, DMatrix};

/// The factors of a square matrix `P A = L U` in one matrix, and the row exchanges.
#[derive(Debug)]
pub(crate) struct Lu<T> {
    a: DMatrix<T>,
    pivots: Vec<usize>,
}

impl<T: ComplexField<RealField = f64> + Copy> Default for Lu<T> {
    fn default() -> Self {
        Self { a: DMatrix::zeros(0, 0), pivots: Vec::new() }
    }
}

impl<T: ComplexField<RealField = f64> + Copy> Lu<T> {
    /// Makes room for `n` rows.
    pub(crate) fn resize(&mut self, n: usize) {
        if self.a.nrows() != n {
            self.a = DMatrix::zeros(n, n);
            self.pivots = vec![0; n];
        }
    }

    /// Fills in the matrix entry by entry (`entry` gets the position in a list by columns) and decomposes it; `false`:
    /// it is singular or has entries that are not finite.
    pub(crate) fn decompose(&mut self, mut entry: impl FnMut(usize) -> T) -> bool {
        let n = self.a.nrows();
        let a = self.a.as_mut_slice();
        for (p, a) in a.iter_mut().enumerate() {
            *a = entry(p);
        }
        for k in 0..n {
            let column = &a[k * n..(k + 1) * n];
            let mut pivot = k;
            let mut largest = column[k].norm1();
            for (i, v) in column.iter().enumerate().skip(k + 1) {
                if v.norm1() > largest {
                    (pivot, largest) = (i, v.norm1());
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
    pub(crate) fn solve(&self, b: &mut [T]) {
        let n = self.a.nrows();
        let a = self.a.as_slice();
        // The rows of earlier columns of L are not exchanged along, so exchanges and elimination alternate.
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Complex, DVector};

    /// Numbers in (-1, 1) without a pattern.
    fn noise(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    #[test]
    fn solves_what_it_decomposed() {
        let mut seed = 7;
        for n in [1, 2, 3, 8, 30] {
            let a = DMatrix::from_fn(n, n, |_, _| noise(&mut seed));
            let x = DVector::from_fn(n, |_, _| noise(&mut seed));
            let mut b = &a * &x;
            let mut lu = Lu::default();
            lu.resize(n);
            assert!(lu.decompose(|p| a.as_slice()[p]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).amax() < 1e-11);

            let a = DMatrix::from_fn(n, n, |_, _| Complex::new(noise(&mut seed), noise(&mut seed)));
            let x = DVector::from_fn(n, |_, _| Complex::new(noise(&mut seed), noise(&mut seed)));
            let mut b = &a * &x;
            let mut lu = Lu::default();
            lu.resize(n);
            assert!(lu.decompose(|p| a.as_slice()[p]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).norm() < 1e-11);
        }
    }

    #[test]
    fn singular_and_broken_matrices_are_refused() {
        let mut lu = Lu::default();
        lu.resize(2);
        assert!(!lu.decompose(|p| [1.0, 2.0, 2.0, 4.0][p]));
        assert!(!lu.decompose(|p| [f64::NAN, 2.0, 2.0, 4.0][p]));
        assert!(!lu.decompose(|p| [1.0, f64::INFINITY, 2.0, 4.0][p]));
        assert!(lu.decompose(|p| [0.0, 2.0, 2.0, 0.0][p]));
    }
}
