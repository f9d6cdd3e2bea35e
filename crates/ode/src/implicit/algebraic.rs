//! The equations of `M x' = f(t, x)` in which no derivative stands, for a singular `M`, and the states that
//! they decide.
//!
//! Where `l M = 0` for a row `l`, every solution has `l f(t, x) = 0`; where `M z = 0`, moving the state along
//! `z` leaves what the other equations start from, `M x`, as it is. For systems of index 1 the matrix of `l J
//! z` over all `l` and `z` is regular, so that Newton's method along the `z` finds consistent states (K. E.
//! Brenan, S. L. Campbell, L. R. Petzold, Numerical Solution of Initial-Value Problems in
//! Differential-Algebraic Equations, 1996, section 5.3.4; damped as in P. Deuflhard, Newton Methods for
//! Nonlinear Problems, 2004, section 3.3).

use crate::error::Undetermined;
use crate::error_norm::ErrorWeights;
use crate::jacobian::Jacobian;
use crate::lu::Lu;
use crate::stepper::{Consistency, Equations, Point, PointMut};
use crate::system::{CallError, CallResult};

const U: f64 = f64::EPSILON / 2.0;

/// States that Newton's method would move by less than this share of their tolerance are consistent.
const CONSISTENT: f64 = 0.1;
/// Newton's method goes on until it would move them by less than this.
const CONVERGED: f64 = 1e-3;
const MAX_NEWTON: u32 = 30;
const LEAST_DAMPING: f64 = 1e-3;
/// Entries below this are zero, as far as differences of right-hand sides can tell: some hundred times the
/// square root of the unit round-off.
const SINGULAR: f64 = 1e-6;

/// The algebraic part of a mass matrix, and room for Newton's method.
#[derive(Debug, Default)]
pub(super) struct Algebraic {
    n: usize,
    mass: Vec<f64>,
    /// Entries of the mass matrix below this share of their row and column are zero.
    noise: f64,
    /// The rows `l`, one after the other, and for each the equation that it is named after: there it is 1.
    rows: Vec<f64>,
    names: Vec<usize>,
    /// The columns `z`, one after the other, and for each the state that it is named after.
    columns: Vec<f64>,
    states: Vec<usize>,
    /// For each state that the algebraic part is named after its equation, and what completes the matrix
    /// there.
    partner: Vec<usize>,
    largest: f64,
    lu: Lu<f64>,
    /// Rows and columns of the matrix in the order of their pivots.
    order: (Vec<usize>, Vec<usize>),
    matrix: Vec<f64>,
    residual: Vec<f64>,
    step: Vec<f64>,
    start: Vec<f64>,
    along: Vec<f64>,
    trial: Vec<f64>,
    inverse: Vec<f64>,
}

impl Algebraic {
    /// For a mass matrix of `n` states, by columns, exact up to this share. `true`: it is another one than
    /// before.
    pub(super) fn begin(&mut self, n: usize, mass: &[f64], noise: f64) -> CallResult<bool> {
        if self.n == n && self.mass == mass && self.noise == noise {
            return Ok(false);
        }
        self.n = n;
        self.noise = noise;
        self.mass.clear();
        self.mass.extend_from_slice(mass);
        self.split();
        let m = self.names.len();
        self.lu.begin(m, None)?;
        self.matrix.resize(m * m, 0.0);
        self.residual.resize(m, 0.0);
        let Self { step, start, along, trial, inverse, .. } = self;
        for v in [step, start, along, trial, inverse] {
            v.resize(n, 0.0);
        }
        Ok(true)
    }

    /// Number of equations, and of states, of the algebraic part.
    pub(super) fn count(&self) -> usize {
        self.names.len()
    }

    /// Makes of `x` the state nearest to it, by the states that the algebraic part is named after, that
    /// differs from `guess` in the algebraic part only.
    pub(super) fn move_from(&self, guess: &[f64], x: &mut [f64]) {
        let along: Vec<f64> = self.states.iter().map(|k| x[*k] - guess[*k]).collect();
        x.copy_from_slice(guess);
        for (z, share) in self.columns.chunks_exact(self.n.max(1)).zip(along) {
            x.iter_mut().zip(z).for_each(|(x, z)| *x += share * z);
        }
    }

    /// Addition to the entry of the mass matrix at place `p`, by columns, so that it can be decomposed, where
    /// it has no pivot: solutions of its equations without a residual in their algebraic part are as with the
    /// matrix itself, and zero in the states that the algebraic part is named after.
    pub(super) fn completion(&self, p: usize) -> f64 {
        if self.partner.get(p / self.n) == Some(&(p % self.n)) { self.largest } else { 0.0 }
    }

    /// Gaussian elimination with complete pivoting of the matrix, its rows and columns scaled to a largest
    /// entry of 1.
    fn split(&mut self) {
        let n = self.n;
        let mut a = self.mass.clone();
        let scale = |entries: &mut dyn Iterator<Item = f64>| {
            let largest = entries.fold(0.0, |m: f64, v| m.max(v.abs()));
            if largest > 0.0 { 1.0 / largest } else { 1.0 }
        };
        let of_rows: Vec<f64> = (0..n).map(|i| scale(&mut (0..n).map(|k| a[i + n * k]))).collect();
        (0..n * n).for_each(|p| a[p] *= of_rows[p % n]);
        let of_columns: Vec<f64> =
            (0..n).map(|k| scale(&mut a[n * k..n * (k + 1)].iter().copied())).collect();
        (0..n * n).for_each(|p| a[p] *= of_columns[p / n]);
        // `done` is what makes of the scaled matrix what is left of it.
        let mut done = vec![0.0; n * n];
        (0..n).for_each(|i| done[i * (n + 1)] = 1.0);
        let (mut row, mut column): (Vec<usize>, Vec<usize>) = ((0..n).collect(), (0..n).collect());
        let mut rank = 0;
        while rank < n {
            let places = (rank..n).flat_map(|i| (rank..n).map(move |k| (i, k)));
            let size = |&(i, k): &(usize, usize)| a[row[i] + n * column[k]].abs();
            let Some((i, k)) = places.max_by(|p, q| size(p).total_cmp(&size(q))) else { break };
            if size(&(i, k)) <= self.noise.max(8.0 * n as f64 * U) {
                break;
            }
            row.swap(rank, i);
            column.swap(rank, k);
            let (pivot_row, pivot) = (row[rank], a[row[rank] + n * column[rank]]);
            for &i in &row[rank + 1..] {
                let factor = a[i + n * column[rank]] / pivot;
                if factor != 0.0 {
                    for k in 0..n {
                        a[i + n * k] -= factor * a[pivot_row + n * k];
                        done[i + n * k] -= factor * done[pivot_row + n * k];
                    }
                }
            }
            rank += 1;
        }
        self.names = row[rank..].to_vec();
        self.states = column[rank..].to_vec();
        self.partner.clear();
        self.partner.resize(n, usize::MAX);
        self.states.iter().zip(&self.names).for_each(|(k, i)| self.partner[*k] = *i);
        let largest = self.mass.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        self.largest = if largest > 0.0 { largest } else { 1.0 };
        self.rows.clear();
        self.columns.clear();
        for (&i, &k) in row[rank..].iter().zip(&column[rank..]) {
            self.rows.extend((0..n).map(|j| done[i + n * j] * of_rows[j] / of_rows[i]));
            let mut z = vec![0.0; n];
            z[k] = 1.0;
            for r in (0..rank).rev() {
                let sum: f64 = column[r + 1..].iter().map(|&c| a[row[r] + n * c] * z[c]).sum();
                z[column[r]] = -sum / a[row[r] + n * column[r]];
            }
            self.columns.extend((0..n).map(|j| z[j] * of_columns[j] / of_columns[k]));
        }
    }

    /// Fills in the residuals for the right-hand side `f`; `true`: none is left.
    fn measure(&mut self, f: &[f64]) -> bool {
        for (r, row) in self.residual.iter_mut().zip(self.rows.chunks_exact(self.n.max(1))) {
            *r = row.iter().zip(f).map(|(l, f)| l * f).sum();
        }
        self.residual.iter().all(|r| *r == 0.0)
    }

    /// `false`: they do not decide the states, by this Jacobian.
    fn decompose(&mut self, jacobian: &Jacobian) -> bool {
        self.fill_matrix(jacobian);
        self.lu.decompose(|p, _| self.matrix[p])
    }

    /// `l J z` over all `l` and `z`.
    fn fill_matrix(&mut self, jacobian: &Jacobian) {
        let (n, m) = (self.n, self.names.len());
        self.matrix.fill(0.0);
        for (b, z) in self.columns.chunks_exact(n).enumerate() {
            self.step.fill(0.0);
            jacobian.each(|i, k, j| self.step[i] += j * z[k]);
            for (a, l) in self.rows.chunks_exact(n).enumerate() {
                self.matrix[a + m * b] = l.iter().zip(&self.step).map(|(l, v)| l * v).sum();
            }
        }
    }

    /// Makes Newton's step of the residuals; the largest share of a tolerance by which it moves a state.
    fn solve(&mut self) -> f64 {
        self.lu.solve(&mut self.residual);
        self.step.fill(0.0);
        for (r, z) in self.residual.iter().zip(self.columns.chunks_exact(self.n)) {
            for (s, z) in self.step.iter_mut().zip(z) {
                *s -= r * z;
            }
        }
        let shares = self.step.iter().zip(&self.inverse).map(|(s, inverse)| (s * inverse).abs());
        shares.fold(0.0, |a, b| if b.is_nan() { f64::INFINITY } else { a.max(b) })
    }

    /// Sees to it that the algebraic equations hold at a point, where the slopes are the right-hand side;
    /// changes state and slopes if they do not. `known`: there is a Jacobian, though perhaps not of this
    /// point; it is one of this point afterwards where there was none.
    pub(super) fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        PointMut { t, x, slopes: f }: PointMut<'_>,
        jacobian: &mut Jacobian,
        known: bool,
    ) -> CallResult<Consistency> {
        if self.measure(f) {
            return Ok(Consistency::Holds);
        }
        equations.weights.inverse_at(x, 1.0, &mut self.inverse);
        if known {
            if self.decompose(jacobian) && self.solve() <= CONSISTENT {
                return Ok(Consistency::Holds);
            }
            self.measure(f);
        }
        jacobian.evaluate(equations, Point { t, x, slopes: f })?;
        self.start.copy_from_slice(x);
        let worst = self.worst(jacobian);
        for count in 0..MAX_NEWTON {
            if !self.decompose(jacobian) {
                break;
            }
            let before = self.solve();
            if count == 0 && before <= CONSISTENT {
                return Ok(Consistency::Holds);
            }
            match self.search(equations, t, x, f, before)? {
                None => break,
                Some(left) if left <= CONVERGED => return Ok(Consistency::Corrected),
                Some(_) => {}
            }
            jacobian.evaluate(equations, Point { t, x, slopes: f })?;
            equations.weights.inverse_at(x, 1.0, &mut self.inverse);
            self.measure(f);
        }
        if let Some((equation, residual)) = worst {
            return Ok(Consistency::Impossible { equation, residual });
        }
        // They hold, though they do not decide the states: a system of higher index.
        x.copy_from_slice(&self.start);
        equations.derivatives(t, x, f)?;
        jacobian.evaluate(equations, Point { t, x, slopes: f })?;
        Ok(Consistency::Holds)
    }

    /// An equation that does not determine the states it should, near `(t, x)`: at a point where each state
    /// is moved by a share of its size, so that an index that rises at `(t, x)` alone, where solutions end,
    /// is not taken for a higher index. `None`: there is none, or that point cannot be evaluated.
    pub(super) fn undetermined(
        &mut self,
        equations: &mut Equations<'_>,
        jacobian: &mut Jacobian,
        t: f64,
        x: &[f64],
    ) -> Option<Undetermined> {
        let n = self.n;
        let mut sizes = vec![0.0; n];
        self::sizes(equations.weights, x, &mut sizes);
        // Shares that have nothing in common.
        let near: Vec<f64> =
            (0..n).map(|i| x[i] + (0.05 + 0.05 * ((i + 1) as f64).sqrt().fract()) * sizes[i]).collect();
        let mut f = vec![0.0; n];
        equations.derivatives(t, &near, &mut f).ok()?;
        jacobian.evaluate(equations, Point { t, x: &near, slopes: &f }).ok()?;
        self.deficit(jacobian, &sizes)
    }

    /// An equation that does not determine the states it should, which are of these sizes, by this Jacobian.
    pub(super) fn deficit(&mut self, jacobian: &Jacobian, sizes: &[f64]) -> Option<Undetermined> {
        let (n, m) = (self.n, self.names.len());
        self.fill_matrix(jacobian);
        // Rows in units of the largest effect of a state of its size.
        for (a, l) in self.rows.chunks_exact(n).enumerate() {
            self.along.fill(0.0);
            jacobian.each(|i, k, j| self.along[k] += l[i] * j);
            let largest = self.along.iter().zip(sizes).map(|(v, size)| (v * size).abs()).fold(0.0, f64::max);
            let largest = if largest == 0.0 { 1.0 } else { largest };
            for (b, z) in self.columns.chunks_exact(n).enumerate() {
                let size = z.iter().zip(sizes).filter(|(z, _)| **z != 0.0);
                let size = size.map(|(z, size)| size / z.abs()).fold(f64::INFINITY, f64::min);
                self.matrix[a + m * b] *= size / largest;
            }
        }
        let Self { matrix, order: (rows, columns), .. } = self;
        let (done, pivot) = rank_deficit(matrix, m, rows, columns)?;
        let states = columns[done..].iter().map(|b| self.states[*b]).collect();
        Some(Undetermined { equation: self.names[rows[done]], states, pivot })
    }

    /// The equation with the largest residual, seen against what changes of the states within their
    /// tolerances make, if it is larger than that.
    fn worst(&mut self, jacobian: &Jacobian) -> Option<(usize, f64)> {
        let mut largest = 1.0;
        let mut worst = None;
        for ((l, r), name) in self.rows.chunks_exact(self.n).zip(&self.residual).zip(&self.names) {
            self.trial.fill(0.0);
            jacobian.each(|i, k, j| self.trial[k] += l[i] * j);
            let allowed: f64 =
                self.trial.iter().zip(&self.inverse).map(|(a, inverse)| a.abs() / inverse).sum();
            let share = r.abs() / allowed;
            if share > largest {
                largest = share;
                worst = Some((*name, *r));
            }
        }
        worst
    }

    /// Goes along the step as far as the next one, by the same matrix, becomes smaller for it; the size of
    /// that one. `None`: nowhere.
    fn search(
        &mut self,
        equations: &mut Equations<'_>,
        t: f64,
        x: &mut [f64],
        f: &mut [f64],
        before: f64,
    ) -> CallResult<Option<f64>> {
        let mut damping = 1.0;
        self.along.copy_from_slice(&self.step);
        while before.is_finite() && damping >= LEAST_DAMPING {
            for ((p, x), d) in self.trial.iter_mut().zip(&*x).zip(&self.along) {
                *p = x + damping * d;
            }
            let good = match equations.derivatives(t, &self.trial, f) {
                Ok(()) => f.iter().all(|v| v.is_finite()),
                Err(CallError::Discard) => false,
                Err(failed) => return Err(failed),
            };
            if good {
                self.measure(f);
                let left = self.solve();
                if left <= (1.0 - 0.25 * damping) * before {
                    x.copy_from_slice(&self.trial);
                    return Ok(Some(if damping == 1.0 { left } else { f64::INFINITY }));
                }
            }
            damping *= 0.5;
        }
        Ok(None)
    }
}

/// Fills in the sizes of the states, for what a change of them may mean.
pub(super) fn sizes(weights: &ErrorWeights, x: &[f64], sizes: &mut [f64]) {
    sizes.iter_mut().enumerate().for_each(|(i, size)| *size = x[i].abs().max(weights.scale(i)));
}

/// Gaussian elimination with complete pivoting of a matrix of `m` rows, by columns: the number of its pivots
/// where some are missing, as far as differences can tell, and the largest entry that is left for one. Rows
/// and columns are put in the order of their pivots.
fn rank_deficit(
    matrix: &mut [f64],
    m: usize,
    rows: &mut Vec<usize>,
    columns: &mut Vec<usize>,
) -> Option<(usize, f64)> {
    for order in [&mut *rows, &mut *columns] {
        order.clear();
        order.extend(0..m);
    }
    for done in 0..m {
        let places = (done..m).flat_map(|i| (done..m).map(move |k| (i, k)));
        let size = |&(i, k): &(usize, usize)| matrix[rows[i] + m * columns[k]].abs();
        let (i, k) = places.max_by(|p, q| size(p).total_cmp(&size(q)))?;
        let pivot = size(&(i, k));
        if pivot < SINGULAR {
            return Some((done, pivot));
        }
        rows.swap(done, i);
        columns.swap(done, k);
        let (row, column) = (rows[done], columns[done]);
        for &i in &rows[done + 1..] {
            let factor = matrix[i + m * column] / matrix[row + m * column];
            for &k in &columns[done..] {
                matrix[i + m * k] -= factor * matrix[row + m * k];
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names, rows and columns of the algebraic part of a matrix that is given by rows.
    fn split<const N: usize>(m: [[f64; N]; N]) -> (Vec<usize>, Vec<f64>, Vec<f64>) {
        let mut a = Algebraic::default();
        let by_columns: Vec<f64> = (0..N * N).map(|p| m[p % N][p / N]).collect();
        a.begin(N, &by_columns, 0.0).unwrap();
        (a.names, a.rows, a.columns)
    }

    #[test]
    fn zero_rows_and_columns_are_the_algebraic_part() {
        let (names, rows, columns) = split([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [3.0, 0.0, 1.0]]);
        assert_eq!((names, rows, columns), (vec![1], vec![0.0, 1.0, 0.0], vec![0.0, 1.0, 0.0]));
        let (names, rows, columns) = split([[0.0; 2]; 2]);
        assert_eq!((names.len(), rows.len(), columns.len()), (2, 4, 4));
        assert_eq!(split([]), (vec![], vec![], vec![]));
    }

    #[test]
    fn small_is_not_zero_and_dependent_rows_are_seen() {
        for regular in [[[1.0, 0.0], [0.0, 1e-30]], [[1.0, 1e-20], [1.0, 2e-20]], [[1e-9, 1.0], [0.0, 1e-9]]]
        {
            assert_eq!(split(regular).0, Vec::<usize>::new(), "{regular:?}");
        }
        // Rows in the proportion 1 to 1e-6, columns in that of 0.1 to 0.3.
        let m = [[0.1, 0.3], [1e-7, 3e-7]];
        let (names, rows, columns) = split(m);
        assert_eq!(names.len(), 1);
        for (row, column) in m.iter().zip([[m[0][0], m[1][0]], [m[0][1], m[1][1]]]) {
            let left = rows[0] * column[0] + rows[1] * column[1];
            let right = row[0] * columns[0] + row[1] * columns[1];
            assert!(left.abs() < 1e-16 * rows[0].abs().max(1.0) && right.abs() < 1e-16, "{left} {right}");
        }
        assert_eq!((rows[names[0]], columns.contains(&1.0)), (1.0, true));
    }
}
