//! The equations of `M x' = f(t, x)` that contain no derivative, for a singular `M`, and the states that they
//! determine.
//!
//! If `l M = 0` for a row `l`, every solution satisfies `l f(t, x) = 0`. If `M z = 0`, moving the state along
//! `z` does not change `M x`, from which the other equations start. For systems of index 1, the matrix of `l
//! J z` over all `l` and `z` is regular. Newton's method along the `z` then finds consistent states (K. E.
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

/// States are consistent if Newton's method would move them by less than this fraction of their tolerance.
const CONSISTENT: f64 = 0.1;
/// Newton's method has converged if the next step would move the states by less than this fraction.
const CONVERGED: f64 = 1e-3;
const MAX_NEWTON: u32 = 30;
const LEAST_DAMPING: f64 = 1e-3;
/// Entries below this are zero within the accuracy of finite differences: a hundred times the square root of
/// the unit round-off.
const SINGULAR: f64 = 1e-6;

/// The algebraic part of a mass matrix, and work space for Newton's method.
#[derive(Debug, Default)]
pub(super) struct Algebraic {
    n: usize,
    mass: Vec<f64>,
    /// Entries of the mass matrix below this fraction of their row and column are zero.
    noise: f64,
    /// The rows `l`, one after the other, and the equation that identifies each. Its entry in the row is 1.
    rows: Vec<f64>,
    names: Vec<usize>,
    /// The columns `z`, one after the other, and the state that identifies each.
    columns: Vec<f64>,
    states: Vec<usize>,
    /// For each state that identifies a column, its equation, whose entry completes the matrix.
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
    /// Sets a mass matrix of `n` states, by columns, with the relative accuracy `noise`. Returns `true` if it
    /// differs from the previous one.
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

    /// Replaces `x` by a state that differs from `guess` only in the algebraic part. The states that identify
    /// the columns keep their values.
    pub(super) fn move_from(&self, guess: &[f64], x: &mut [f64]) {
        let along: Vec<f64> = self.states.iter().map(|k| x[*k] - guess[*k]).collect();
        x.copy_from_slice(guess);
        for (z, share) in self.columns.chunks_exact(self.n.max(1)).zip(along) {
            x.iter_mut().zip(z).for_each(|(x, z)| *x += share * z);
        }
    }

    /// Returns the value to add to entry `p` (by columns) of the mass matrix, so that a singular matrix can
    /// be decomposed. If the algebraic part of the residual is zero, the solution also solves the original
    /// equations. It is then zero in the states that identify the columns.
    pub(super) fn completion(&self, p: usize) -> f64 {
        if self.partner.get(p / self.n) == Some(&(p % self.n)) { self.largest } else { 0.0 }
    }

    /// Decomposes the matrix by Gaussian elimination with complete pivoting. Its rows and columns are scaled
    /// to a largest entry of 1.
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
        // `done` is the product of the elimination steps: it transforms the scaled matrix into its remainder.
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

    /// Fills in the residuals for the right-hand side `f`. Returns `true` if all are zero.
    fn measure(&mut self, f: &[f64]) -> bool {
        for (r, row) in self.residual.iter_mut().zip(self.rows.chunks_exact(self.n.max(1))) {
            *r = row.iter().zip(f).map(|(l, f)| l * f).sum();
        }
        self.residual.iter().all(|r| *r == 0.0)
    }

    /// Decomposes the matrix of this Jacobian. Returns `false` if the equations do not determine the states.
    fn decompose(&mut self, jacobian: &Jacobian) -> bool {
        self.fill_matrix(jacobian);
        self.lu.decompose(|p, _| self.matrix[p])
    }

    /// Fills in the matrix of `l J z` over all `l` and `z`.
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

    /// Computes Newton's step for the residuals. Returns the largest change of a state relative to its
    /// tolerance.
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

    /// Ensures that the algebraic equations hold at a point where the slopes are the right-hand side. Changes
    /// state and slopes if the equations do not hold. `has_jacobian`: a Jacobian exists, possibly from
    /// another point. If there was none, it is evaluated at this point.
    pub(super) fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        PointMut { t, x, slopes: f }: PointMut<'_>,
        jacobian: &mut Jacobian,
        has_jacobian: bool,
    ) -> CallResult<Consistency> {
        if self.measure(f) {
            return Ok(Consistency::Holds);
        }
        equations.weights.inverse_at(x, 1.0, &mut self.inverse);
        if has_jacobian {
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
        // The equations hold but do not determine the states, so this is a system of higher index.
        x.copy_from_slice(&self.start);
        equations.derivatives(t, x, f)?;
        jacobian.evaluate(equations, Point { t, x, slopes: f })?;
        Ok(Consistency::Holds)
    }

    /// Returns an equation that does not determine the states it should, near `(t, x)`. The test is made at a
    /// point where each state is moved by a fraction of its size. An index that rises only at `(t, x)`, where
    /// solutions end, is therefore not reported as a higher index. `None` if there is no such equation or the
    /// point cannot be evaluated.
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
        // Fractions without a common divisor.
        let near: Vec<f64> =
            (0..n).map(|i| x[i] + (0.05 + 0.05 * ((i + 1) as f64).sqrt().fract()) * sizes[i]).collect();
        let mut f = vec![0.0; n];
        equations.derivatives(t, &near, &mut f).ok()?;
        jacobian.evaluate(equations, Point { t, x: &near, slopes: &f }).ok()?;
        self.deficit(jacobian, &sizes)
    }

    /// Returns an equation that does not determine the states it should, for this Jacobian. `sizes` are the
    /// sizes of the states.
    pub(super) fn deficit(&mut self, jacobian: &Jacobian, sizes: &[f64]) -> Option<Undetermined> {
        let (n, m) = (self.n, self.names.len());
        self.fill_matrix(jacobian);
        // Scales each row by the largest effect of changing a state by its size.
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

    /// Returns the equation with the largest residual, relative to the effect of changing the states by their
    /// tolerances. `None` if no residual exceeds this effect.
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

    /// Searches along the step for a point at which the next step, with the same matrix, is sufficiently
    /// smaller. Returns the size of that next step, or infinity if the step was damped. `None` if there is no
    /// such point.
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

/// Fills in the sizes of the states, which determine the effect of changing them.
pub(super) fn sizes(weights: &ErrorWeights, x: &[f64], sizes: &mut [f64]) {
    sizes.iter_mut().enumerate().for_each(|(i, size)| *size = x[i].abs().max(weights.scale(i)));
}

/// Gaussian elimination with complete pivoting of a matrix of `m` rows, by columns. If pivots are missing
/// within the accuracy of finite differences, returns the number of pivots and the largest remaining entry.
/// Sorts the rows and columns in the order of their pivots.
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

    /// Names, rows and columns of the algebraic part of a matrix given by rows.
    fn split<const N: usize>(m: [[f64; N]; N]) -> (Vec<usize>, Vec<f64>, Vec<f64>) {
        let mut a = Algebraic::default();
        let by_columns: Vec<f64> = (0..N * N).map(|p| m[p % N][p / N]).collect();
        a.begin(N, &by_columns, 0.0).unwrap();
        (a.names, a.rows, a.columns)
    }

    #[test]
    fn split_finds_zero_rows_and_columns() {
        let (names, rows, columns) = split([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [3.0, 0.0, 1.0]]);
        assert_eq!((names, rows, columns), (vec![1], vec![0.0, 1.0, 0.0], vec![0.0, 1.0, 0.0]));
        let (names, rows, columns) = split([[0.0; 2]; 2]);
        assert_eq!((names.len(), rows.len(), columns.len()), (2, 4, 4));
        assert_eq!(split([]), (vec![], vec![], vec![]));
    }

    #[test]
    fn split_keeps_small_entries_and_finds_dependent_rows() {
        for regular in [[[1.0, 0.0], [0.0, 1e-30]], [[1.0, 1e-20], [1.0, 2e-20]], [[1e-9, 1.0], [0.0, 1e-9]]]
        {
            assert_eq!(split(regular).0, Vec::<usize>::new(), "{regular:?}");
        }
        // The rows have the ratio 1 to 1e-6, the columns the ratio 0.1 to 0.3.
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
