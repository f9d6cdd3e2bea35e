//! Nelder-Mead with linear constraints: success away from the minimum is rare, and does not occur here.
#![allow(clippy::unwrap_used)]

use crate::problems::rotated::Random;
use dfo::{AnyMethod, Constraints, LinearConstraint, NelderMead, Report, Search, minimize};

/// A strictly convex quadratic function with rows `a x <= b` and a box, all satisfied at the start.
struct Program {
    hessian: Vec<Vec<f64>>,
    slope: Vec<f64>,
    rows: Constraints,
    start: Vec<f64>,
    bounds: (Vec<f64>, Vec<f64>),
}

impl Program {
    fn random(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let n = 2 + (5.0 * random.uniform()) as usize;
        let n_rows = 1 + ((n + 1) as f64 * random.uniform()) as usize;
        let factor: Vec<Vec<f64>> = (0..n).map(|_| random.normals(n)).collect();
        let product = |i: usize, j: usize| (0..n).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
        let entry = |i: usize, j: usize| product(i, j) + if i == j { 0.1 } else { 0.0 };
        let hessian = (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect();
        let slope = random.normals(n).iter().map(|c| 3.0 * c).collect();
        let start = random.normals(n);
        let linear = (0..n_rows).map(|_| {
            let coefficients = random.normals(n);
            let value: f64 = coefficients.iter().zip(&start).map(|(a, x)| a * x).sum();
            let upper = value + 0.1 + 1.9 * random.uniform();
            LinearConstraint { coefficients, lower: f64::NEG_INFINITY, upper }
        });
        let rows = Constraints { linear: linear.collect(), ..Constraints::default() };
        let lower = start.iter().map(|x| x.min(0.0) - 5.0).collect();
        let bounds = (lower, start.iter().map(|x| x.max(0.0) + 5.0).collect());
        Self { hessian, slope, rows, start, bounds }
    }

    fn cost(&self, x: &[f64]) -> f64 {
        let of_row = |(i, row): (usize, &Vec<f64>)| {
            x[i] * (0.5 * row.iter().zip(x).map(|(h, x)| h * x).sum::<f64>() + self.slope[i])
        };
        self.hessian.iter().enumerate().map(of_row).sum()
    }

    fn minimized_by(&self, method: AnyMethod) -> Report {
        let run = minimize(|x: &[f64]| self.cost(x))
            .start(&self.start)
            .bounds(&self.bounds.0, &self.bounds.1)
            .unwrap();
        run.constraints(self.rows.clone()).method(method).seed(1).run().unwrap()
    }
}

fn false_successes(seeds: std::ops::Range<u64>) -> Vec<(u64, f64, usize)> {
    let gap = |seed| {
        let program = Program::random(seed);
        let found = program.minimized_by(NelderMead::default().into());
        let best = program.minimized_by(AnyMethod::auto(Search::Local)).fun;
        let gap = (found.fun - best) / best.abs().max(1.0);
        (found.is_success() && gap > 1e-3).then_some((seed, gap, found.n_evaluations))
    };
    seeds.filter_map(gap).collect()
}

#[test]
fn simplex_ends_at_the_minimum_of_quadratic_programs() {
    let wrong = false_successes(0..300);
    assert!(wrong.is_empty(), "{} wrong: {wrong:?}", wrong.len());
}

/// The reflection of the start is mirrored at the row onto the centroid of the other vertices.
#[test]
fn mirrored_points_do_not_flatten_the_simplex() {
    let row = LinearConstraint { coefficients: vec![1.0; 2], lower: f64::NEG_INFINITY, upper: 1.5 };
    let report = minimize(|x: &[f64]| (x[0] - 1.0).powi(2) + (x[1] - 1.0).powi(2))
        .start(&[0.0, 0.0])
        .constraints(Constraints { linear: vec![row], ..Constraints::default() })
        .method(NelderMead::default().initial_steps(&[1.0, 1.0]).restarts(0))
        .run()
        .unwrap();
    assert!((report.fun - 0.125).abs() < 1e-5, "{report}");
}
