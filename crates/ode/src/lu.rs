//! Decompositions of real and complex matrices: dense with partial pivoting, in place, without allocation once there is
//! room; sparse where the pattern is known and it is worth it.

use crate::jacobian::JacobianPattern;
use nalgebra::{ComplexField, DMatrix};
use sparse::SparseLu;

mod sparse;

/// From so many rows on, and with at most this share of places that may differ from zero, matrices are sparse.
/// Measured: a chain of 100 states (4 % of the places) is decomposed in half the time of a dense matrix, one of 1000
/// (0.4 %) in a ninetieth (74 us instead of 6.9 ms); a square grid of 196 states (2.4 %) in the same time and solved in a quarter.
const SPARSE_ROWS: usize = 100;
const SPARSE_SHARE: f64 = 0.05;

/// The factors of a square matrix.
#[derive(Debug)]
pub(crate) struct Lu<T: Scalar> {
    dense: DenseLu<T>,
    sparse: Option<SparseLu<T>>,
}

/// What both sorts of decompositions take.
pub(crate) trait Scalar: ComplexField<RealField = f64> + faer::traits::ComplexField + Copy {}

impl<T: ComplexField<RealField = f64> + faer::traits::ComplexField + Copy> Scalar for T {}

impl<T: Scalar> Default for Lu<T> {
    fn default() -> Self {
        Self { dense: DenseLu::default(), sparse: None }
    }
}

impl<T: Scalar> Lu<T> {
    /// Makes room for `n` rows; for all their places, or for those of a pattern and the diagonal.
    pub(crate) fn begin(&mut self, n: usize, pattern: Option<&JacobianPattern>) {
        let worth_it = |p: &&JacobianPattern| {
            n >= SPARSE_ROWS && (p.n_entries() as f64) <= SPARSE_SHARE * (n as f64) * (n as f64)
        };
        match (pattern.filter(worth_it), &self.sparse) {
            (None, _) => self.sparse = None,
            (Some(pattern), Some(sparse)) if sparse.pattern() == pattern => {}
            (Some(pattern), _) => self.sparse = SparseLu::new(pattern),
        }
        self.dense.resize(if self.sparse.is_some() { 0 } else { n });
    }

    /// Fills in the matrix entry by entry (`entry` gets the position in a list by columns) and decomposes it; `false`:
    /// it is singular or has entries that are not finite.
    pub(crate) fn decompose(&mut self, entry: impl FnMut(usize) -> T) -> bool {
        match &mut self.sparse {
            Some(sparse) => sparse.decompose(entry),
            None => self.dense.decompose(entry),
        }
    }

    /// Floating-point operations of a decomposition and of a solution. The factors of a sparse matrix are taken to have
    /// three times its places, evenly spread.
    pub(crate) fn operations(&self) -> (u64, u64) {
        let per_place = (size_of::<T>() / size_of::<f64>()).pow(2) as u64;
        match &self.sparse {
            Some(sparse) => {
                let n = sparse.pattern().n_states() as u64;
                let places = 3 * (sparse.pattern().n_entries() as u64 + n);
                (per_place * places * places / n, 2 * per_place * places)
            }
            None => {
                let n = self.dense.pivots.len() as u64;
                (per_place * 2 * n * n * n / 3, per_place * 2 * n * n)
            }
        }
    }

    /// Solves `A x = b` in place of `b`.
    pub(crate) fn solve(&self, b: &mut [T]) {
        match &self.sparse {
            Some(sparse) => sparse.solve(b),
            None => self.dense.solve(b),
        }
    }
}

/// The factors of a square matrix `P A = L U` in one matrix, and the row exchanges.
#[derive(Debug)]
struct DenseLu<T> {
    a: DMatrix<T>,
    pivots: Vec<usize>,
}

impl<T: ComplexField<RealField = f64> + Copy> Default for DenseLu<T> {
    fn default() -> Self {
        Self { a: DMatrix::zeros(0, 0), pivots: Vec::new() }
    }
}

impl<T: ComplexField<RealField = f64> + Copy> DenseLu<T> {
    fn resize(&mut self, n: usize) {
        if self.a.nrows() != n {
            self.a = DMatrix::zeros(n, n);
            self.pivots = vec![0; n];
        }
    }

    fn decompose(&mut self, mut entry: impl FnMut(usize) -> T) -> bool {
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

    fn solve(&self, b: &mut [T]) {
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
            lu.begin(n, None);
            assert!(lu.decompose(|p| a.as_slice()[p]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).amax() < 1e-11);

            let a = DMatrix::from_fn(n, n, |_, _| Complex::new(noise(&mut seed), noise(&mut seed)));
            let x = DVector::from_fn(n, |_, _| Complex::new(noise(&mut seed), noise(&mut seed)));
            let mut b = &a * &x;
            let mut lu = Lu::default();
            lu.begin(n, None);
            assert!(lu.decompose(|p| a.as_slice()[p]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).norm() < 1e-11);
        }
    }

    /// A square grid of `m * m` places, each depending on its neighbours.
    fn grid(m: usize) -> JacobianPattern {
        let place = |i: usize, j: usize| i * m + j;
        let mut entries = Vec::new();
        for (i, j) in (0..m).flat_map(|i| (0..m).map(move |j| (i, j))) {
            if i > 0 {
                entries.extend([(place(i, j), place(i - 1, j)), (place(i - 1, j), place(i, j))]);
            }
            if j > 0 {
                entries.extend([(place(i, j), place(i, j - 1)), (place(i, j - 1), place(i, j))]);
            }
        }
        JacobianPattern::new(m * m, entries).unwrap()
    }

    #[test]
    fn sparse_matrices_are_solved_like_dense_ones() {
        let mut seed = 3;
        for m in [10, 17] {
            let (n, pattern) = (m * m, grid(m));
            let mut a = DMatrix::zeros(n, n);
            for k in 0..n {
                a[(k, k)] = noise(&mut seed) + 1.5;
                pattern.column(k).iter().for_each(|&i| a[(i, k)] = noise(&mut seed));
            }
            let x = DVector::from_fn(n, |_, _| noise(&mut seed));
            let mut lu = Lu::default();
            lu.begin(n, Some(&pattern));
            assert!(lu.sparse.is_some());
            for _ in 0..2 {
                let mut b = &a * &x;
                assert!(lu.decompose(|p| a.as_slice()[p]));
                lu.solve(b.as_mut_slice());
                assert!((b - &x).amax() < 1e-10);
                a *= 3.0;
            }
            let turn = Complex::new(0.6, 0.8);
            let (a, x) = (a.map(|v| turn * v), x.map(|v| Complex::new(v, 1.0)));
            let mut b = &a * &x;
            let mut lu = Lu::default();
            lu.begin(n, Some(&pattern));
            assert!(lu.decompose(|p| a.as_slice()[p]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).norm() < 1e-9);
        }
        let mut lu = Lu::<f64>::default();
        lu.begin(100, Some(&grid(10)));
        assert!(!lu.decompose(|_| f64::NAN));
        assert!(!lu.decompose(|p| if p == 0 { f64::INFINITY } else { 1.0 }));
        lu.begin(99, None);
        assert!(lu.sparse.is_none());
        // Small or full: dense.
        lu.begin(64, Some(&grid(8)));
        assert!(lu.sparse.is_none());
        let full = JacobianPattern::new(100, (0..100).flat_map(|i| (0..100).map(move |k| (i, k)))).unwrap();
        lu.begin(100, Some(&full));
        assert!(lu.sparse.is_none());
    }

    #[test]
    fn singular_and_broken_matrices_are_refused() {
        let mut lu = Lu::default();
        lu.begin(2, None);
        assert!(!lu.decompose(|p| [1.0, 2.0, 2.0, 4.0][p]));
        assert!(!lu.decompose(|p| [f64::NAN, 2.0, 2.0, 4.0][p]));
        assert!(!lu.decompose(|p| [1.0, f64::INFINITY, 2.0, 4.0][p]));
        assert!(lu.decompose(|p| [0.0, 2.0, 2.0, 0.0][p]));
    }

    #[test]
    fn operations_follow_from_sizes() {
        let (mut real, mut complex) = (Lu::<f64>::default(), Lu::<Complex<f64>>::default());
        assert_eq!(real.operations(), (0, 0));
        real.begin(30, None);
        complex.begin(30, None);
        assert_eq!(real.operations(), (18_000, 1800));
        assert_eq!(complex.operations(), (72_000, 7200));
        // 10 * 10 places, 180 neighbours in both directions: 460 places, 1380 in the factors.
        real.begin(100, Some(&grid(10)));
        assert!(real.sparse.is_some());
        assert_eq!(real.operations(), (1380 * 1380 / 100, 2 * 1380));
    }

    /// Shortest of several runs, in microseconds.
    fn microseconds(mut f: impl FnMut()) -> f64 {
        let once = |_| {
            let start = std::time::Instant::now();
            f();
            1e6 * start.elapsed().as_secs_f64()
        };
        (0..7).map(once).fold(f64::INFINITY, f64::min)
    }

    #[test]
    #[ignore = "a table to read"]
    #[allow(clippy::print_stdout)]
    fn table() {
        let chain = |n: usize| {
            let entries = (0..n).flat_map(|k| (k.saturating_sub(2)..(k + 3).min(n)).map(move |i| (i, k)));
            JacobianPattern::new(n, entries).unwrap()
        };
        let chains = [100, 200, 400, 1000, 2000].map(|n| ("chain", chain(n)));
        let grids = [10, 14, 20, 32, 44].map(|m| ("grid", grid(m)));
        for (name, pattern) in chains.into_iter().chain(grids) {
            let n = pattern.n_states();
            let mut a = vec![0.0; n * n];
            for k in 0..n {
                pattern.column(k).iter().for_each(|&i| a[i + n * k] = -1.0);
                a[k * (n + 1)] = 9.0;
            }
            let (mut dense, mut sparse) = (Lu::default(), Lu::default());
            let (mut dense_complex, mut sparse_complex) = (Lu::default(), Lu::default());
            dense.begin(n, None);
            dense_complex.begin(n, None);
            sparse.begin(n, Some(&pattern));
            sparse_complex.begin(n, Some(&pattern));
            let turned = |p: usize| Complex::new(a[p], if p.is_multiple_of(n + 1) { 3.0 } else { 0.0 });
            let mut x = vec![1.0; n];
            let times = [
                microseconds(|| assert!(dense.decompose(|p| a[p]))),
                microseconds(|| assert!(sparse.decompose(|p| a[p]))),
                microseconds(|| assert!(dense_complex.decompose(turned))),
                microseconds(|| assert!(sparse_complex.decompose(turned))),
                microseconds(|| dense.solve(&mut x)),
                microseconds(|| sparse.solve(&mut x)),
            ]
            .map(|t| format!("{t:.1}"))
            .join(" ");
            println!("{name} n {n} share {:.4}: {times}", pattern.n_entries() as f64 / (n * n) as f64);
        }
    }
}
