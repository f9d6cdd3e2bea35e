//! Cost and gain of a lag of CMA-ES, measured with a simulated clock: one evaluation in ten takes ten times
//! as long. Prints the number of evaluations to a target, and the speed-up of 16 workers relative to one
//! worker without a lag.
#![allow(clippy::print_stdout, clippy::unwrap_used, unreachable_pub)]

#[path = "../tests/common/clocked.rs"]
mod clocked;

use clocked::{Clocked, one_in, rosenbrock};
use dfo::{Answer, CmaEs, Outcome, Query, Report, minimize_by};

const SEEDS: u64 = 15;
const TARGET: f64 = 1e-6;

fn sphere(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum()
}

/// A quadratic with condition number 1e6 whose axes are rotated by a reflection.
fn ellipsoid(x: &[f64]) -> f64 {
    let n = x.len() as f64;
    let along: f64 = x.iter().enumerate().map(|(k, x)| (k as f64 + 1.0) * x).sum();
    let squared = n * (n + 1.0) * (2.0 * n + 1.0) / 6.0;
    let turned = x.iter().enumerate().map(|(k, x)| x - 2.0 * (k as f64 + 1.0) * along / squared);
    turned.enumerate().map(|(k, z)| 10f64.powf(6.0 * k as f64 / (n - 1.0)) * z * z).sum()
}

fn rastrigin(x: &[f64]) -> f64 {
    x.iter().map(|x| 10.0 + (x - 0.7).powi(2) - 10.0 * (std::f64::consts::TAU * (x - 0.7)).cos()).sum()
}

/// Function, name, start, first step size, and maximum number of evaluations per parameter.
type Problem = (fn(&[f64], &Query<'_>) -> Answer, &'static str, f64, f64, usize);

fn run(problem: Problem, n: usize, options: &CmaEs, width: usize, seed: u64) -> (Report, f64) {
    let (answer, _, x0, sigma, most) = problem;
    let (mut clocked, seen) = Clocked::new(width, one_in(10));
    clocked.answer = answer;
    let run = minimize_by(clocked).start(&vec![x0; n]).scales(&vec![1.0; n]);
    let run = run.method(options.clone().sigma(sigma)).workers(width).seed(seed).x_tol(0.0).f_tol(0.0);
    let report = run.target(TARGET).max_evaluations(most * n).run().unwrap();
    (report, seen.now.get())
}

/// Evaluations and time: sums over the runs of several seeds, divided by the number of runs that reached the
/// target.
fn spent(problem: Problem, n: usize, options: &CmaEs, width: usize) -> (f64, f64, usize) {
    let runs: Vec<(Report, f64)> = (0..SEEDS).map(|seed| run(problem, n, options, width, seed)).collect();
    let solved = runs.iter().filter(|(report, _)| report.fun <= TARGET).count();
    let evaluations: usize = runs.iter().map(|(report, _)| report.n_evaluations).sum();
    let time: f64 = runs.iter().map(|(_, time)| time).sum();
    (evaluations as f64 / solved as f64, time / solved as f64, solved)
}

fn main() {
    let problems: [Problem; 4] = [
        (|x, _| Outcome::Value(sphere(x)).into(), "sphere", 1.0, 0.5, 10_000),
        (|x, _| Outcome::Value(ellipsoid(x)).into(), "ellipsoid", 1.0, 0.5, 10_000),
        (|x, _| Outcome::Value(rosenbrock(x)).into(), "Rosenbrock", 0.0, 0.5, 10_000),
        (|x, _| Outcome::Value(rastrigin(x)).into(), "Rastrigin", 2.0, 2.0, 2000),
    ];
    println!("| target 1e-6 | n | no lag | n | population | 16 | 64 |\n|---|---|---|---|---|---|---|");
    for problem in problems {
        for n in [5, 10, 20] {
            let generation = 4 + (3.0 * (n as f64).ln()) as usize;
            let (_, serial, _) = spent(problem, n, &CmaEs::default(), 1);
            print!("| {} | {n} |", problem.1);
            for lag in [0, n, generation, 16, 64] {
                let (evaluations, time, solved) = spent(problem, n, &CmaEs::default().lag(lag), 16);
                let missed =
                    if solved < SEEDS as usize { format!(", {solved}/{SEEDS}") } else { String::new() };
                match solved {
                    0 => print!(" - |"),
                    _ if serial.is_finite() => print!(" {evaluations:.0} ({:.1}{missed}) |", serial / time),
                    _ => print!(" {evaluations:.0} (-{missed}) |"),
                }
            }
            println!();
        }
    }
}
