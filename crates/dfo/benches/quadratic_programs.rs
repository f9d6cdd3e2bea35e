//! False successes on random convex quadratic programs with linear constraints: runs that report success above
//! the minimum, which follows from the conditions of optimality of every set of active rows.
//!
//! ```sh
//! cargo bench -p fmufit-dfo --bench quadratic_programs -- nelder-mead auto
//! ```
#![allow(clippy::print_stdout, clippy::unwrap_used, unreachable_pub)]

use dfo::{AnyMethod, Constraints, LinearConstraint, minimize};
use nalgebra::{DMatrix, DVector};

const PROGRAMS: u64 = 6000;

/// Numbers from a linear congruential generator with mixed bits.
struct Numbers(u64);

impl Numbers {
    /// Returns a number in [0, 1).
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mixed = (self.0 ^ self.0 >> 33).wrapping_mul(0xff51_afd7_ed55_8ccd);
        ((mixed ^ mixed >> 29) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn integer(&mut self, low: i32, high: i32) -> f64 {
        f64::from(low + (self.next() * f64::from(high - low + 1)) as i32)
    }

    fn integers(&mut self, n: usize, low: i32, high: i32) -> Vec<f64> {
        (0..n).map(|_| self.integer(low, high)).collect()
    }
}

/// Minimise `x' Q x / 2 + c' x` subject to `A x <= b`, which the origin satisfies.
struct Program {
    hessian: DMatrix<f64>,
    slope: DVector<f64>,
    rows: DMatrix<f64>,
    limits: DVector<f64>,
    start: Vec<f64>,
}

impl Program {
    /// 2 to 4 parameters and 1 to 6 rows with small integers, so that rows often meet in one point.
    fn new(seed: u64) -> Self {
        let mut numbers = Numbers(seed * 7919 + 13);
        (0..5).for_each(|_| _ = numbers.next());
        let (n, m) = (2 + (seed % 3) as usize, 1 + (seed / 3 % 6) as usize);
        let factor = DMatrix::from_row_slice(n, n, &numbers.integers(n * n, -3, 3));
        let hessian = &factor * factor.transpose() + 0.1 * DMatrix::identity(n, n);
        let slope = numbers.integers(n, -10, 10).into();
        let mut row = || loop {
            let row = numbers.integers(n, -5, 5);
            if row.iter().any(|a| *a != 0.0) {
                break row;
            }
        };
        let rows: Vec<f64> = (0..m).flat_map(|_| row()).collect();
        let limits = numbers.integers(m, 1, 5).into();
        let start = numbers.integers(n, -8, 8);
        Self { hessian, slope, rows: DMatrix::from_row_slice(m, n, &rows), limits, start }
    }

    fn cost(&self, x: &[f64]) -> f64 {
        let x = DVector::from_column_slice(x);
        (0.5 * &self.hessian * &x + &self.slope).dot(&x)
    }

    fn minimum(&self) -> f64 {
        let (n, m) = (self.slope.len(), self.limits.len());
        let of_set = |set: usize| {
            let active: Vec<usize> = (0..m).filter(|i| set >> i & 1 == 1).collect();
            let size = n + active.len();
            let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
            matrix.view_mut((0, 0), (n, n)).copy_from(&self.hessian);
            right.rows_mut(0, n).copy_from(&-&self.slope);
            for (k, i) in active.iter().enumerate() {
                matrix.view_mut((n + k, 0), (1, n)).copy_from(&self.rows.row(*i));
                matrix.view_mut((0, n + k), (n, 1)).copy_from(&self.rows.row(*i).transpose());
                right[n + k] = self.limits[*i];
            }
            let x = matrix.lu().solve(&right)?.rows(0, n).into_owned();
            let is_feasible = (&self.rows * &x - &self.limits).iter().all(|excess| *excess <= 1e-9);
            is_feasible.then(|| self.cost(x.as_slice()))
        };
        (0..1 << m).filter_map(of_set).fold(f64::INFINITY, f64::min)
    }

    fn constraints(&self) -> Constraints {
        let row = |(row, upper): (nalgebra::RowDVector<f64>, &f64)| LinearConstraint {
            coefficients: row.iter().copied().collect(),
            lower: f64::NEG_INFINITY,
            upper: *upper,
        };
        let rows = self.rows.row_iter().map(|row| row.into_owned());
        Constraints { linear: rows.zip(self.limits.iter()).map(row).collect(), ..Constraints::default() }
    }
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let methods =
        if named.is_empty() { ["auto", "nelder-mead", "cma-es"].map(str::to_owned).to_vec() } else { named };
    println!("| method | solved | false successes | median evaluations |\n|---|---|---|---|");
    for method in methods {
        let (mut n_solved, mut n_false, mut spent) = (0, 0, Vec::new());
        for program in (0..PROGRAMS).map(Program::new) {
            let report = minimize(|x: &[f64]| program.cost(x))
                .start(&program.start)
                .constraints(program.constraints())
                .method(method.parse::<AnyMethod>().unwrap())
                .seed(1)
                .run()
                .unwrap();
            let minimum = program.minimum();
            let is_solved = report.fun - minimum <= 1e-4 * (1.0 + minimum.abs());
            n_solved += usize::from(is_solved);
            n_false += usize::from(report.is_success() && !is_solved);
            spent.push(report.n_evaluations);
        }
        spent.sort_unstable();
        println!("| {method} | {n_solved} of {PROGRAMS} | {n_false} | {} |", spent[spent.len() / 2]);
    }
}
