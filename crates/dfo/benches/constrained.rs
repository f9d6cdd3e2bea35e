//! Share of solved problems with constraints, and median number of evaluations. `benches/dfo/constrained.py`
//! runs pycma and SciPy on the same problems.
//!
//! Quadratic functions (and one with a cosine term) with linear constraints or balls. The first `min(m, n)`
//! constraints are active at the minimum, with positive multipliers, as in the suite bbob-constrained of COCO.
//! Solved: within 1e-5 of the minimum, at a point that satisfies the constraints up to 1e-6, within 2000 n
//! evaluations. The gradient at the minimum has length 1. The bench fails if an evaluated point violates a
//! linear constraint by more than rounding errors.
#![allow(clippy::print_stdout, clippy::unwrap_used, unreachable_pub)]

use dfo::{AnyMethod, Constraints, LinearConstraint, NonlinearConstraint, constrained, minimize};

const SEEDS: u64 = 10;
const FUNCTIONS: [&str; 4] = ["sphere", "ellipsoid", "rotated", "rastrigin"];

/// Numbers from a linear congruential generator, which `constrained.py` repeats.
struct Numbers(u64);

impl Numbers {
    /// Returns a number in [-1, 1).
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / 4_503_599_627_370_496.0 - 1.0
    }

    fn vector(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.next()).collect()
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn unit(mut v: Vec<f64>) -> Vec<f64> {
    let length = dot(&v, &v).sqrt();
    v.iter_mut().for_each(|v| *v /= length);
    v
}

#[derive(Clone)]
struct Problem {
    axis: Option<Vec<f64>>,
    weights: Vec<f64>,
    centre: Vec<f64>,
    minimum: Vec<f64>,
    cosine: f64,
    /// Outward normals, and distances of the minimum from the constraints.
    normals: Vec<Vec<f64>>,
    gaps: Vec<f64>,
}

impl Problem {
    fn new(function: usize, n: usize, m: usize, seed: u64) -> Self {
        let mut numbers = Numbers(seed * 1_000_003 + (function * 10_007 + n * 101 + m) as u64);
        (0..10).for_each(|_| _ = numbers.next());
        let minimum: Vec<f64> = numbers.vector(n).iter().map(|x| 2.0 * x).collect();
        let gradient = unit(numbers.vector(n));
        let axis = unit(numbers.vector(n));
        let exponent = if matches!(function, 1 | 2) { 6.0 } else { 0.0 };
        let lowest = if exponent > 0.0 { 0.05 } else { 0.25 };
        let weight = |k: usize| lowest * 10f64.powf(exponent * k as f64 / (n - 1) as f64);
        let weights: Vec<f64> = (0..n).map(weight).collect();
        let axis = (function == 2).then_some(axis);
        let cosine = if function == 3 { 2.5 } else { 0.0 };
        let mut problem =
            Self { axis, weights, centre: vec![], minimum, cosine, normals: vec![], gaps: vec![] };
        let along = problem.reflected(&gradient);
        let from: Vec<f64> = along.iter().zip(&problem.weights).map(|(g, w)| g / (2.0 * w)).collect();
        problem.centre = problem.minimum.iter().zip(problem.reflected(&from)).map(|(m, z)| m - z).collect();
        let mut first: Vec<f64> = gradient.iter().map(|g| -g).collect();
        for i in 1..m {
            let normal = unit(numbers.vector(n));
            let share = 0.6 + 0.4 * numbers.next();
            if i < n {
                first.iter_mut().zip(&normal).for_each(|(f, a)| *f -= share * a);
                problem.gaps.push(0.0);
            } else {
                problem.gaps.push(share);
            }
            problem.normals.push(normal);
        }
        problem.normals.push(first);
        problem.gaps.push(0.0);
        problem
    }

    fn reflected(&self, v: &[f64]) -> Vec<f64> {
        let Some(axis) = &self.axis else { return v.to_vec() };
        let along = 2.0 * dot(v, axis);
        v.iter().zip(axis).map(|(v, a)| v - along * a).collect()
    }

    fn turned(&self, x: &[f64]) -> Vec<f64> {
        let from: Vec<f64> = x.iter().zip(&self.centre).map(|(x, c)| x - c).collect();
        self.reflected(&from)
    }

    fn cost(&self, x: &[f64]) -> f64 {
        let quadratic: f64 = self.turned(x).iter().zip(&self.weights).map(|(z, w)| w * z * z).sum();
        let wave = |(x, m): (&f64, &f64)| 1.0 - (std::f64::consts::TAU * (x - m)).cos();
        quadratic + self.cosine * x.iter().zip(&self.minimum).map(wave).sum::<f64>()
    }

    fn rows(&self) -> Vec<LinearConstraint> {
        let limits = self.normals.iter().zip(&self.gaps);
        limits
            .map(|(a, gap)| LinearConstraint {
                coefficients: a.clone(),
                lower: f64::NEG_INFINITY,
                upper: dot(a, &self.minimum) + gap,
            })
            .collect()
    }

    /// Returns the values of balls of radius 2 + gap with the normals at the minimum; feasible up to 0.
    fn balls(&self, x: &[f64]) -> impl Iterator<Item = f64> {
        self.normals.iter().zip(&self.gaps).map(|(a, gap)| {
            let length = dot(a, a).sqrt();
            let centre = self.minimum.iter().zip(a).map(|(m, a)| m - 2.0 * a / length);
            x.iter().zip(centre).map(|(x, c)| (x - c).powi(2)).sum::<f64>() - (2.0 + gap).powi(2)
        })
    }
}

/// Returns the number of evaluations; infinite if the problem was not solved.
fn run(problem: &Problem, method: &str, are_balls: bool, seed: u64) -> f64 {
    let n = problem.minimum.len();
    let rows = problem.rows();
    let cost = |x: &[f64]| {
        for row in rows.iter().filter(|_| !are_balls) {
            let terms: f64 = row.coefficients.iter().zip(x).map(|(a, x)| (a * x).abs()).sum();
            let excess = dot(&row.coefficients, x) - row.upper;
            assert!(excess <= 1e-14 * (terms + row.upper.abs()), "{method}: {x:?} violates {excess:e}");
        }
        problem.cost(x)
    };
    let nonlinear = [NonlinearConstraint { lower: f64::NEG_INFINITY, upper: 0.0, keep_feasible: false }];
    let constraints = match are_balls {
        true => Constraints { nonlinear: nonlinear.repeat(rows.len()), ..Constraints::default() },
        false => Constraints { linear: rows.clone(), ..Constraints::default() },
    };
    let values = |x: &[f64], c: &mut Vec<f64>| {
        if are_balls {
            c.extend(problem.balls(x));
        }
    };
    let target = problem.cost(&problem.minimum) + 1e-5;
    let report = minimize(constrained(cost, values, constraints.clone()))
        .start(&vec![0.0; n])
        .bounds(&vec![-5.0; n], &vec![5.0; n])
        .unwrap()
        .constraints(constraints)
        .method(method.parse::<AnyMethod>().unwrap())
        .seed(seed)
        .x_tol(0.0)
        .f_tol(0.0)
        .max_evaluations(2000 * n)
        .target(target)
        .run()
        .unwrap();
    let solved = report.fun <= target && report.constr_violation <= 1e-6;
    if solved { report.n_evaluations as f64 } else { f64::INFINITY }
}

fn main() {
    let methods = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect::<Vec<_>>();
    let methods =
        if methods.is_empty() { ["cma-es", "de", "multistart"].map(str::to_owned).to_vec() } else { methods };
    println!("| constraints | function | n | m |");
    for are_balls in [false, true] {
        let mut totals = vec![(0, 0); methods.len()];
        for (function, name) in FUNCTIONS.iter().enumerate() {
            for n in [2, 5, 10] {
                for m in [1, n, n + n / 2] {
                    if are_balls && m > n {
                        continue;
                    }
                    print!("| {} | {name} | {n} | {m} |", if are_balls { "balls" } else { "linear" });
                    for (method, total) in methods.iter().zip(&mut totals) {
                        let mut spent: Vec<f64> = (0..SEEDS)
                            .map(|seed| run(&Problem::new(function, n, m, seed), method, are_balls, seed))
                            .collect();
                        spent.sort_by(f64::total_cmp);
                        let solved = spent.iter().filter(|spent| spent.is_finite()).count();
                        *total = (total.0 + solved, total.1 + spent.len());
                        print!(" {method} {solved}/{SEEDS} {:.0} |", spent[SEEDS as usize / 2]);
                    }
                    println!();
                }
            }
        }
        for (method, (solved, all)) in methods.iter().zip(totals) {
            println!("{method}: {solved} of {all}");
        }
    }
}
