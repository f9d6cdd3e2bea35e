//! Speed-up of Nelder-Mead by speculative evaluations, measured with a simulated clock: several functions and
//! starts, one evaluation in ten takes ten times as long. Prints the time with one worker divided by the time
//! with more workers (the median over the starts). The number in brackets is the maximum number of calls per
//! evaluation of the path. Rosenbrock's function and `decay` were used to choose how many speculative
//! evaluations run at once (`evaluation/speculative_evaluations.rs`); the choice is assessed on the other
//! functions.
#![allow(clippy::print_stdout, clippy::unwrap_used, unreachable_pub)]

#[path = "../tests/common/clocked.rs"]
mod clocked;

use clocked::{Clocked, hash, one_in, rosenbrock};
use dfo::{Answer, AnyMethod, Outcome, Query, minimize_by};

const WIDTHS: [usize; 4] = [4, 16, 64, 1000];
const SEEDS: u64 = 5;

type Evaluate = fn(&[f64], &Query<'_>) -> Answer;

fn ellipsoid(x: &[f64]) -> f64 {
    let last = (x.len() - 1).max(1) as f64;
    x.iter().enumerate().map(|(k, x)| 1e3f64.powf(k as f64 / last) * (x - 0.3).powi(2)).sum()
}

/// Residuals of the sine of a sum of exponential functions. The parameters are the factors of the sum.
fn decay(x: &[f64]) -> f64 {
    let model = |t: f64| {
        let terms = x.iter().enumerate().map(|(k, x)| (x, (-0.4 * t * (k as f64 + 1.0)).exp()));
        let (model, truth) = terms.fold((0.0, 0.0), |(model, truth), (x, e)| (model + x * e, truth + e));
        f64::sin(model) - f64::sin(truth)
    };
    (0..50).map(|k| model(f64::from(k) / 10.0).powi(2)).sum()
}

fn kinks(x: &[f64]) -> f64 {
    x.iter().zip(x.iter().cycle().skip(1)).map(|(a, b)| (a - 0.3 + 0.5 * (b - 0.3)).abs()).sum()
}

fn noise(x: &[f64]) -> f64 {
    rosenbrock(x) * (1.0 + 1e-6 * (hash(x) % 1000) as f64)
}

/// Simulated time of a run, and calls per evaluation of the path.
fn run(answer: Evaluate, n: usize, width: usize, seed: u64) -> (f64, f64) {
    let (mut clocked, seen) = Clocked::new(width, one_in(10));
    clocked.answer = answer;
    let start: Vec<f64> =
        (0..n).map(|k| (hash(&[k as f64, seed as f64]) % 1000) as f64 / 250.0 - 2.0).collect();
    let run = minimize_by(clocked).start(&start).bounds(&vec![-5.0; n], &vec![5.0; n]).unwrap();
    let method: AnyMethod = "nelder-mead".parse().unwrap();
    let report = run.method(method).workers(width).max_evaluations(120 * n).run().unwrap();
    (seen.now.get(), seen.begun.get() as f64 / report.n_evaluations as f64)
}

fn main() {
    let functions: [(&str, Evaluate); 5] = [
        ("Rosenbrock", |x, _| Outcome::Value(rosenbrock(x)).into()),
        ("decay", |x, _| Outcome::Value(decay(x)).into()),
        ("ellipsoid, 1e3", |x, _| Outcome::Value(ellipsoid(x)).into()),
        ("kinks", |x, _| Outcome::Value(kinks(x)).into()),
        ("Rosenbrock, noise of 1e-3", |x, _| Outcome::Value(noise(x)).into()),
    ];
    println!("| function | n |{}", WIDTHS.iter().fold(String::new(), |row, w| row + &format!(" {w} |")));
    println!("|---|---|{}", "---|".repeat(WIDTHS.len()));
    for n in [2, 5, 10, 20] {
        for (name, answer) in functions {
            let serial: Vec<f64> = (0..SEEDS).map(|seed| run(answer, n, 1, seed).0).collect();
            let mut row = format!("| {name} | {n} |");
            for width in WIDTHS {
                let runs: Vec<(f64, f64)> = (0..SEEDS).map(|seed| run(answer, n, width, seed)).collect();
                let mut gains: Vec<f64> = serial.iter().zip(&runs).map(|(one, run)| one / run.0).collect();
                gains.sort_by(f64::total_cmp);
                let calls = runs.iter().map(|run| run.1).fold(0.0, f64::max);
                row += &format!(" {:.2} ({calls:.2}) |", gains[gains.len() / 2]);
            }
            println!("{row}");
        }
    }
}
