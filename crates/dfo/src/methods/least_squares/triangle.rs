//! An upper triangular factor with row additions and rank-one updates (Golub and Van Loan, Matrix
//! Computations, 4th edition, sections 5.2 and 6.5.1).

use super::points::{axpy, dot};
use nalgebra::{DMatrix, DVector};

/// Number of matrix entries that are added at once. They fit into a cache.
const AT_ONCE: usize = 1 << 15;

/// Returns the number of rows that are added at once.
pub(super) fn rows_at_once(n: usize) -> usize {
    (AT_ONCE / (n + 1)).max(16)
}

/// Returns the rotation that makes the second number zero, and the resulting first number.
fn rotation(a: f64, b: f64) -> ((f64, f64), f64) {
    let length = a.hypot(b);
    if length > 0.0 { ((a / length, b / length), length) } else { ((1.0, 0.0), 0.0) }
}

/// `R` and `c` of `R = Q'J` and `c = Q'r`.
#[derive(Debug, Clone)]
pub(super) struct Triangle {
    pub(super) factor: DMatrix<f64>,
    pub(super) reached: DVector<f64>,
}

impl Triangle {
    pub(super) fn zero(n: usize) -> Self {
        Self { factor: DMatrix::zeros(n, n), reached: DVector::zeros(n) }
    }

    /// Adds rows of `J` and `r`, given column by column with the columns of `J` first. Overwrites `block`.
    pub(super) fn absorb(&mut self, rows: usize, block: &mut [f64]) {
        let n = self.reached.len();
        for j in 0..n {
            let (head, tail) = block.split_at_mut((j + 1) * rows);
            let column = &head[j * rows..];
            let (pivot, below) = (self.factor[(j, j)], dot(column, column));
            // Dependent rows leave rounding errors. The next columns contain rounding errors of these, down
            // to numbers without a reciprocal.
            if below < f64::MIN_POSITIVE {
                continue;
            }
            let length = (pivot * pivot + below).sqrt();
            let end = if pivot > 0.0 { -length } else { length };
            // The Householder vector is the column with this number above it.
            let first = pivot - end;
            let factor = 2.0 / (first * first + below);
            self.factor[(j, j)] = end;
            for (k, other) in (j + 1..).zip(tail.chunks_exact_mut(rows)) {
                let top = if k < n { &mut self.factor[(j, k)] } else { &mut self.reached[j] };
                let share = factor * (first * *top + dot(column, other));
                *top -= share * first;
                axpy(-share, column, other);
            }
        }
    }

    /// Updates it to the factor of `J + e g'` and `r + gamma e`. The vector is `e = Q w + rho q`, with a
    /// direction `q` outside the range of `Q`. The component of `r` along `q` is `tau`.
    pub(super) fn change(&mut self, w: &[f64], rho: f64, tau: f64, g: &[f64], gamma: f64) {
        let n = w.len();
        let mut up = vec![(1.0, 0.0); n];
        let mut top = rho;
        for i in (0..n).rev() {
            (up[i], top) = rotation(w[i], top);
        }
        let mut down: Vec<(f64, f64)> = Vec::with_capacity(n);
        let mut turned = vec![0.0; n + 1];
        for j in 0..=n {
            let (column, below, g_j) = if j < n {
                (&mut self.factor.as_mut_slice()[j * n..=j * n + j], 0.0, g[j])
            } else {
                (self.reached.as_mut_slice(), tau, gamma)
            };
            let mut carry = below;
            for i in (0..column.len()).rev() {
                let ((c, s), a) = (up[i], column[i]);
                turned[i + 1] = c * carry - s * a;
                carry = c * a + s * carry;
            }
            carry += top * g_j;
            for (i, (c, s)) in down.iter().enumerate() {
                column[i] = c * carry + s * turned[i + 1];
                carry = c * turned[i + 1] - s * carry;
            }
            if j < n {
                let (next, end) = rotation(carry, turned[j + 1]);
                down.push(next);
                column[j] = end;
            }
        }
    }
}

/// Returns the smallest and the largest absolute value on the diagonal.
pub(super) fn diagonal(r: &DMatrix<f64>) -> (f64, f64) {
    (0..r.ncols()).map(|k| r[(k, k)].abs()).fold((f64::INFINITY, 0.0), |(l, m), d| (d.min(l), d.max(m)))
}

fn column(r: &DMatrix<f64>, j: usize) -> &[f64] {
    &r.as_slice()[j * r.nrows()..j * r.nrows() + j]
}

/// Solves `R x = b` in place. Diagonal entries with an absolute value below `least` are replaced by `least`.
pub(super) fn solve(r: &DMatrix<f64>, x: &mut [f64], least: f64) {
    for j in (0..x.len()).rev() {
        let d = r[(j, j)];
        x[j] /= if d.abs() < least { least.copysign(d) } else { d };
        let share = -x[j];
        axpy(share, column(r, j), &mut x[..j]);
    }
}

/// Solves `R' x = b` in place, with the same treatment of the diagonal as [`solve`].
pub(super) fn solve_transposed(r: &DMatrix<f64>, x: &mut [f64], least: f64) {
    for j in 0..x.len() {
        let d = r[(j, j)];
        let rest = x[j] - dot(column(r, j), &x[..j]);
        x[j] = rest / if d.abs() < least { least.copysign(d) } else { d };
    }
}

/// Returns `R' x`.
pub(super) fn times_transposed(r: &DMatrix<f64>, x: &[f64]) -> Vec<f64> {
    (0..x.len()).map(|j| dot(column(r, j), &x[..j]) + r[(j, j)] * x[j]).collect()
}

/// Computes `y += R x`.
pub(super) fn add_product(r: &DMatrix<f64>, x: &[f64], y: &mut [f64]) {
    for (j, share) in x.iter().enumerate() {
        axpy(*share, column(r, j), &mut y[..j]);
        y[j] += r[(j, j)] * share;
    }
}

/// Returns the triangular matrix with only the columns in `kept`, rotated to a triangle again, and the
/// rotated right-hand side.
pub(super) fn without(
    a: &DMatrix<f64>,
    kept: &[usize],
    reached: &DVector<f64>,
) -> (DMatrix<f64>, DVector<f64>) {
    let n = kept.len();
    let (mut columns, mut turned) = (a.select_columns(kept), reached.clone());
    let rows = columns.nrows();
    let mut v = vec![0.0; rows];
    for (j, &last) in kept.iter().enumerate() {
        let entries = j..last + 1;
        let x = &columns.as_slice()[j * rows..][entries.clone()];
        let length = dot(x, x).sqrt();
        if last == j || length == 0.0 {
            continue;
        }
        v[entries.clone()].copy_from_slice(x);
        v[j] += length.copysign(v[j]);
        let v = &v[entries.clone()];
        let factor = 2.0 / dot(v, v);
        let others = columns.as_mut_slice()[j * rows..].chunks_exact_mut(rows);
        for other in others.chain(std::iter::once(turned.as_mut_slice())) {
            let part = &mut other[entries.clone()];
            axpy(-factor * dot(v, part), v, part);
        }
    }
    columns = columns.resize_vertically(n, 0.0);
    (0..n).for_each(|j| columns.as_mut_slice()[j * n + j + 1..(j + 1) * n].fill(0.0));
    (columns, turned.rows(0, n).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dice(k: usize) -> f64 {
        ((k * 7919 + 13) % 1009) as f64 / 1009.0 - 0.5
    }

    /// Checks that `|R s + c|^2` and `|J s + r|^2` differ by a constant.
    fn compare(triangle: &Triangle, j: &DMatrix<f64>, r: &DVector<f64>) {
        let n = j.ncols();
        let gap = |k: usize| {
            let s = DVector::from_fn(n, |i, _| 3.0 * dice(17 * k + i));
            (j * &s + r).norm_squared() - (&triangle.factor * &s + &triangle.reached).norm_squared()
        };
        assert!((1..6).all(|k| (gap(k) - gap(0)).abs() < 1e-12 * r.norm_squared().max(1.0)));
    }

    #[test]
    fn triangle_follows_row_additions_and_rank_one_changes() {
        let (m, n) = (23, 5);
        let mut j = DMatrix::from_fn(m, n, |i, k| dice(31 * i + 7 * k));
        let mut r = DVector::from_fn(m, |i, _| dice(5 * i + 3));
        let mut triangle = Triangle::zero(n);
        for (from, rows) in [(0, 3), (3, 19), (22, 1)] {
            let of_j = (0..n).flat_map(|k| (from..from + rows).map(move |i| (i, k))).map(|at| j[at]);
            let mut block: Vec<f64> = of_j.chain((from..from + rows).map(|i| r[i])).collect();
            triangle.absorb(rows, &mut block);
        }
        compare(&triangle, &j, &r);
        for turn in 0..40 {
            let e = DVector::from_fn(m, |i, _| dice(3 * i + 101 * turn));
            let (g, gamma) = (DVector::from_fn(n, |k, _| dice(k + 57 * turn)), dice(turn));
            let mut w: Vec<f64> = j.tr_mul(&e).iter().copied().collect();
            solve_transposed(&triangle.factor, &mut w, 0.0);
            let w = DVector::from_vec(w);
            let rho = (e.norm_squared() - w.norm_squared()).sqrt();
            let tau = (e.dot(&r) - w.dot(&triangle.reached)) / rho;
            triangle.change(w.as_slice(), rho, tau, g.as_slice(), gamma);
            j += &e * g.transpose();
            r += gamma * &e;
            assert!((0..n).all(|k| (k + 1..n).all(|i| triangle.factor[(i, k)] == 0.0)));
        }
        compare(&triangle, &j, &r);
        let kept = [0, 2, 4];
        let (factor, reached) = without(&triangle.factor, &kept, &triangle.reached);
        assert!(factor.is_square() && factor.lower_triangle() == DMatrix::from_diagonal(&factor.diagonal()));
        compare(&Triangle { factor, reached }, &j.select_columns(&kept), &r);
    }

    #[test]
    fn triangle_stays_finite_when_blocks_have_few_rows() {
        let (m, n, rows) = (80, 60, 2);
        for turn in 0..10 {
            let j = DMatrix::from_fn(m, n, |i, k| dice(31 * i + 7 * k * k + 1001 * turn));
            let r = DVector::from_fn(m, |i, _| dice(5 * i + 3));
            let mut triangle = Triangle::zero(n);
            for from in (0..m).step_by(rows) {
                let of_j = (0..n).flat_map(|k| (from..from + rows).map(move |i| (i, k))).map(|at| j[at]);
                let mut block: Vec<f64> = of_j.chain((from..from + rows).map(|i| r[i])).collect();
                triangle.absorb(rows, &mut block);
            }
            assert!(triangle.factor.iter().chain(triangle.reached.iter()).all(|v| v.is_finite()), "{turn}");
            compare(&triangle, &j, &r);
        }
    }

    #[test]
    fn solve_inverts_triangle_and_transpose() {
        let r = DMatrix::from_row_slice(3, 3, &[2.0, 1.0, -1.0, 0.0, 3.0, 0.5, 0.0, 0.0, 4.0]);
        let x = [1.0, -2.0, 0.5];
        let (mut b, mut t) = (&r * DVector::from_row_slice(&x), r.tr_mul(&DVector::from_row_slice(&x)));
        assert_eq!(times_transposed(&r, &x), t.as_slice());
        let mut sum = [1.0; 3];
        add_product(&r, &x, &mut sum);
        assert!((0..3).all(|k| (sum[k] - 1.0 - b[k]).abs() < 1e-15));
        solve(&r, b.as_mut_slice(), 0.0);
        solve_transposed(&r, t.as_mut_slice(), 0.0);
        assert!((0..3).all(|k| (b[k] - x[k]).abs() < 1e-15 && (t[k] - x[k]).abs() < 1e-15));
    }
}
