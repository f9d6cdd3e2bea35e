//! Decompositions of real and complex matrices. Dense matrices are decomposed in place with partial pivoting,
//! without further allocation. Sparse decompositions are used if the pattern is known and they are faster.

use crate::sparsity::JacobianPattern;
use crate::stats::Stats;
use crate::system::CallResult;
use dense::DenseLu;
use scalar::Scalar;
use sparse::SparseLu;

mod dense;
mod scalar;
#[cfg_attr(not(feature = "sparse"), path = "dense_only.rs")]
mod sparse;

pub(crate) use dense::resize_matrix;

/// Matrices are sparse if they have at least this number of rows and at most this share of entries that may
/// be nonzero. Measured: a chain of 100 states (4 % of the entries) is decomposed in half the time of a dense
/// matrix. A chain of 1000 states (0.4 %) needs a ninetieth (74 us instead of 6.9 ms). A square grid of 196
/// states (2.4 %) needs the same time for the decomposition and a quarter for the solution.
const SPARSE_ROWS: usize = 100;
const SPARSE_SHARE: f64 = 0.05;

/// True if matrices of this pattern are stored and decomposed as sparse matrices. Always false without the
/// feature `sparse`.
pub(crate) fn is_sparse(pattern: &JacobianPattern) -> bool {
    cfg!(feature = "sparse") && is_large_and_empty(pattern)
}

fn is_large_and_empty(pattern: &JacobianPattern) -> bool {
    let n = pattern.n_states();
    n >= SPARSE_ROWS && (pattern.n_entries() as f64) <= SPARSE_SHARE * (n as f64) * (n as f64)
}

/// Returns the cost of the real and the complex decomposition of a matrix of this pattern, in right-hand
/// sides. Returns 0 unless the matrix is dense only because the feature `sparse` is off.
pub(crate) fn needless_work(pattern: &JacobianPattern) -> f64 {
    if cfg!(feature = "sparse") || !is_large_and_empty(pattern) {
        return 0.0;
    }
    let n = pattern.n_states() as u64;
    let linear_algebra = dense_operations(n, 1) + dense_operations(n, 4);
    Stats { linear_algebra, ..Stats::default() }.work(pattern.n_states())
}

/// Returns the number of floating-point operations of a dense decomposition. `per_place` is the number of
/// real operations per operation on an entry.
fn dense_operations(n: u64, per_place: u64) -> u64 {
    per_place * 2 * n * n * n / 3
}

/// The factors of a square matrix.
#[derive(Debug)]
pub(crate) struct Lu<T: Scalar> {
    dense: DenseLu<T>,
    sparse: Option<SparseLu<T>>,
}

impl<T: Scalar> Default for Lu<T> {
    fn default() -> Self {
        Self { dense: DenseLu::default(), sparse: None }
    }
}

impl<T: Scalar> Lu<T> {
    /// Allocates the work space for `n` rows: for all entries, or for the entries of a [sparse](is_sparse)
    /// pattern and the diagonal.
    ///
    /// # Errors
    /// Returns an error if memory is insufficient for a dense matrix of this size.
    pub(crate) fn begin(&mut self, n: usize, pattern: Option<&JacobianPattern>) -> CallResult<()> {
        match (pattern.filter(|p| is_sparse(p)), &self.sparse) {
            (None, _) => self.sparse = None,
            (Some(pattern), Some(sparse)) if sparse.pattern() == pattern => {}
            (Some(pattern), _) => self.sparse = SparseLu::new(pattern),
        }
        self.dense.resize(if self.sparse.is_some() { 0 } else { n })
    }

    /// Fills in the matrix entry by entry and decomposes it. The arguments of `entry` are the position in the
    /// list of entries by columns, and whether the entry is on the diagonal. If the matrix is sparse, the
    /// list contains the entries of the pattern and the diagonal, otherwise all entries. Returns `false` if
    /// the matrix is singular or has entries that are not finite.
    pub(crate) fn decompose(&mut self, entry: impl FnMut(usize, bool) -> T) -> bool {
        match &mut self.sparse {
            Some(sparse) => sparse.decompose(entry),
            None => self.dense.decompose(entry),
        }
    }

    /// Returns the floating-point operations of a decomposition and of a solution. The factors of a sparse
    /// matrix are assumed to have three times its entries, evenly distributed.
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
                (dense_operations(n, per_place), per_place * 2 * n * n)
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Complex, DMatrix, DVector};

    /// Pseudorandom numbers in (-1, 1).
    fn noise(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    #[test]
    fn dense_decomposition_solves_linear_systems() {
        let mut seed = 7;
        for n in [1, 2, 3, 8, 30] {
            let a = DMatrix::from_fn(n, n, |_, _| noise(&mut seed));
            let x = DVector::from_fn(n, |_, _| noise(&mut seed));
            let mut b = &a * &x;
            let mut lu = Lu::default();
            lu.begin(n, None).unwrap();
            assert!(lu.decompose(|p, _| a.as_slice()[p]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).amax() < 1e-11);

            let a = DMatrix::from_fn(n, n, |_, _| Complex::new(noise(&mut seed), noise(&mut seed)));
            let x = DVector::from_fn(n, |_, _| Complex::new(noise(&mut seed), noise(&mut seed)));
            let mut b = &a * &x;
            let mut lu = Lu::default();
            lu.begin(n, None).unwrap();
            assert!(lu.decompose(|p, _| a.as_slice()[p]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).norm() < 1e-11);
        }
    }

    /// Positions of the entries of a sparse matrix, with its diagonal, in the list of all entries.
    fn positions(pattern: &JacobianPattern) -> Vec<usize> {
        let n = pattern.n_states();
        let whole = pattern.with_diagonal();
        (0..n).flat_map(|k| whole.column(k).iter().map(move |i| i + n * k).collect::<Vec<_>>()).collect()
    }

    /// A square grid of `m * m` points, each depending on its neighbours.
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
    #[cfg(feature = "sparse")]
    fn sparse_and_dense_solutions_agree() {
        let mut seed = 3;
        for m in [10, 17] {
            let (n, pattern) = (m * m, grid(m));
            let places = positions(&pattern);
            let mut a = DMatrix::zeros(n, n);
            for k in 0..n {
                a[(k, k)] = noise(&mut seed) + 1.5;
                pattern.column(k).iter().for_each(|&i| a[(i, k)] = noise(&mut seed));
            }
            let x = DVector::from_fn(n, |_, _| noise(&mut seed));
            let mut lu = Lu::default();
            lu.begin(n, Some(&pattern)).unwrap();
            assert!(lu.sparse.is_some());
            for _ in 0..2 {
                let mut b = &a * &x;
                assert!(lu.decompose(|p, _| a.as_slice()[places[p]]));
                lu.solve(b.as_mut_slice());
                assert!((b - &x).amax() < 1e-10);
                a *= 3.0;
            }
            let turn = Complex::new(0.6, 0.8);
            let (a, x) = (a.map(|v| turn * v), x.map(|v| Complex::new(v, 1.0)));
            let mut b = &a * &x;
            let mut lu = Lu::default();
            lu.begin(n, Some(&pattern)).unwrap();
            assert!(lu.decompose(|p, _| a.as_slice()[places[p]]));
            lu.solve(b.as_mut_slice());
            assert!((b - x).norm() < 1e-9);
        }
        let mut lu = Lu::<f64>::default();
        lu.begin(100, Some(&grid(10))).unwrap();
        assert!(!lu.decompose(|_, _| f64::NAN));
        assert!(!lu.decompose(|p, _| if p == 0 { f64::INFINITY } else { 1.0 }));
        lu.begin(99, None).unwrap();
        assert!(lu.sparse.is_none());
        // Small or full matrices are dense.
        lu.begin(64, Some(&grid(8))).unwrap();
        assert!(lu.sparse.is_none());
        let full = JacobianPattern::new(100, (0..100).flat_map(|i| (0..100).map(move |k| (i, k)))).unwrap();
        lu.begin(100, Some(&full)).unwrap();
        assert!(lu.sparse.is_none());
    }

    #[test]
    fn rejects_singular_and_non_finite_matrices() {
        let mut lu = Lu::default();
        lu.begin(2, None).unwrap();
        assert!(!lu.decompose(|p, _| [1.0, 2.0, 2.0, 4.0][p]));
        assert!(!lu.decompose(|p, _| [f64::NAN, 2.0, 2.0, 4.0][p]));
        assert!(!lu.decompose(|p, _| [1.0, f64::INFINITY, 2.0, 4.0][p]));
        assert!(lu.decompose(|p, _| [0.0, 2.0, 2.0, 0.0][p]));
        #[cfg(feature = "sparse")]
        {
            let diagonal = JacobianPattern::new(200, (0..200).map(|i| (i, i))).unwrap();
            lu.begin(200, Some(&diagonal)).unwrap();
            assert!(lu.decompose(|_, _| 1.0) && !lu.decompose(|p, _| if p == 7 { 0.0 } else { 1.0 }));
        }
    }

    #[test]
    #[cfg(feature = "sparse")]
    fn operation_counts_follow_from_sizes() {
        let (mut real, mut complex) = (Lu::<f64>::default(), Lu::<Complex<f64>>::default());
        assert_eq!(real.operations(), (0, 0));
        real.begin(30, None).unwrap();
        complex.begin(30, None).unwrap();
        assert_eq!(real.operations(), (18_000, 1800));
        assert_eq!(complex.operations(), (72_000, 7200));
        // 10 * 10 points with 180 neighbours in both directions: 460 entries, 1380 in the factors.
        real.begin(100, Some(&grid(10))).unwrap();
        assert!(real.sparse.is_some());
        assert_eq!(real.operations(), (1380 * 1380 / 100, 2 * 1380));
    }

    /// Shortest of seven runs, in microseconds.
    fn microseconds(mut f: impl FnMut()) -> f64 {
        let once = |_| {
            let start = std::time::Instant::now();
            f();
            1e6 * start.elapsed().as_secs_f64()
        };
        (0..7).map(once).fold(f64::INFINITY, f64::min)
    }

    #[test]
    #[ignore = "a prints_a_table_of_decomposition_times to read"]
    #[allow(clippy::print_stdout)]
    fn prints_a_table_of_decomposition_times() {
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
            dense.begin(n, None).unwrap();
            dense_complex.begin(n, None).unwrap();
            sparse.begin(n, Some(&pattern)).unwrap();
            sparse_complex.begin(n, Some(&pattern)).unwrap();
            let places = positions(&pattern);
            let turned = |v: f64, diagonal: bool| Complex::new(v, if diagonal { 3.0 } else { 0.0 });
            let mut x = vec![1.0; n];
            let times = [
                microseconds(|| assert!(dense.decompose(|p, _| a[p]))),
                microseconds(|| assert!(sparse.decompose(|p, _| a[places[p]]))),
                microseconds(|| assert!(dense_complex.decompose(|p, d| turned(a[p], d)))),
                microseconds(|| assert!(sparse_complex.decompose(|p, d| turned(a[places[p]], d)))),
                microseconds(|| dense.solve(&mut x)),
                microseconds(|| sparse.solve(&mut x)),
            ]
            .map(|t| format!("{t:.1}"))
            .join(" ");
            println!("{name} n {n} share {:.4}: {times}", pattern.n_entries() as f64 / (n * n) as f64);
        }
    }
}
